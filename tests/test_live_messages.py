"""Messages between glove, loop and robot, their transports, and the whole loop in processes over loopback."""

import contextlib
import itertools
import json
import os
import random
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest
from drake import lcmt_allegro_command, lcmt_panda_command
from faults.sound import map_file
from live_messages import Clock, manus_glove, manus_words, nodes_of, own_fields
from pydrake.lcm import DrakeLcm
from system_bench import SystemBench

from geort_drake import load_hand, synthesize_play
from geort_drake.errors import LiveError, MismatchError
from geort_drake.live import joint_messages
from geort_drake.live.driver import JointDriver
from geort_drake.live.joint_messages import (
    JointState,
    JointTargets,
    decode_state,
    decode_targets,
    open_zmq_bus,
)
from geort_drake.live.messages import GloveFrame, decode, encode_frame
from geort_drake.live.robot_buses import ALLEGRO, PANDA, LcmDevice, open_bus
from geort_drake.live.robots import RobotLink
from geort_drake.live.transports import (
    MAX_BYTES,
    RECEIVERS,
    SENDERS,
    ZmqSocket,
    is_local,
    split_address,
    wait_for,
)
from geort_drake.simulation.following import JointGroup

# s; a busy machine takes long to start three programs. Without a fault nothing waits so long.
PATIENCE_S = 300.0
HAND = synthesize_play(3, duration_s=1.0, rate_hz=30.0).p_HK[20].astype(float)
NODES = manus_glove(nodes_of(HAND))
WORDS = manus_words("aa", nodes_of(HAND))


def dumped(fields: dict) -> bytes:
    return json.dumps(fields).encode()


def own(**changes) -> bytes:
    return dumped(own_fields(HAND, **changes))


def text(words: list[str]) -> bytes:
    return ",".join(words).encode()


def test_a_frame_arrives_to_the_last_bit():
    """With and without a hand and a tracker."""
    pose = np.array([0.6, 0.8, 0.0, 0.0, 1 / 3, -2.0, 0.7])
    for sent in (
        GloveFrame("right", 1e9 + 1 / 3, HAND, pose),
        GloveFrame("right", 0.0, None, pose),
        GloveFrame("right", -4.0, HAND),
    ):
        got = decode(encode_frame(sent), "right")
        assert got is not None
        assert (got.side, got.time) == (sent.side, sent.time)
        for name in ("p_HK", "X_WH"):
            np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


def test_a_quaternion_of_another_norm_is_scaled():
    """Trackers round; only a norm that is far off makes the message unusable."""
    frame = decode(own(X_WH=[0.54, 0.72, 0, 0, 1, 2, 3]), "right")
    assert frame is not None
    np.testing.assert_allclose(frame.X_WH, [0.6, 0.8, 0, 0, 1, 2, 3])
    with pytest.raises(LiveError, match=r"unit quaternion, not .*, whose norm is 0\.5"):
        decode(own(X_WH=[0.5, 0, 0, 0, 1, 2, 3]), "right")


@pytest.mark.parametrize("side", ["right", "left"])
def test_manus_bridges_give_the_same_hand(side):
    """As text and as ManusGlove, in another frame, for either side."""
    p_WN = nodes_of(HAND, side)
    for message in (text(manus_words("60f3738b", p_WN)), dumped(manus_glove(p_WN, side.upper()))):
        frame = decode(message, side)
        assert frame is not None and frame.time is None and frame.X_WH is not None
        np.testing.assert_allclose(frame.p_HK, HAND, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(frame.X_WH[:4]), 1.0)


def test_a_glove_is_chosen_by_its_serial_number():
    """In one message or in several; two gloves without a choice are refused."""
    one, other = manus_words("aa", nodes_of(HAND)), manus_words("BB", nodes_of(1.05 * HAND))
    frame = decode(text(one + other), "right", "bb")
    assert frame is not None
    np.testing.assert_allclose(frame.p_HK, 1.05 * HAND, atol=1e-6)
    assert decode(text(one), "right", "bb") is None
    assert decode(dumped(NODES), "right", "8") is None
    assert decode(dumped({**NODES, "glove_id": 8}), "right", "8") is not None
    with pytest.raises(MismatchError, match=r"two gloves; choose one with --glove-id: aa, BB"):
        decode(text(one + other), "right")


REFUSED = {
    "no text": (bytes(range(256)), "expected 176 values"),
    "cut off": (own()[:-1], "truncated"),
    "deeply nested": (b'{"format":' * 10_000, "glove message"),
    "another object": (b"{}", "missing required field `format`"),
    "another format": (own(format="a.b"), r"Invalid enum value 'a\.b' - at `\$\.format`"),
    "too long": (own() + b" " * MAX_BYTES, "at most 65536 are read"),
    "NaN": (own(time=float("nan")), "malformed"),
    "infinity": (own().replace(b"12.5", b"1e999"), "out of range"),
    "a huge integer": (own(time=10**400), "out of range"),
    "a missing field": (own(X_WH=...), "missing required field `X_WH`"),
    "one field more": (own(more=1), "unknown field `more`"),
    "a version that is no number": (own(version=True), r"Expected `int`, got `bool` - at `\$\.version`"),
    "flat keypoints": (own(p_HK=HAND[:, :2].tolist()), r"`array` of length 3.* - at `\$\.p_HK\[0\]`"),
    "keypoints of words": (own(p_HK=[["a", "b", "c"]] * 21), r"Expected `float`, got `str` - at `\$\.p_HK"),
    "keypoints far away": (own(p_HK=(1e4 * HAND).tolist()), r"(<=|>=) -?100.0 - at `\$\.p_HK"),
    "no side": (own(side="both"), r"Invalid enum value 'both' - at `\$\.side`"),
    "24 nodes": (dumped({**NODES, "raw_nodes": NODES["raw_nodes"][:24]}), "length >= 25 - at `..raw_nodes`"),
    "a node twice": (dumped({**NODES, "raw_nodes": [NODES["raw_nodes"][0]] * 25}), "numbers 0 to 24"),
    "nodes of nothing": (dumped({**NODES, "raw_nodes": [None] * 25}), "Expected `object`, got `null`"),
    "175 words": (text(WORDS[:175]), "not 175"),
    "words of no number": (text([*WORDS[:9], "x", *WORDS[10:]]), "could not convert"),
    "NaN in text": (text([*WORDS[:8], "nan", *WORDS[9:]]), "must be finite"),
    "a palm that is a point": (text(["a", *["0"] * 175]), "span a plane"),
}
# Another version, unit or hand, and angles in place of positions, which waiting does not mend.
MISMATCHES = {
    "another version": (own(version=2), "version must be 1, not 2"),
    "millimetres": (own(unit="mm"), "unit must be 'm', not 'mm'"),
    "another side": (own(side="left"), "a left hand is sent, but the robot's is a right one"),
    "another ManusGlove": (dumped(manus_glove(nodes_of(HAND, "left"), "Left")), "left hand is sent"),
    "joint angles": (text(["0.5"] * 40), "joint angles"),
}


@pytest.mark.parametrize("name", REFUSED | MISMATCHES)
def test_a_malformed_message_is_refused(name):
    """With a short error that says what was expected."""
    message, expected = (REFUSED | MISMATCHES)[name]
    with pytest.raises(LiveError, match=expected) as raised:
        decode(message, "right")
    assert isinstance(raised.value, MismatchError) == (name in MISMATCHES)
    assert len(str(raised.value)) < 300


def targets_of(device: LcmDevice, q: np.ndarray) -> JointTargets:
    """Targets of a device's joints, at 2.5 s; the joints are not in the order of its messages."""
    return JointTargets(1, 2.5, list(device.joints[::-1]), q[::-1].tolist(), [0.0] * len(q), True, 0.1)


def state_of(device: LcmDevice, q: np.ndarray, v: np.ndarray) -> JointState:
    """The state of a device's joints, at 1 s; the joints are not in the order of its messages."""
    return JointState(1, 1.0, list(device.joints[::-1]), q[::-1].tolist(), v[::-1].tolist())


def test_commands_have_the_fields_that_drivers_expect():
    """Of Drake's message types."""
    command = lcmt_allegro_command.decode(ALLEGRO.encode_command(targets_of(ALLEGRO, np.arange(16.0))))
    assert (command.utime, command.num_joints, command.num_torques) == (2_500_000, 16, 0)
    assert list(command.joint_position) == list(range(16))
    command = lcmt_panda_command.decode(PANDA.encode_command(targets_of(PANDA, np.arange(7.0))))
    assert (command.num_joint_position, command.num_joint_velocity, command.num_joint_torque) == (7, 0, 0)
    assert command.control_mode_expected == 1  # position
    with pytest.raises(LiveError, match="control_mode_expected must be 1, for positions, not 3"):
        command.control_mode_expected = 3
        PANDA.decode_command(command.encode())


@pytest.mark.parametrize("device", [ALLEGRO, PANDA], ids=lambda device: device.channel)
def test_messages_of_robots_arrive_to_the_last_bit_and_malformed_ones_are_refused(device):
    """In Drake's messages; cut off, of another size, not finite, or with a wrong length inside."""
    n = len(device.joints)
    q, v = np.arange(n) / 7, -np.arange(n) / 3
    status = device.encode_status(state_of(device, q, v))
    command = device.encode_command(targets_of(device, q))
    np.testing.assert_array_equal(device.decode_command(command).position, q)
    state = device.decode_status(status)
    np.testing.assert_array_equal([state.position, state.velocity], [q, v])
    assert state.names == [*device.joints] and state.time == 1.0
    sizes = struct.pack(">i", n)
    for decode_it, good in ((device.decode_status, status), (device.decode_command, command)):
        for bad in (
            good[:-1],
            b"\0" * len(good),
            good.replace(sizes, struct.pack(">i", 2**31 - 1), 1),
            good.replace(sizes, struct.pack(">i", -1), 1),
        ):
            with pytest.raises(LiveError, match=device.channel):
                decode_it(bad)
    for bad in (np.inf, np.nan):
        with pytest.raises(LiveError, match=r"joint_position must be .* finite numbers"):
            device.decode_command(device.encode_command(targets_of(device, np.full(n, bad))))
    with pytest.raises(LiveError, match="Is this the hand that the robot has"):
        larger = device._replace(joints=(*device.joints, "one more"))
        device.decode_status(larger.encode_status(state_of(larger, np.zeros(n + 1), np.zeros(n + 1))))


def test_the_fingers_of_a_real_allegro_get_their_own_joints():
    """The maker counts from the index finger of a right hand, but from the ring finger of a left one."""
    for side, index in (("right", range(0, 4)), ("left", range(8, 12))):
        hand = load_hand(f"allegro_{side}")
        (finger,) = (finger for finger in hand.fingers if finger.name == "index")
        q = np.array([float(name in finger.joints) for name in hand.joint_names])
        targets = JointTargets(1, 0.0, hand.joint_names, q.tolist(), [0.0] * 16, True, 0.1)
        command = ALLEGRO.encode_command(targets)
        assert list(np.flatnonzero(lcmt_allegro_command.decode(command).joint_position)) == [*index], side


TARGETS = JointTargets(7, 12.5, ["a", "b"], [0.1, 1 / 3], [-1.0, 2.0], True, 0.1)
STATE = JointState(8, 1.5, ["a", "b"], [0.1, 1 / 3], [0.0, 2.0])


def test_joint_messages_arrive_to_the_last_bit():
    for sent, decode_it in ((TARGETS, decode_targets), (STATE, decode_state)):
        assert decode_it(joint_messages.encode(sent)) == sent
    unmeasured = joint_messages.encode(msgspec.structs.replace(STATE, position=[np.nan, 0.0]))
    with pytest.raises(
        LiveError, match=r"joint state: Expected `float`, got `null` - at `\$\.position\[0\]`"
    ):
        decode_state(unmeasured)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"version": 2}, r"Invalid enum value 2 - at `\$\.version`"),
        ({"format": "geort_drake.glove"}, r"Invalid value 'geort_drake.glove' - at `\$\.format`"),
        ({"position": [0.1]}, "position must be 2 numbers"),
        ({"position": [0.1, "x"]}, r"Expected `float`, got `str` - at `\$\.position\[1\]`"),
        ({"velocity": [0.1, True]}, r"Expected `float`, got `bool` - at `\$\.velocity\[1\]`"),
        ({"names": ["a", "a"]}, "a name occurs twice in names: a, a"),
        ({"names": "ab"}, r"Expected `array`, got `str` - at `\$\.names`"),
        ({"engaged": 1}, r"Expected `bool`, got `int` - at `\$\.engaged`"),
        ({"hold_after": None}, r"Expected `float`, got `null` - at `\$\.hold_after`"),
        ({"hold_after": 0}, r"Expected `float` > 0.0 - at `\$\.hold_after`"),
        ({"hold_after": 1e9}, r"Expected `float` <= 1.0 - at `\$\.hold_after`"),
        ({"hold_after": 10**400}, "out of range"),
        ({"position": [0.1, 10**400]}, "out of range"),
        ({"time": 10**400}, "out of range"),
        ({"sequence": True}, r"Expected `int`, got `bool` - at `\$\.sequence`"),
        ({"version": True}, r"got `bool` - at `\$\.version`"),
        ({"more": 1}, "unknown field `more`"),
    ],
)
def test_malformed_joint_targets_are_refused_with_their_field(change, expected):
    message = json.dumps(json.loads(joint_messages.encode(TARGETS)) | change).encode()
    with pytest.raises(LiveError, match=f"joint targets: .*{expected}"):
        decode_targets(message)
    for bad in (b"{", b"[]", b"\xff", b" " * MAX_BYTES + message, b'{"a":' * 10_000):
        with pytest.raises(LiveError, match="joint targets"):
            decode_targets(bad)


@pytest.mark.parametrize(
    "address",
    [
        "", "sub+tcp://127.0.0.1", "sub+udp://127.0.0.1:5", "req+tcp://127.0.0.1:5", "lcm+memq://",
        "lcm+udpm://127.0.0.1:7667?ttl=0", "lcm+udpm://239.255.76.67:7667",
        "lcm+udpm://239.255.76.67:99999?ttl=0",
    ],
)  # fmt: skip
def test_a_malformed_address_is_refused(address):
    """LCM itself accepts any URL, and then nothing arrives."""
    with pytest.raises(LiveError, match="give one of"):
        split_address(address, ("sub", "pull", "lcm"))


def test_addresses_open_to_the_network_are_recognised():
    """The defaults stay on this machine."""
    assert all(map(is_local, ("lcm", "lcm+udpm://239.1.1.1:7667?ttl=0", "pub+tcp://127.0.0.1:5556")))
    open_to_all = ("lcm+udpm://239.1.1.1:7667?ttl=1", "pub+tcp://*:1", "sub+tcp://10.0.0.1:1")
    assert not any(map(is_local, open_to_all))


@pytest.fixture
def lcm_url():
    """An LCM bus that no other test uses."""
    url = f"udpm://239.255.76.67:{random.SystemRandom().randint(20_000, 30_000)}?ttl=0"
    sender, receiver, heard = DrakeLcm(url), DrakeLcm(url), []
    receiver.Subscribe("TRY", heard.append)
    for _ in range(20):
        sender.Publish("TRY", b"heard")
        if receiver.HandleSubscriptions(100):
            return url
    pytest.skip("multicast does not reach this machine itself, so LCM has no loopback here")


@pytest.mark.parametrize("pattern", ["pub", "push"])
def test_messages_pass_over_a_transport(pattern):
    """On loopback; an address of ZeroMQ that is in use is refused."""
    sender = ZmqSocket(*split_address(f"{pattern}+tcp://127.0.0.1:0", SENDERS), binds=True)
    address = f"{pattern.replace('pub', 'sub').replace('push', 'pull')}+{sender.endpoint}"
    receiver = ZmqSocket(*split_address(address, RECEIVERS), binds=False)

    def poll():
        sender.send(b"a frame")
        return receiver.drain()

    try:
        assert set(wait_for(poll, 20.0, lambda: "nothing came")) == {b"a frame"}
        with pytest.raises(LiveError, match="cannot listen there"):
            ZmqSocket(pattern, sender.endpoint, binds=True)
    finally:
        receiver.close()
        sender.close()


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    """A folder with a recording and a map for the Allegro hand."""
    folder = tmp_path_factory.mktemp("live")
    synthesize_play(1, duration_s=20.0, rate_hz=60.0).save(folder / "hand.npz")
    map_file(folder)
    return folder


@contextlib.contextmanager
def program(folder: Path, name: str, *arguments: str, stdin: int = subprocess.DEVNULL):
    """Runs a command in a process that is always ended afterwards."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1", "COLUMNS": "200"}
    with open(folder / f"{name}.log", "w") as log, open(folder / f"{name}.json", "w") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "geort_drake", *name.split(), *arguments],
            stdin=stdin, stdout=out, stderr=log, env=environment
        )  # fmt: skip
        try:
            yield process
        finally:
            process.kill()
            process.communicate()


def test_a_command_that_starts_again_gets_no_state_from_before(tmp_path):
    """While it was away, somebody may have moved the robot."""
    endpoint = f"ipc://{tmp_path}/robot"

    def report(sequence: int) -> None:
        driver.send(msgspec.structs.replace(STATE, sequence=sequence))

    with contextlib.closing(joint_messages.open_driver_bus(endpoint)) as driver:
        for start in (1, 1000):
            for sequence in range(start, start + 50):  # to nobody
                report(sequence)
                time.sleep(0.001)
            numbers = itertools.count(start + 100)
            with contextlib.closing(joint_messages.open_zmq_bus(endpoint)) as live:
                states = wait_for(
                    lambda live=live, numbers=numbers: report(next(numbers)) or live.fetch(),
                    PATIENCE_S,
                    lambda: "nothing came",
                )
                assert states[0].sequence >= start + 100


@pytest.mark.parametrize("carrier", ["zmq", "lcm"])
def test_joint_messages_reach_the_other_end_and_malformed_ones_are_counted(tmp_path, carrier, request):
    """Targets reach the driver and states come back, by name; both ends count what they refuse."""
    hand = load_hand("allegro_right")
    address = f"zmq+ipc://{tmp_path}/robot"
    if carrier == "lcm":
        address = f"lcm+{request.getfixturevalue('lcm_url')}"
    names = [*ALLEGRO.joints[::-1], *PANDA.joints]
    q, v = np.arange(23) / 7, -np.arange(23) / 3
    targets = JointTargets(1, 2.0, names, q.tolist(), [0.0] * 23, True, 0.1)
    state = JointState(1, 2.0, names, q.tolist(), v.tolist())
    with contextlib.closing(open_bus(address, hand)) as live:
        with contextlib.closing(open_bus(address, hand, driver=True)) as driver:
            for sender, receiver, message in ((live, driver, targets), (driver, live, state)):
                received: dict[str, float] = {}

                def came(sender=sender, receiver=receiver, message=message, received=received):
                    sender.send(message)
                    for each in receiver.fetch():
                        received.update(zip(each.names, each.position, strict=True))
                    return len(received) == len(names)

                wait_for(came, PATIENCE_S, lambda: "nothing came")
                assert received == dict(zip(names, q.tolist(), strict=True))
                assert receiver.refused == 0

            def refused() -> bool:
                if carrier == "zmq":
                    live._sender.send(b"{}")
                else:
                    live._lcm.Publish("ALLEGRO_COMMAND", b"short")
                driver.fetch()
                return driver.refused > 0

            wait_for(refused, PATIENCE_S, lambda: "nothing was refused")
            expected = "field `sequence`" if carrier == "zmq" else "lcmt_allegro_command cannot be decoded"
            assert expected in driver.last_refusal


def wait_for_text(folder: Path, name: str, text: str) -> None:
    """Waits until a program has printed a text."""

    def poll():
        return text in (folder / f"{name}.log").read_text()

    wait_for(poll, PATIENCE_S, lambda: f"{name}: no '{text}' in: {(folder / f'{name}.log').read_text()}")


@pytest.mark.parametrize("robot", ["zmq", pytest.param("lcm", marks=pytest.mark.slow)])
def test_the_loop_runs_over_loopback(station, tmp_path, robot, request):
    """A robot follows a glove; the glove dies, the hand relaxes; Ctrl-C leaves the robot held."""
    address = f"zmq+ipc://{tmp_path}/robot"
    if robot == "lcm":
        address = f"lcm+{request.getfixturevalue('lcm_url')}"
    glove = f"ipc://{tmp_path}/glove"
    commands = open_bus(address, load_hand("allegro_right"), driver=True)  # hears what the stand-in hears
    first: dict[str, float] = {}

    def moved() -> bool:
        for targets in commands.fetch():
            for name, q in zip(targets.names, targets.position, strict=True):
                if abs(q - first.setdefault(name, q)) > 0.1:
                    return True
        return False

    with (
        program(tmp_path, "live stand-in-robot", "--robot", address),
        program(
            tmp_path, "live publish", str(station / "hand.npz"), "--to", f"pub+{glove}", "--loop"
        ) as publisher,
        program(
            tmp_path, "live", "--glove", f"sub+{glove}", "--robot", address,
            "--retargeter", str(station / "map.safetensors"), "--engage", "now", "--relax-after", "0.5",
            "--timeout", str(PATIENCE_S), "--robot-silence", "20", "--json", "-"
        ) as teleoperation
    ):  # fmt: skip
        wait_for_text(tmp_path, "live", "tracking")
        wait_for(moved, PATIENCE_S, lambda: "the robot is not moved")
        publisher.kill()
        wait_for_text(tmp_path, "live", "relaxing")
        teleoperation.send_signal(signal.SIGINT)
        assert teleoperation.wait(PATIENCE_S) == 0, (tmp_path / "live.log").read_text()
    report = json.loads((tmp_path / "live.json").read_text())
    assert report["states"]["disengaged: held"] > 0.4
    assert report["glove"]["received"] > 20
    assert report["glove"]["refused"] == report["robot"]["refused"] == 0
    assert report["delay_s"]["count"] > 10
    assert 0 < report["delay_s"]["median"] <= report["delay_s"]["p99"]


@pytest.mark.slow
def test_a_replay_drives_the_simulation(station, tmp_path):
    """In one process; Enter engages and disengages, and the glove's data are recorded."""
    with program(
        tmp_path, "live", "--glove", str(station / "hand.npz"),
        "--retargeter", str(station / "map.safetensors"),
        "--record", str(tmp_path / "kept.npz"), "--json", "-", stdin=subprocess.PIPE
    ) as teleoperation:  # fmt: skip
        # The first Enter is there before the loop begins, so only the second one disengages.
        for state in ("tracking", "disengaged: held"):
            os.write(teleoperation.stdin.fileno(), b"\n")
            wait_for_text(tmp_path, "live", state)
        teleoperation.terminate()
        assert teleoperation.wait(PATIENCE_S) == 0, (tmp_path / "live.log").read_text()
    report = json.loads((tmp_path / "live.json").read_text())
    assert report["states"]["disengaged: held"] > 0.4
    with np.load(tmp_path / "kept.npz") as kept:
        assert len(kept["t"]) >= 100 * report["duration"]


def groups() -> tuple[JointGroup, JointGroup]:
    """A hand whose joints are in another order than in messages, and an arm."""
    return tuple(
        JointGroup(name, list(joints), np.zeros(n), np.full(n, -1.0), np.full(n, 1.0))
        for name, joints, n in (("hand", ALLEGRO.joints[::-1], 16), ("arm", PANDA.joints, 7))
    )


class Bus:
    """A robot's bus into which a test puts states."""

    def __init__(self, arm_is_required: bool = False):
        self.arm_is_required, self.states, self.sent = arm_is_required, [], []
        self.refused, self.last_refusal = 0, ""

    def send(self, targets: JointTargets) -> None:
        self.sent.append(targets)

    def fetch(self) -> list[JointState]:
        states, self.states = self.states, []
        return states

    def report(self, joints, q, fault: str = "") -> None:
        self.states.append(JointState(1, 0.0, [*joints], [*q], [0.0] * len(joints), fault))


def test_the_handshake_reports_where_the_robot_stands():
    """In the model's order, within its limits; another robot or none is refused."""
    q, bus = np.linspace(-0.9, 1.05, 16), Bus(arm_is_required=True)
    link = RobotLink(bus, *groups(), period=0.01)
    with pytest.raises(LiveError, match="no state of joint_15, joint_14, joint_13, joint_12 and 19"):
        link.handshake(0.01)
    bus.report(ALLEGRO.joints, q)
    bus.report(PANDA.joints, np.zeros(7))
    hand, arm = link.handshake(20.0)
    np.testing.assert_array_equal(hand, np.minimum(q, 1.0)[::-1])
    np.testing.assert_array_equal(arm, np.zeros(7))
    bus.report(ALLEGRO.joints, 2 * q)
    with pytest.raises(LiveError, match=r"joint_15 is at 2.100 rad, limits are \[-1.000, 1.000\]"):
        link.handshake(20.0)
    other = Bus()
    other.report(["finger_1"], [0.0])
    other.refused, other.last_refusal = 3, "joint state: JSON is malformed"
    with pytest.raises(LiveError, match=r"that the model lacks: finger_1; 3 messages were refused, the"):
        RobotLink(other, *groups(), period=0.01).handshake(0.01)


def test_a_hand_without_an_arm_is_driven_alone():
    """The arm stays where the model has it; joint targets are of the hand, by name, with a deadline."""
    bus = Bus()
    link = RobotLink(bus, *groups(), period=0.01)
    bus.report(ALLEGRO.joints, np.zeros(16))
    link.handshake(20.0)
    bench = SystemBench(link, 0.01, 1.0)
    q, v = np.linspace(0.0, 0.5, 16), np.linspace(1.0, 2.0, 16)
    bench.fix(hand_desired_state=[*q, *v], arm_desired_state=np.zeros(14), engaged=1.0)
    bench.advance()
    targets = bus.sent[-1]
    assert targets.names == [*ALLEGRO.joints[::-1]] and targets.engaged and targets.hold_after == 0.1
    np.testing.assert_array_equal([targets.position, targets.velocity], [q, v])
    np.testing.assert_array_equal(bench.value("arm_state"), 0.0)
    bench.fix(engaged=0.0)
    bench.advance()
    assert not bus.sent[-1].engaged and bus.sent[-1].sequence == len(bus.sent)


def test_a_robot_that_falls_silent_or_has_a_fault_is_not_driven_on():
    """It may be elsewhere when it answers again."""
    now, bus = [5.0], Bus()
    link = RobotLink(bus, *groups(), period=0.01, clock=lambda: now[0])
    bus.report(ALLEGRO.joints, np.zeros(16))
    link.handshake(20.0)
    now[0] += 0.4
    link.require_alive(0.5)
    now[0] += 0.2
    with pytest.raises(LiveError, match=r"no state of joint_\d+ for 0\.6 s"):
        link.require_alive(0.5)
    bus.report(ALLEGRO.joints, np.zeros(16), "motor 3 is hot")
    link.handshake(20.0)
    with pytest.raises(LiveError, match="reports a fault: motor 3 is hot"):
        link.require_alive(0.5)


class Robot:
    """Sends joint targets to a driver on a clock that stands."""

    def __init__(self, folder):
        self.endpoint, self.clock = f"ipc://{folder}/robot", Clock(0.0)
        self.bus, self.sequence = open_zmq_bus(self.endpoint), 0

    def driver(self, position: Sequence[float] = (0.0, 0.0)) -> JointDriver:
        driver = JointDriver(
            self.endpoint, ["a", "b"], np.array(position), -np.ones(2), np.ones(2), 2.0,
            clock=self.clock, sleep=lambda seconds: setattr(self.clock, "now", self.clock.now + seconds),
        )  # fmt: skip

        def connected() -> bool:
            self.send([0.0, 0.0])
            driver.step(np.zeros(2))
            return driver._newest is not None and bool(self.bus.fetch())

        wait_for(connected, 20.0, lambda: "not connected")
        return driver

    def send(self, q) -> None:
        self.sequence += 1
        self.bus.send(JointTargets(self.sequence, 0.0, ["a", "b"], [*q], [0.0, 0.0], True, 0.1))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"names": ["a", "a"]}, "a name occurs twice in names: a, a"),
        ({"position": [np.nan, 0.0]}, "position of joint 'a' must be finite, not nan"),
        ({"position": [0.0]}, r"position must be 2 numbers, not of shape \(1,\)"),
        ({"position": 0.0}, r"position must be 2 numbers, not of shape \(\)"),
        ({"upper": [1.0, np.nan]}, "upper of joint 'b' must be finite, not nan"),
        ({"speed": np.inf}, "speed of joint 'a' must be finite, not inf"),
        ({"lower": 2.0}, "lower limit 2 of joint 'a' is above upper 1 rad"),
        ({"speed": [1.0, -1.0]}, "speed of joint 'b' must be positive, not -1 rad/s"),
        ({"rate": 0.0}, "rate must be positive, not 0 Hz"),
        ({"endpoint": "tcp://127.0.0.1"}, "address 'zmq.tcp://127.0.0.1'"),
        ({"endpoint": "tcp://127.0.0.1:leap"}, "give one of"),
        ({"endpoint": "tcp://127.0.0.1:65535"}, "give one of"),  # states need the next port
    ],
)
def test_a_driver_refuses_what_would_move_the_motors_wrongly(tmp_path, change, expected):
    sound = {
        "endpoint": f"ipc://{tmp_path}/robot", "names": ["a", "b"], "position": [0.0, 0.0], "lower": -1.0,
        "upper": [1.0, 1.0], "speed": 2.0,
    }  # fmt: skip
    JointDriver(**sound).bus.close()
    with pytest.raises(LiveError, match=expected):
        JointDriver(**sound | change)


def test_a_driver_holds_while_a_position_cannot_be_read(tmp_path):
    """One such reading is not reported and stops nothing; the next sound one goes on."""
    robot = Robot(tmp_path)
    driver = robot.driver()
    robot.bus.fetch()
    step_after(driver, lambda: robot.send([0.5, 0.5]))
    before = driver.step(np.zeros(2))
    assert not driver.holding
    np.testing.assert_array_equal(driver.step(np.array([np.nan, 0.0])), before)
    assert driver.holding
    assert (driver.step(np.zeros(2)) > before).all() and not driver.holding
    with pytest.raises(LiveError, match="2 measured positions are needed"):
        driver.step(np.zeros(3))


def test_a_robot_outside_its_limits_moves_back_at_its_speed(tmp_path):
    """A jump to the limit would be a blow."""
    robot = Robot(tmp_path)
    driver = robot.driver([1.8, 0.0])
    path = [step_after(driver, lambda: robot.send([5.0, 0.0]))[0] for _ in range(50)]
    assert path[0] > 1.5 and path[-1] == 1.0
    assert np.abs(np.diff(path)).max() <= 2.0 * 0.01 + 1e-12


def step_after(driver: JointDriver, send) -> np.ndarray:
    """A driver's step once a message has come; ZeroMQ drops what it cannot send at once."""

    def came() -> bool:
        send()
        return bool(driver.bus._receiver._socket.poll(100))

    wait_for(came, 20.0, lambda: "nothing came")
    return driver.step(np.zeros(2))


def test_a_driver_follows_at_its_speed_within_its_limits_and_holds_after_the_deadline(tmp_path):
    robot = Robot(tmp_path)
    driver = robot.driver()
    path = []
    for _ in range(70):
        path.append(step_after(driver, lambda: robot.send([5.0, -0.5])))
        assert not driver.holding
    assert np.abs(np.diff(path, axis=0)).max() <= 2.0 * 0.01 + 1e-12
    np.testing.assert_allclose(path[-1], [1.0, -0.5])
    moved = step_after(driver, lambda: robot.send([-1.0, 1.0]))
    steps = [(driver.step(np.zeros(2)), driver.holding) for _ in range(30)]
    assert np.abs(steps[7][0] - moved).max() > 0.1 and not steps[7][1]
    assert all(holding for _, holding in steps[11:])  # the deadline is 0.1 s
    np.testing.assert_array_equal(steps[11][0], steps[29][0])
    step_after(driver, lambda: robot.bus._sender.send(b"{}"))
    assert driver.bus.refused and "field `sequence`" in driver.bus.last_refusal

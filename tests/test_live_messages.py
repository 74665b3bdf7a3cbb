"""Messages between glove, loop and robot arrive as they were sent, and malformed ones are refused."""

import json
import struct

import numpy as np
import pytest
from drake import lcmt_allegro_command, lcmt_panda_command
from live_messages import manus_glove, manus_words, nodes_of, own_fields

from geort_drake import synthesize_play
from geort_drake.errors import HandError, LiveError, MismatchError
from geort_drake.live.devices import ALLEGRO, PANDA, JointGroup, JointStatus
from geort_drake.live.messages import MAX_BYTES, GloveFrame, decode, encode_frame
from geort_drake.live.transports import LOCAL_LCM, heard_from_outside, is_local, split_address

HAND = synthesize_play(3, duration_s=1.0, rate_hz=30.0).p_HK[20].astype(float)
NODES = manus_glove(nodes_of(HAND))
WORDS = manus_words("aa", nodes_of(HAND))


def dumped(fields: dict) -> bytes:
    return json.dumps(fields).encode()


def own(**changes) -> bytes:
    return dumped(own_fields(HAND, **changes))


def text(words: list[str]) -> bytes:
    return ",".join(words).encode()


# -- gloves


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
        assert (got.side, got.time, got.repaired) == (sent.side, sent.time, False)
        for name in ("p_HK", "X_WH"):
            np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


def test_a_quaternion_of_another_norm_is_scaled():
    """Trackers round; only a norm that is far off makes the message unusable."""
    frame = decode(own(X_WH=[0.54, 0.72, 0, 0, 1, 2, 3]), "right")
    assert frame is not None and frame.repaired
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
    "cut off": (own()[:-1], "not JSON"),
    "deeply nested": (b'{"a":' * 10_000, "not JSON"),
    "another object": (b"{}", "neither of format"),
    "too long": (own() + b" " * MAX_BYTES, "at most 65536 are read"),
    "NaN": (own(time=float("nan")), "NaN is no number"),
    "infinity": (own().replace(b"12.5", b"1e999"), "time must be finite"),
    "a huge integer": (own(time=10**400), "time must be a number"),
    "a missing field": (own(X_WH=...), "differs in X_WH"),
    "flat keypoints": (own(p_HK=HAND[:, :2].tolist()), r"p_HK must be numbers of shape \(21, 3\)"),
    "keypoints of words": (own(p_HK=[["a", "b", "c"]] * 21), "p_HK must be numbers"),
    "keypoints far away": (own(p_HK=(1e4 * HAND).tolist()), "at most 100"),
    "no side": (own(side="both"), "side must be one of left, right"),
    "24 nodes": (dumped({**NODES, "raw_nodes": NODES["raw_nodes"][:24]}), "raw_nodes must be"),
    "a node twice": (dumped({**NODES, "raw_nodes": [NODES["raw_nodes"][0]] * 25}), "node_id from 0 to 24"),
    "nodes of nothing": (dumped({**NODES, "raw_nodes": [None] * 25}), "node_id from 0 to 24"),
    "175 words": (text(WORDS[:175]), "not 175"),
    "words of no number": (text([*WORDS[:9], "x", *WORDS[10:]]), "could not convert"),
    "NaN in text": (text([*WORDS[:8], "nan", *WORDS[9:]]), "must be finite"),
    "a palm that is a point": (text(["a", *["0"] * 175]), "span a plane"),
}
# Another version, unit or hand, and angles in place of positions, which waiting does not mend.
MISMATCHES = {
    "another version": (own(version=2), "version must be 1, not 2"),
    "a version that is no number": (own(version=True), "version must be 1, not True"),
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


# -- robots

DEVICES = pytest.mark.parametrize("device", [ALLEGRO, PANDA], ids=lambda device: device.name)


def status_of(device) -> JointStatus:
    n = len(device.joints)
    return JointStatus(np.arange(n) / 7, -np.arange(n) / 3, np.arange(n) / 9)


@DEVICES
def test_commands_and_statuses_arrive_to_the_last_bit(device):
    """In Drake's messages."""
    sent = status_of(device)
    command = device.decode_command(device.encode_command(1.0, sent.position))
    np.testing.assert_array_equal(command, sent.position)
    got = device.decode_status(device.encode_status(1.0, sent))
    for name in ("position", "velocity", "commanded"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


def test_commands_have_the_fields_that_drivers_expect():
    """Of Drake's message types."""
    command = lcmt_allegro_command.decode(ALLEGRO.encode_command(2.5, np.arange(16.0)))
    assert (command.utime, command.num_joints, command.num_torques) == (2_500_000, 16, 0)
    assert list(command.joint_position) == list(range(16))
    command = lcmt_panda_command.decode(PANDA.encode_command(2.5, np.arange(7.0)))
    assert (command.num_joint_position, command.num_joint_velocity, command.num_joint_torque) == (7, 0, 0)
    assert command.control_mode_expected == 1  # position
    with pytest.raises(LiveError, match="control_mode_expected must be 1, not 3"):
        command.control_mode_expected = 3
        PANDA.decode_command(command.encode())


@DEVICES
def test_malformed_messages_of_robots_are_refused(device):
    """Cut off, of another size, not finite, or with a wrong length inside."""
    n = len(device.joints)
    status, command = device.encode_status(1.0, status_of(device)), device.encode_command(1.0, np.zeros(n))
    sizes = struct.pack(">i", n)
    for decode_it, good in ((device.decode_status, status), (device.decode_command, command)):
        for bad in (
            good[:-1],
            good + b"\0",
            b"\0" * len(good),
            good.replace(sizes, struct.pack(">i", 2**31 - 1), 1),
            good.replace(sizes, struct.pack(">i", -1), 1),
        ):
            with pytest.raises(LiveError, match=device.name):
                decode_it(bad)
    for bad in (np.inf, np.nan):
        with pytest.raises(LiveError, match=r"joint_position must be .* finite numbers"):
            device.decode_command(device.encode_command(1.0, np.full(n, bad)))


def test_a_hand_of_other_joints_is_refused():
    """By the number in its status, and by the names in the model."""
    twelve = JointStatus(*np.zeros((3, 12)))
    with pytest.raises(LiveError, match="Is this the hand that the robot has"):
        ALLEGRO.decode_status(ALLEGRO.encode_status(0.0, twelve))
    with pytest.raises(HandError, match="the model's hand has thumb"):
        ALLEGRO.model_order(JointGroup("hand", ["thumb"], np.zeros(1), np.zeros(1), np.ones(1)))


# -- transports


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
    with pytest.raises(LiveError, match=r"give one of|expected udpm"):
        split_address(address, ("sub", "pull"))


def test_addresses_open_to_the_network_are_recognised():
    """The defaults stay on this machine."""
    assert all(map(is_local, ("lcm", "lcm+udpm://239.1.1.1:7667?ttl=0", "pub+tcp://127.0.0.1:5556")))
    open_to_all = ("lcm+udpm://239.1.1.1:7667?ttl=1", "pub+tcp://*:1", "sub+tcp://10.0.0.1:1")
    assert not any(map(is_local, open_to_all))


def test_an_lcm_group_that_is_routed_to_a_network_is_recognised(tmp_path):
    """The narrowest route counts, and of equal ones the one of the lowest metric."""
    table = tmp_path / "route"
    head = "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"
    default = "eth0\t00000000\t010200C0\t0003\t0\t0\t100\t00000000\t0\t0\t0\n"
    ours = "{}\t434CFFEF\t00000000\t0005\t0\t0\t{}\tFFFFFFFF\t0\t0\t0\n"
    for routes, outside in (
        (default, True),
        (default + ours.format("lo", 0), False),
        (ours.format("lo", 5) + default + ours.format("eth0", 0), True),
        ("", False),
    ):
        table.write_text(head + routes)
        assert heard_from_outside(LOCAL_LCM, table) == outside
    assert heard_from_outside(LOCAL_LCM, tmp_path / "none")

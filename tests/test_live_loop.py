"""The whole loop over loopback: processes of a glove, of teleoperation, and of a simulated robot."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from faults.sound import checkpoint
from pydrake.lcm import DrakeLcm

from geort_drake import synthesize_play
from geort_drake.errors import LiveError
from geort_drake.live.devices import ALLEGRO, PANDA, JointGroup, JointStatus, LcmInbox
from geort_drake.live.robot_link import RobotLink
from geort_drake.live.transports import open_receiver, open_sender, wait_for

# s; a busy machine takes long to start three programs. Without a fault nothing waits so long.
PATIENCE_S = 300.0


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


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    """A folder with a recording and a checkpoint for the Allegro hand."""
    folder = tmp_path_factory.mktemp("live")
    synthesize_play(1, duration_s=20.0, rate_hz=60.0).save(folder / "hand.npz")
    checkpoint(folder)
    return folder


@contextlib.contextmanager
def program(folder: Path, name: str, *arguments: str, stdin: int = subprocess.DEVNULL):
    """Runs a command in a process that is always ended afterwards."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1", "COLUMNS": "200"}
    with open(folder / f"{name}.log", "w") as log, open(folder / f"{name}.json", "w") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "geort_drake", name, *arguments],
            stdin=stdin, stdout=out, stderr=log, env=environment
        )  # fmt: skip
        try:
            yield process
        finally:
            process.kill()
            process.communicate()


def wait_for_text(folder: Path, name: str, text: str) -> None:
    """Waits until a program has printed a text."""

    def poll():
        return True if text in (folder / f"{name}.log").read_text() else None

    wait_for(poll, PATIENCE_S, lambda: f"{name}: no '{text}' in: {(folder / f'{name}.log').read_text()}")


@pytest.mark.slow
def test_the_loop_runs_over_loopback(station, tmp_path, lcm_url):
    """A robot follows a glove; the glove dies, the hand relaxes; Ctrl-C leaves the robot held."""
    inbox = LcmInbox(
        DrakeLcm(lcm_url), {device.status_channel: device.decode_status for device in (ALLEGRO, PANDA)}
    )

    def statuses(count: int) -> list[JointStatus]:
        """The hand's next statuses."""

        def poll():
            inbox.newest.clear()
            inbox.fetch()
            return inbox.newest.get(ALLEGRO.status_channel)

        inbox.fetch()
        return [wait_for(poll, PATIENCE_S, lambda: "the robot fell silent") for _ in range(count)]

    glove = f"ipc://{tmp_path}/glove"
    with (
        program(tmp_path, "stand-in-robot", "--lcm", f"lcm+{lcm_url}"),
        program(
            tmp_path, "publish", str(station / "hand.npz"), "--to", f"pub+{glove}", "--loop"
        ) as publisher,
        program(
            tmp_path, "live", "--glove", f"sub+{glove}", "--robot", f"lcm+{lcm_url}",
            "--retargeter", str(station / "checkpoint"), "--engage", "now", "--relax-after", "0.5",
            "--timeout", str(PATIENCE_S), "--robot-silence", "20", "--json"
        ) as teleoperation
    ):  # fmt: skip
        wait_for_text(tmp_path, "live", "tracking")
        low = high = statuses(1)[0].commanded
        # A busy machine plays the glove slowly: wait for the motion, not for a number of messages.
        deadline = time.monotonic() + PATIENCE_S
        while np.ptp([low, high], axis=0).max() <= 0.1 and time.monotonic() < deadline:
            commanded = statuses(1)[0].commanded
            low, high = np.minimum(low, commanded), np.maximum(high, commanded)
        publisher.kill()
        wait_for_text(tmp_path, "live", "relaxing")
        teleoperation.send_signal(signal.SIGINT)
        assert teleoperation.wait(PATIENCE_S) == 0, (tmp_path / "live.log").read_text()
        statuses(50)  # commands still on their way
        held = statuses(100)

    assert np.ptp([low, high], axis=0).max() > 0.1
    # The robot holds its last command to the last bit.
    assert len({status.commanded.tobytes() for status in held}) == 1
    assert np.isfinite([status.position for status in held]).all()
    wait_for_text(tmp_path, "live", "disengaged: held")
    report = json.loads((tmp_path / "live.json").read_text())
    assert report["glove"]["received"] > 20
    assert report["glove"]["refused"] == report["robot"]["refused"] == 0
    command, echo = (report["latency_s"][name] for name in ("command", "echo"))
    assert command["count"] >= echo["count"] > 10
    assert 0 < command["median"] < echo["median"] <= echo["p99"]
    print("latency, s:", report["latency_s"])


@pytest.mark.slow
def test_a_replay_drives_the_simulation(station, tmp_path):
    """In one process; Enter engages and disengages, and the glove's data are recorded."""
    with program(
        tmp_path, "live", "--glove", str(station / "hand.npz"), "--retargeter", str(station / "checkpoint"),
        "--record", str(tmp_path / "kept.npz"), "--json", stdin=subprocess.PIPE
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


def send_statuses(url: str, hand_position: np.ndarray) -> None:
    """Reports once where hand and arm are."""
    lcm = DrakeLcm(url)
    for device, q in ((ALLEGRO, hand_position), (PANDA, np.zeros(7))):
        lcm.Publish(device.status_channel, device.encode_status(0.0, JointStatus(q, 0 * q, q)))


@pytest.mark.parametrize("pattern", ["pub", "push", "lcm"])
def test_messages_pass_over_a_transport(pattern, request):
    """On loopback; an address of ZeroMQ that is in use is refused."""
    address = request.getfixturevalue("lcm_url") if pattern == "lcm" else "tcp://127.0.0.1:0"
    sender = open_sender(f"{pattern}+{address}")
    address = address if pattern == "lcm" else sender.endpoint
    receiver = open_receiver(f"{pattern.replace('pub', 'sub').replace('push', 'pull')}+{address}")

    def poll():
        sender.send(b"a frame")
        return receiver.drain() or None

    try:
        assert set(wait_for(poll, 20.0, lambda: "nothing came")) == {b"a frame"}
        if pattern != "lcm":
            with pytest.raises(LiveError, match="cannot listen there"):
                open_sender(f"{pattern}+{address}")
    finally:
        receiver.close()
        sender.close()


def test_the_handshake_reports_where_the_robot_stands(lcm_url):
    """In the model's order, within its limits; another robot or none is refused."""
    q = np.linspace(-0.9, 1.05, 16)
    link = RobotLink(lcm_url, *groups(), period=0.01)
    with pytest.raises(LiveError, match="no robot: ALLEGRO_STATUS and PANDA_STATUS did not come"):
        link.handshake(0.01)
    send_statuses(lcm_url, q)
    hand, arm = link.handshake(20.0)
    np.testing.assert_array_equal(hand, np.minimum(q, 1.0)[::-1])
    np.testing.assert_array_equal(arm, np.zeros(7))
    another = RobotLink(lcm_url, *groups(), period=0.01)
    send_statuses(lcm_url, 2 * q)
    with pytest.raises(LiveError, match=r"joint_15 is at 2.100 rad, limits are \[-1.000, 1.000\]"):
        another.handshake(20.0)


def test_a_robot_that_falls_silent_is_not_driven_on(lcm_url):
    """It may be elsewhere when it answers again."""
    now = [5.0]
    link = RobotLink(lcm_url, *groups(), period=0.01, clock=lambda: now[0])
    send_statuses(lcm_url, np.zeros(16))
    link.handshake(20.0)
    now[0] += 0.4
    link.require_alive(0.5)
    now[0] += 0.2
    with pytest.raises(LiveError, match=r"no ALLEGRO_STATUS for 0\.6 s"):
        link.require_alive(0.5)

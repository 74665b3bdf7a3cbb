"""The capture protocol, its demonstration, and what a recording lacks."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rerun.chunk import RrdReader
from shared import shared

from geort_drake import Recording
from geort_drake.cli import run_command
from geort_drake.people.checks import examine
from geort_drake.people.coverage import PINCHES, coverage, describe, finger_motions, pinch_distances, pinches
from geort_drake.people.keypoints import FINGER_KEYPOINTS, FINGER_NAMES
from geort_drake.people.synthetic import protocol
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.protocol import DURATION_S, STEPS, demonstrate


@shared
def demonstration():
    return demonstrate(0, rate_hz=30.0)


@pytest.fixture(scope="module")
def shown():
    """The demonstration at a low rate, and the step of each frame."""
    return demonstration()


def during(shown, *names) -> Recording:
    """The frames of some steps alone."""
    recording, steps = shown
    return replace(recording, valid=np.isin(steps, names))


@pytest.mark.slow
def test_the_demonstration_covers_every_required_motion(shown):
    """Nothing is missing, nothing is wrong, and about a quarter of the time is pinches."""
    recording, steps = shown
    assert recording.duration_s == pytest.approx(DURATION_S, abs=0.1)
    assert DURATION_S == 300
    assert list(dict.fromkeys(steps)) == [step.name for step in STEPS]
    assert [describe(motion) for motion in coverage(recording) if not motion["enough"]] == []
    assert examine(recording).metadata["warnings"] == []
    distance = np.stack(list(pinch_distances(recording).values()))
    assert 0.2 < (distance.min(axis=0) < 0.015).mean() < 0.35


@pytest.mark.slow
@pytest.mark.parametrize("finger", FINGER_NAMES)
def test_each_step_contains_its_motion(shown, finger):
    """Alone, every motion of the finger is enough; without their step, pinches are what lacks."""
    alone = coverage(during(shown, f"{finger} alone", f"thumb to {finger}"))
    ranges = [motion for motion in alone if motion["unit"] == "°"]
    assert all(motion["enough"] for motion in ranges if motion["motion"].startswith(f"{finger} "))
    if finger != "thumb":
        name = f"thumb pinches {finger}"
        assert next(motion for motion in alone if motion["motion"] == name)["enough"]
        rest = coverage(during(shown, *(step.name for step in STEPS if step.name != f"thumb to {finger}")))
        assert [motion["motion"] for motion in rest if not motion["enough"]] in ([], [name])


@pytest.mark.slow
def test_missing_motions_are_reported(shown):
    """A finger that never spreads, and pinches that were not made; bending is not taken for abduction."""
    hand = HumanHand.anatomical()
    free = np.array([name != "ring_mcp_abduction" for name in hand.joint_names])
    lower, upper = free * hand.lower, free * hand.upper
    still, _ = demonstrate(0, 30.0, replace(hand, lower=lower, upper=upper), jitter=0.0)
    (motion,) = [m for m in coverage(still) if not m["enough"]]
    assert re.fullmatch("ring moves sideways: [01] °, required 7", describe(motion))
    assert motion["advice"] == "spread the fingers and close them"
    recording, _ = shown
    p_HK = recording.p_HK.copy()
    away = pinch_distances(recording)["ring"] < 0.03
    p_HK[np.ix_(away, FINGER_KEYPOINTS["ring"])] += [0.0, -0.06, 0.0]
    (motion,) = [m for m in coverage(replace(recording, p_HK=p_HK)) if m["motion"] == "thumb pinches ring"]
    assert describe(motion) == f"thumb pinches ring: 0 times, required {PINCHES}" and not motion["enough"]


def test_a_trembling_pinch_counts_once():
    """Tips must part before they can meet again; a recording may begin with a pinch."""
    apart, near, touch = 0.05, 0.02, 0.01
    assert pinches(np.array([apart, touch, near, touch, apart, near, apart])) == 1
    assert pinches(np.array([touch, apart, touch, touch])) == 2
    assert pinches(np.array([near, near])) == 0


@pytest.mark.slow
def test_the_watch_ends_when_nothing_is_missing(tmp_path, shown, capsys, monkeypatch):
    """A file that grows while it is watched: first something is missing, then nothing."""
    recording, _ = shown
    path = tmp_path / "hand.npz"
    half = len(recording) // 2
    Recording(recording.t[:half], recording.p_HK[:half], recording.valid[:half]).save(path)
    waits = []
    clock = SimpleNamespace(sleep=lambda seconds: (waits.append(seconds), recording.save(path)))
    monkeypatch.setattr("geort_drake.cli.recording.time", clock)
    run_command("recording check", [str(path), "--watch"])
    assert len(waits) == 1 and "coverage: 15 of 15" in capsys.readouterr().err


def swept(joint: str, degrees: float) -> np.ndarray:
    """Keypoints (101, 21, 3) of a hand of which one joint turns evenly by so much, from 10° on."""
    hand = HumanHand.anatomical()
    theta = np.full((101, 20), np.deg2rad(10.0))
    theta[:, hand.joint_names.index(joint)] += np.deg2rad(np.linspace(0.0, degrees, 101))
    return hand.keypoints(theta)


def seen(p_HK, name: str) -> float:
    return next(motion["seen"] for motion in finger_motions(p_HK) if motion["motion"] == name)


def test_ranges_are_the_turns_of_the_joints():
    """Less the percentiles' 2 %; bending is no motion sideways, and none of another finger."""
    for joint in ("index_mcp_flexion", "index_pip_flexion", "index_dip_flexion"):
        p_HK = swept(joint, 50.0)
        # The metacarpal is a little out of the plane in which the first joint bends.
        assert seen(p_HK, "index bends") == pytest.approx(49.0, abs=3.0)
        assert seen(p_HK, "middle bends") == pytest.approx(0.0, abs=1e-6)
    sideways = seen(swept("index_mcp_abduction", 20.0), "index moves sideways")
    assert sideways == pytest.approx(19.6, abs=1.0)
    for finger in FINGER_NAMES[1:]:
        assert seen(swept(f"{finger}_mcp_flexion", 60.0), f"{finger} moves sideways") < 2.0


def test_only_the_trained_fingers_are_measured(play):
    """A still hand lacks every motion of them; other fingers do not matter; play lacks nothing."""
    still = finger_motions(swept("index_mcp_abduction", 0.0), (4, 8))
    assert [motion["motion"] for motion in still if not motion["enough"]] == [
        "thumb bends", "thumb sweeps across the palm", "thumb lifts off the palm",
        "index bends", "index moves sideways",
    ]  # fmt: skip
    assert all(motion["enough"] for motion in finger_motions(play.p_HK))


@pytest.mark.slow
def test_the_demonstration_is_a_rerun_recording(tmp_path, shown, monkeypatch):
    """The hand moves, and a lane names the steps in their order."""
    output = tmp_path / "protocol.rrd"
    monkeypatch.setattr(protocol, "demonstrate", lambda seed: shown)
    run_command("recording protocol", ["--output", str(output)])
    steps: list[str] = []
    drawn = 0
    for chunk in RrdReader(output).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == "/step" and "StateChange:state" in batch.schema.names:
            steps += batch.column("StateChange:state").flatten().to_pylist()
        if chunk.entity_path == "/world/human/keypoints" and "sim_time" in batch.schema.names:
            drawn += batch.num_rows
    assert steps == [step.name for step in STEPS]
    assert drawn == pytest.approx(30 * DURATION_S, abs=2)

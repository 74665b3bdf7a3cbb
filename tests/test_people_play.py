"""Synthetic play: reproducible, inside the limits, and in the range that real recordings span."""

import time

import numpy as np
import pytest

from geort_drake.people.checks import check_recording
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.people.summary import summarize

# Statistics of two real recordings (summary.summarize): "GeoRT" is human_alex.npy of GeoRT's authors
# (30 Hz assumed), "MANUS" is subject 000, run 010, of mimic_retargeter_lab's MANUS Metagloves Pro
# recordings. Fingers thumb to little.
REAL = {
    "GeoRT": {
        # 0.5th and 99.5th percentile of the tips, mm, as low xyz, high xyz
        "workspace": [
            [4.9, -13.9, 59.3, 62.6, 95.0, 89.9],
            [-34.4, 8.9, 58.6, 66.9, 33.5, 154.8],
            [-27.5, -6.8, 60.3, 67.7, 19.0, 166.0],
            [-20.3, -27.5, 59.1, 58.9, 2.3, 146.0],
            [-19.5, -50.9, 54.6, 54.8, -16.0, 133.7],
        ],
        # standard deviations along the clouds' principal axes, mm
        "principal_std": [
            [24.3, 13.2, 5.1],
            [42.4, 20.5, 4.4],
            [41.4, 25.5, 3.3],
            [36.8, 19.9, 3.3],
            [29.3, 16.9, 5.0],
        ],
        "speed_median": [34.5, 29.7, 34.0, 27.2, 23.2],  # mm/s
        "speed_p95": [262.3, 460.4, 445.0, 375.4, 283.0],
        "pinch_share": [18.1, 10.1, 5.7, 0.0],  # % of frames, thumb within 15 mm of index ... little
        "any_pinch_share": 30.6,
    },
    "MANUS": {
        "workspace": [
            [-3.9, -26.9, 87.0, 89.4, 100.9, 131.8],
            [-39.1, -6.3, 65.2, 89.8, 52.2, 185.7],
            [-31.3, -38.8, 53.2, 92.6, 27.7, 194.2],
            [-30.5, -57.4, 51.2, 93.1, 16.7, 183.7],
            [-14.9, -80.7, 62.7, 72.3, -14.1, 149.1],
        ],
        "principal_std": [
            [43.5, 16.2, 8.2],
            [42.3, 23.0, 10.6],
            [47.7, 22.5, 9.8],
            [47.5, 23.0, 9.0],
            [30.4, 14.4, 8.9],
        ],
        "speed_median": [64.1, 91.6, 134.9, 121.2, 64.2],
        "speed_p95": [595.3, 1109.1, 1128.4, 1114.5, 652.2],
        "pinch_share": [7.1, 8.8, 8.3, 10.1],
        "any_pinch_share": 34.3,
    },
}
# How far outside the two real recordings' figures the synthetic ones may be.
FACTOR = 1.35
WORKSPACE_MM = 20.0


def in_table_units(summary):
    """The summary's figures in the units of the table above."""
    return {
        "workspace": 1e3 * np.moveaxis(summary.workspace, -1, 1).reshape(5, 6),
        "principal_std": 1e3 * summary.principal_std,
        "speed_median": 1e3 * summary.speed_median,
        "speed_p95": 1e3 * summary.speed_p95,
        "pinch_share": 100 * summary.pinch_share,
        "any_pinch_share": 100 * summary.any_pinch_share,
    }


@pytest.fixture(scope="module", params=[0, 7])
def play(request):
    return synthesize_play(request.param)


@pytest.mark.parametrize(("name", "fixture"), [("GeoRT", "alex_npy"), ("MANUS", "manus_npz")])
def test_the_table_of_real_figures_is_right(name, fixture, request):
    """The embedded figures are those of the files, where these are at hand."""
    measured = in_table_units(summarize(read_recording(request.getfixturevalue(fixture))))
    for quantity, value in REAL[name].items():
        np.testing.assert_allclose(measured[quantity], value, atol=0.06, err_msg=quantity)


@pytest.mark.parametrize("quantity", ["principal_std", "speed_median", "speed_p95", "any_pinch_share"])
def test_play_lies_between_real_recordings(play, quantity):
    """Cloud thickness, speeds and pinch share lie between the real ones, within a factor of 1.35."""
    real = np.array([REAL[name][quantity] for name in REAL])
    made = in_table_units(summarize(play))[quantity]
    assert (made > real.min(axis=0) / FACTOR).all(), made
    assert (made < real.max(axis=0) * FACTOR).all(), made


def test_play_fills_the_real_workspaces(play):
    """Each tip's workspace lies in the box that the two real ones span, grown by 20 mm, and is not
    smaller than the smaller one by over a quarter."""
    real = np.array([REAL[name]["workspace"] for name in REAL])
    made = in_table_units(summarize(play))["workspace"]
    assert (made[:, :3] > real.min(axis=0)[:, :3] - WORKSPACE_MM).all()
    assert (made[:, 3:] < real.max(axis=0)[:, 3:] + WORKSPACE_MM).all()
    extents = real[..., 3:] - real[..., :3]
    assert (made[:, 3:] - made[:, :3] > 0.75 * extents.min(axis=0)).all()


def test_every_finger_is_pinched_and_the_tips_really_meet(play):
    """Each finger is within 15 mm of the thumb in 4–12 % of frames, 20–35 % in all, and touches to 5 mm."""
    summary = summarize(play)
    assert ((summary.pinch_share > 0.04) & (summary.pinch_share < 0.12)).all()
    assert 0.20 < summary.any_pinch_share < 0.35
    p_HF = play.fingertips()
    distance = np.linalg.norm(p_HF[:, 1:] - p_HF[:, :1], axis=-1)
    assert (distance.min(axis=0) < 0.005).all()
    # Held at varied places: where a finger is pinched spreads over centimetres.
    for finger in range(1, 5):
        places = p_HF[distance[:, finger - 1] < 0.012, finger]
        assert (places.std(axis=0).max() > 0.006) and (np.ptp(places, axis=0).max() > 0.03)


def test_clouds_are_volumes_not_curves(play):
    """Every tip visits at least 1500 different 1 mm voxels, as many as in GeoRT's own recording."""
    for i, finger in enumerate(FINGER_NAMES):
        voxels = np.unique(np.floor(1e3 * play.fingertips()[:, i]).astype(int), axis=0)
        assert len(voxels) > 1500, finger


def test_play_passes_the_checks_for_training(play):
    """Five minutes at 120 Hz, without a single warning."""
    assert len(play) == 36_000
    assert play.rate_hz == pytest.approx(120.0)
    assert check_recording(play, training=True).metadata["warnings"] == []


def test_motion_is_smooth_and_noise_is_that_of_a_glove(play):
    """Tips move without jumps (under 4 m/s); while slow, second differences stay below a glove's 0.27 mm."""
    p_HF = play.fingertips()
    speed = np.linalg.norm(np.diff(p_HF, axis=0), axis=-1) * play.rate_hz
    assert speed.max() < 4.0
    second = 1e3 * np.linalg.norm(np.diff(p_HF, n=2, axis=0), axis=-1)
    assert 0.05 < np.median(second[speed[1:] < 0.02]) < 0.27


def test_joints_stay_in_their_limits_and_bones_keep_their_length():
    """The recorded hand is the hand asked for: its angles fit back inside the limits."""
    hand = HumanHand.anatomical(0.175, 0.08)
    play = synthesize_play(2, duration_s=20.0, hand=hand)
    theta = hand.fit_angles(play.p_HK)
    np.testing.assert_allclose(hand.keypoints(theta), play.p_HK, atol=1e-5)
    assert (theta >= hand.lower).all()
    assert (theta <= hand.upper).all()


def test_the_seed_decides_everything():
    """Equal seeds give equal recordings, a generator works as well, and other seeds differ."""
    first, second = (synthesize_play(5, duration_s=8.0) for _ in range(2))
    assert first.digest == second.digest
    assert synthesize_play(np.random.default_rng(5), duration_s=8.0).digest == first.digest
    assert synthesize_play(6, duration_s=8.0).digest != first.digest


def test_duration_rate_and_noise_are_arguments():
    """Frames follow duration and rate; without noise a faster rate samples the same motion."""
    slow = synthesize_play(1, duration_s=10.0, rate_hz=30.0, jitter=0.0)
    fast = synthesize_play(1, duration_s=10.0, rate_hz=120.0, jitter=0.0)
    assert (len(slow), len(fast)) == (300, 1200)
    np.testing.assert_allclose(fast.p_HK[::4], slow.p_HK, atol=1e-6)
    with pytest.raises(ValueError, match="must be positive"):
        synthesize_play(1, duration_s=0.0)


def test_a_hand_that_cannot_pinch_plays_without_pinches():
    """With the thumb held abducted no pinch is reached, none is faked, and play goes on."""
    hand = HumanHand.anatomical()
    lower, upper = hand.lower.copy(), hand.upper.copy()
    upper[:4] = np.deg2rad([0, -20, 5, 5])
    stiff = HumanHand(hand.p_HB, hand.R_HB, hand.twist, hand.lengths, lower, upper)
    summary = summarize(synthesize_play(1, duration_s=60.0, hand=stiff))
    assert summary.any_pinch_share < 0.01
    assert (summary.speed_p95[1:] > 0.1).all()


def test_five_minutes_are_made_in_seconds():
    """36,000 frames take well under five seconds of processor time."""
    start = time.process_time()
    synthesize_play(9)
    assert time.process_time() - start < 5.0

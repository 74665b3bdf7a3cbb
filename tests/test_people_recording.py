"""Recordings: their file, their statistics, and every kind of bad data that must not pass."""

import dataclasses
import json

import numpy as np
import pytest

from geort_drake.errors import RecordingError
from geort_drake.people.checks import check_recording
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.people.summary import fingertip_speeds, pinch_distances, summarize


def moving_hand(frames=400, rate_hz=100.0, open_thumb=False):
    """Every joint swings about its middle, each at its own pace; in frame 100 thumb and index meet."""
    hand = HumanHand.anatomical()
    t = np.arange(400) / rate_hz
    phase = 2 * np.pi * t[:, None] * (0.5 + 0.05 * np.arange(20))
    theta = 0.5 * (hand.lower + hand.upper) + 0.4 * (hand.upper - hand.lower) * np.sin(phase)
    pinch = np.deg2rad([25, 0, 15, 40, -5, 35, 55, 40, *[0, 30, 30, 20] * 3])
    for _ in range(10):
        tips = hand.fingertips(pinch)
        tips[:2] = tips[:2].mean(axis=0)
        pinch = hand.solve_fingertips(tips, pinch)
    near = np.clip(1.0 - np.abs(np.arange(400) - 100) / 30, 0.0, 1.0)[:, None]
    theta += near * (pinch - theta)
    if open_thumb:
        theta[:, :4] = np.deg2rad([30, -20, 0, 0]) + 0.1 * np.sin(phase[:, :4])
    p_HK = hand.keypoints(theta)[:frames]
    return Recording(t[:frames], p_HK, np.ones(frames, bool), None, {"side": "right"})


def changed(recording, **changes):
    return dataclasses.replace(recording, **changes)


def test_a_recording_survives_saving_and_loading(tmp_path):
    """All arrays, the metadata and the digest are the same after a round trip through the file."""
    recording = moving_hand()
    pose = np.tile([1.0, 0, 0, 0, 0.1, 0.2, 0.3], (len(recording), 1))
    recording = changed(recording, X_WH=pose, metadata={"side": "left", "subject": "ä", "warnings": ["w"]})
    recording.save(tmp_path / "r.npz")
    loaded = Recording.load(tmp_path / "r.npz")
    for name in ("t", "p_HK", "valid", "X_WH"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(recording, name))
    assert loaded.digest == recording.digest
    assert loaded.metadata == {**recording.metadata, "convention": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]


def test_the_digest_tells_recordings_apart():
    """Changing one keypoint, a flag, a time or the side changes the digest; a comment does not."""
    recording = moving_hand()
    moved, lost, later = recording.p_HK.copy(), recording.valid.copy(), recording.t.copy()
    moved[3, 4, 0] += 1e-6
    lost[5] = False
    later[-1] += 1e-9
    others = [
        changed(recording, p_HK=moved),
        changed(recording, valid=lost),
        changed(recording, t=later),
        changed(recording, metadata={"side": "left"}),
    ]
    assert len({recording.digest, *(other.digest for other in others)}) == 5
    assert changed(recording, metadata={"side": "right", "note": "x"}).digest == recording.digest


def test_rate_ignores_gaps_and_fingertips_ignore_lost_frames():
    """A gap of a second leaves the rate at 100 Hz; invalid frames do not show in fingertips."""
    recording = moving_hand()
    t, valid = recording.t.copy(), recording.valid.copy()
    t[200:] += 1.0
    valid[10:20] = False
    recording = changed(recording, t=t, valid=valid)
    assert recording.rate_hz == pytest.approx(100.0, rel=1e-6)
    assert recording.fingertips([8, 4]).shape == (390, 2, 3)
    np.testing.assert_array_equal(recording.fingertips([8, 4])[10], recording.p_HK[20][[8, 4]])


def test_a_good_recording_passes_with_no_change_to_its_data():
    """Checking leaves arrays alone and only notes what the hand never pinched."""
    recording = moving_hand()
    checked = check_recording(recording, training=True)
    assert checked.digest == recording.digest
    again = check_recording(checked)
    assert again.metadata == checked.metadata


def test_speeds_of_a_steady_motion_are_known_and_repeats_are_dropped():
    """Tips that move at 0.2 m/s are said to, also when every third frame is stored twice."""
    frames, rate = 90, 60.0
    t = np.arange(frames) / rate
    travelled = 0.2 * t
    travelled[2::3] = travelled[1::3]
    p_HK = np.tile(moving_hand(2).p_HK[0], (frames, 1, 1)).astype(float)
    p_HK[:, :, 0] += travelled[:, None]
    recording = Recording(t, p_HK, np.ones(frames, bool))
    speeds = fingertip_speeds(recording)
    # Of three steps one is new after one period and one after two, both at 0.2 m/s on average.
    assert len(speeds) == pytest.approx(60, abs=1)
    np.testing.assert_allclose(speeds[2:].mean(), 0.2, rtol=0.02)
    valid = np.ones(frames, bool)
    valid[30] = False
    assert len(fingertip_speeds(changed(recording, valid=valid))) < len(speeds)


def test_summary_of_a_box_of_points_is_that_of_a_uniform_distribution(rng):
    """Extents and principal deviations of tips drawn from a known box are the box's."""
    frames, size = 20_000, np.array([0.06, 0.03, 0.012])
    p_HK = np.tile(moving_hand(2).p_HK[0], (frames, 1, 1)).astype(float)
    p_HK[:, 4::4] = rng.uniform(-0.5, 0.5, (frames, 5, 3)) * size
    summary = summarize(Recording(np.arange(frames) / 100, p_HK, np.ones(frames, bool)))
    extent = summary.workspace[..., 1] - summary.workspace[..., 0]
    np.testing.assert_allclose(extent, np.tile(0.99 * size, (5, 1)), rtol=0.02)
    np.testing.assert_allclose(summary.principal_std, np.tile(size / np.sqrt(12), (5, 1)), rtol=0.03)


def test_pinches_are_counted_per_finger():
    """Frames made with the ring tip 10 mm from the thumb tip are counted, for ring alone."""
    recording = moving_hand()
    p_HK = recording.p_HK.copy()
    p_HK[:, 4] = [0.3, 0.3, 0.3]
    p_HK[50:57, 16] = p_HK[50:57, 4] + np.float32([0.010, 0, 0])
    distances = pinch_distances(changed(recording, p_HK=p_HK))
    counts = {finger: int((d < PINCH_M).sum()) for finger, d in distances.items()}
    assert counts == {"index": 0, "middle": 0, "ring": 7, "little": 0}


def spoil(recording, kind):
    p_HK, t, valid = recording.p_HK.copy(), recording.t.copy(), recording.valid.copy()
    X_WH = None
    if kind == "millimetres":
        p_HK = p_HK * 1000
    elif kind == "doll":
        p_HK = p_HK * 0.3
    elif kind == "mirrored":
        p_HK = p_HK * np.float32([-1, 1, 1])
    elif kind == "many NaN":
        p_HK[100:180] = np.nan
    elif kind == "all invalid":
        valid[:] = False
    elif kind == "bones":
        p_HK = p_HK * (1 + 0.35 * np.sign(np.sin(np.arange(len(t)) * 2.0)))[:, None, None]
    elif kind == "coincide":
        p_HK[:, 7] = p_HK[:, 8]
    elif kind == "backwards":
        t[120] = t[118]
    elif kind == "t NaN":
        t[7] = np.nan
    elif kind == "finger frozen":
        p_HK[:, 13:17] = p_HK[0, 13:17]
    elif kind == "all frozen":
        p_HK[80:] = p_HK[80]
    elif kind == "pose NaN":
        X_WH = np.full((len(t), 7), np.nan)
    return Recording(t, p_HK, valid, X_WH, recording.metadata)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (
            "millimetres",
            r"file\.npy: wrist to middle knuckle must be 60 to 110 mm, but is 84.\d+ m.*millimetres",
        ),
        ("doll", r"must be 60 to 110 mm, but is 0.0254\d* m .*; give keypoints in metres"),
        ("mirrored", r"bend backwards .* left hand .* side 'left'"),
        ("many NaN", r"80 of 400 frames are not finite numbers, the first is frame 100"),
        ("all invalid", r"only 0 of 400 frames are valid"),
        ("bones", r"bone \d+–\d+ changes its length by 3\d %"),
        ("coincide", r"keypoints 7 and 8 coincide"),
        ("backwards", r"t must increase, but frame 120 has 1\.18\d+ s after 1\.19\d+ s"),
        ("t NaN", r"t is not a finite number in frame 7"),
        ("finger frozen", r"frozen signal: the tip of ring moves by less than 1 mm in 4\.0 s"),
        ("all frozen", r"frozen signal: frames repeat for 3\.2 s from frame 80"),
        ("pose NaN", r"400 of 400 frames are not finite numbers"),
    ],
)
def test_bad_recordings_are_refused_with_one_clear_message(kind, message):
    """Each fault is named with the file, the field or frame, what was wanted and what was given."""
    with pytest.raises(RecordingError, match=message):
        check_recording(spoil(moving_hand(), kind), "file.npy")


def test_a_hand_that_never_bends_cannot_be_told_left_from_right():
    """A hand that moves at the knuckles alone passes with a warning that its side was not checked."""
    recording = moving_hand()
    theta = np.zeros((400, 20))
    theta[:, 1::4] = 0.3 * np.sin(recording.t)[:, None]
    checked = check_recording(changed(recording, p_HK=HumanHand.anatomical().keypoints(theta)))
    assert any(
        "left or a right hand cannot be checked" in warning for warning in checked.metadata["warnings"]
    )


def test_a_few_lost_frames_become_invalid_with_a_warning():
    """Three NaN frames of 400 are marked invalid and named; the data is otherwise kept."""
    recording = moving_hand()
    p_HK = recording.p_HK.copy()
    p_HK[[30, 31, 90], 5] = np.nan
    checked = check_recording(changed(recording, p_HK=p_HK), "f")
    assert np.flatnonzero(~checked.valid).tolist() == [30, 31, 90]
    assert checked.metadata["warnings"][0] == (
        "3 of 400 frames are not finite numbers, the first is frame 30 (p_HK[30]); marked invalid"
    )


@pytest.mark.parametrize(
    ("spread", "expected"), [(0.01, None), (0.08, "a tracker's noise")], ids=["glove", "camera"]
)
def test_bones_may_vary_as_camera_trackers_do(spread, expected, rng):
    """1 % variation is a glove, 8 % passes with a warning (MediaPipe shows 4–16 %)."""
    recording = moving_hand()
    scale = 1 + spread * rng.normal(size=(len(recording), 1, 1))
    checked = check_recording(changed(recording, p_HK=recording.p_HK * scale))
    found = [warning for warning in checked.metadata["warnings"] if "changes its length" in warning]
    assert len(found) == (expected is not None)
    assert all(expected in warning for warning in found)


def test_gaps_and_short_stalls_are_noted():
    """A one-second gap and a stall of 0.8 s leave the recording usable and are both reported."""
    recording = moving_hand()
    t, p_HK = recording.t.copy(), recording.p_HK.copy()
    t[300:] += 1.0
    p_HK[110:190] = p_HK[110]
    warnings = check_recording(changed(recording, t=t, p_HK=p_HK)).metadata["warnings"]
    assert any("1 gaps in time, the longest 1.01 s before frame 300" in warning for warning in warnings)
    assert any("frames repeat for 0.8 s from frame 110" in warning for warning in warnings)


def test_training_asks_for_more_than_replay():
    """Short recordings and ones without a pinch replay with a warning but do not train."""
    recording = moving_hand()
    short = Recording(
        recording.t[:250], recording.p_HK[:250], recording.valid[:250], None, recording.metadata
    )
    assert any("250 valid frames" in warning for warning in check_recording(short).metadata["warnings"])
    with pytest.raises(RecordingError, match="f: 250 valid frames, training needs at least 300"):
        check_recording(short, "f", training=True)
    open_hand = moving_hand(open_thumb=True)
    assert any(
        "never comes within 15 mm" in warning for warning in check_recording(open_hand).metadata["warnings"]
    )
    with pytest.raises(RecordingError, match=r"f: no pinch: .*; nearest: index \(\d+ mm\)"):
        check_recording(open_hand, "f", training=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": np.zeros((400, 1))}, "t must have shape"),
        ({"p_HK": np.zeros((400, 20, 3))}, r"p_HK must have shape \(400, 21, 3\), not \(400, 20, 3\)"),
        ({"valid": np.ones(399, bool)}, r"valid must have shape \(400,\), not \(399,\)"),
        ({"X_WH": np.zeros((400, 6))}, r"X_WH must have shape \(400, 7\)"),
    ],
)
def test_arrays_of_the_wrong_shape_are_refused(change, message):
    """The field and both shapes are named."""
    with pytest.raises(RecordingError, match=message):
        changed(moving_hand(), **change)


def stored(tmp_path, **changes):
    recording = moving_hand(20)
    fields = {
        "t": recording.t,
        "p_HK": recording.p_HK,
        "valid": recording.valid,
        "metadata": np.array(json.dumps({"side": "right", "convention": 1})),
        **changes,
    }
    path = tmp_path / "r.npz"
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": None, "valid": None}, "not a recording, it lacks t, valid"),
        ({"metadata": np.array("{")}, "metadata is not JSON"),
        ({"metadata": np.array('{"convention": 1}')}, "must name a side, one of: left, right"),
        (
            {"metadata": np.array('{"side": "right", "convention": 7}')},
            "convention 7 is not the one read here, 1",
        ),
        ({"p_HK": np.zeros((20, 25, 3))}, r"r\.npz: p_HK must have shape \(20, 21, 3\)"),
        ({"metadata": np.array([{"side": "right"}], dtype=object)}, "pickled objects, which are never read"),
    ],
)
def test_malformed_files_are_refused(tmp_path, changes, message):
    """A file that lacks a field, is of another convention or holds pickles is named and refused."""
    with pytest.raises(RecordingError, match=message):
        Recording.load(stored(tmp_path, **changes))


def test_an_interrupted_save_leaves_the_old_file(tmp_path, monkeypatch):
    """When writing fails, the file that was there is intact and no draft is left."""
    path = tmp_path / "r.npz"
    moving_hand(20).save(path)
    before = path.read_bytes()

    def fail(*args, **kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="disk full"):
        moving_hand(30).save(path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["r.npz"]


def test_only_npz_is_written(tmp_path):
    """Another suffix is refused rather than silently changed."""
    with pytest.raises(RecordingError, match=r"saved as \.npz, not '\.pkl'"):
        moving_hand(20).save(tmp_path / "r.pkl")

"""Every format is read: files written by its documentation come back as the hand they were written from."""

import dataclasses as dc
import pickle

import glove_files as gloves
import numpy as np
import pytest
from glove_files import FRAMES, moving, random_hand
from scipy.spatial.transform import Rotation

from geort_drake import read_recording
from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.checks import examine
from geort_drake.people.coverage import pinch_distances
from geort_drake.people.formats.unpickling import load_plain
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import bone_lengths
from geort_drake.people.readers import ASSUMED_RATE_HZ, open_recording
from geort_drake.people.recording import PINCH_M

# Files that hold the wrist's pose in the world.
POSED = set(gloves.WRITERS) - {"geort", "mediapipe", "mediapipe_npy", "mano_npy", "dex_retargeting"}


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("written", gloves.WRITERS)
def test_a_file_gives_back_the_hand_it_was_written_from(tmp_path, written, side):
    """Keypoints in H to 1e-6 m, times, the wrist's pose, and the format, which is detected."""
    hand = random_hand(1, side)
    recording, _ = open_recording(gloves.WRITERS[written](tmp_path, hand), side)
    np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
    assert recording.valid.all()
    assert recording.side == side
    assert recording.metadata.get("format", "geort_drake") == gloves.NAMES[written]
    wanted = hand.t if written in gloves.TIMED else np.arange(len(hand.t)) / ASSUMED_RATE_HZ
    np.testing.assert_allclose(recording.t, wanted, atol=1e-6)
    assert recording.metadata.get("rate_known", True) == (written in gloves.TIMED)
    assert (recording.X_WH is not None) == (written in POSED)
    if written in POSED:
        # The world of a left hand is mirrored with it, which our own format has done already.
        mirror = [1, -1, 1] if side == "left" and written != "own" else [1, 1, 1]
        np.testing.assert_allclose(recording.X_WH[:, 4:], hand.p_WH * mirror, atol=1e-6)
    if written in POSED and side == "right":
        R_WH = Rotation.from_quat(recording.X_WH[:, :4], scalar_first=True).as_matrix()
        np.testing.assert_allclose(R_WH, hand.R_WH, atol=1e-5)


@pytest.mark.parametrize("written", gloves.WRITERS)
def test_a_sound_file_has_no_finding(tmp_path, written):
    """The moving hand is found sound in every format, but for missing times where the format has none."""
    recording, findings = open_recording(gloves.WRITERS[written](tmp_path, moving()))
    findings += examine(recording)[1]
    assert [finding.check for finding in findings] == ([] if written in gloves.TIMED else ["timestamps"])


def test_the_named_format_reads_the_same_as_the_one_detected(tmp_path):
    """Naming the format changes nothing; naming another says what it expected."""
    path = gloves.WRITERS["openxr"](tmp_path, moving())
    assert read_recording(path, format="openxr").digest == read_recording(path).digest
    with pytest.raises(RecordingError, match=r"lacks data; it contains joints\(400, 26, 7\), t"):
        open_recording(path, format="manus")
    with pytest.raises(RecordingError, match=r"'manus_csv' is read from \.csv files, not '\.npz'"):
        open_recording(path, format="manus_csv")
    with pytest.raises(UnknownNameError, match="unknown format 'leap'; choose one of: auto, dex_retargeting"):
        open_recording(path, format="leap")
    with pytest.raises(UnknownNameError, match="unknown side 'both'; choose one of: left, right"):
        read_recording(path, "both")
    path = gloves.WRITERS["geort"](tmp_path, moving())
    assert read_recording(path.rename(tmp_path / "HAND.NPY")).metadata["format"] == "geort"


@pytest.mark.parametrize(
    ("write", "order"),
    [(gloves.write_openxr, gloves.openxr_order()), (gloves.write_webxr, gloves.FROM_WRIST_25)],
)
def test_joints_may_be_points_poses_or_transforms(tmp_path, write, order):
    """All three give the same keypoints; matrices are read with the translation in the last column."""
    hand = random_hand(5, "right")
    p = gloves.stacked(hand.joints(), order)
    for joints in (p, gloves.poses(p, [0.5, 0.5, -0.5, 0.5]), gloves.transforms(p, hand.R_WH[:, None])):
        recording, findings = open_recording(write(tmp_path, hand, joints=joints))
        np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
        assert findings == []


@pytest.mark.parametrize("unit", ["cm", "mm"])
def test_a_stated_unit_is_converted(tmp_path, unit):
    """A CSV in another unit is refused with the unit it seems to have, and read with it."""
    hand, scale = moving(), {"cm": 100.0, "mm": 1000.0}[unit]
    scaled = type(hand)(scale * hand.p_HK, hand.t, hand.R_WH, scale * hand.p_WH)
    path = gloves.write_manus_csv(tmp_path, scaled, delimiter=";")
    with pytest.raises(RecordingError, match=f"60 to 110 mm.*convert it with --unit {unit}"):
        read_recording(path)
    np.testing.assert_allclose(read_recording(path, unit=unit).p_HK, hand.p_HK, atol=1e-6)
    with pytest.raises(UnknownNameError, match="unknown unit 'feet'"):
        read_recording(path, unit="feet")
    with pytest.raises(RecordingError, match="own files are in metres, not in mm"):
        read_recording(gloves.write_own(tmp_path, hand), unit="mm")


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_published_manus_export_is_read(tmp_path, side):
    """Other names, centimetres, left-handed axes, a frame that goes with the hand; the name has the side."""
    hand = dc.replace(moving(), side=side)
    table = gloves.published_manus_table(hand)
    path = gloves.write_manus_csv(tmp_path, hand, table, name=f"take 1_{side[0].upper()}")
    recording = read_recording(path, side)
    np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
    assert recording.X_WH is None
    (warning,) = recording.metadata["warnings"]
    assert f"axes are left-handed: by the file's name a {side} hand" in warning
    other = "left" if side == "right" else "right"
    with pytest.raises(RecordingError, match=f"contains a {side} hand, a {other} one was requested"):
        read_recording(path, other)
    with pytest.raises(RecordingError, match="in mirrored axes"):
        read_recording(gloves.write_manus_csv(tmp_path, hand, table), side)


def zeros(folder, hand, empty):
    joints = gloves.poses(gloves.stacked(hand.joints(), gloves.openxr_order()), [0, 0, 0, 1.0])
    joints[empty] = 0.0
    return gloves.write_openxr(folder, hand, joints=joints)


def identities(folder, hand, empty):
    """Vision Pro's stream of a hand that is not seen."""
    arrays = gloves.vision_pro_arrays(hand)
    for name in ("right_fingers", "right_wrist"):
        arrays[name][empty] = np.eye(4)
    return gloves.write_vision_pro(folder, hand, **arrays)


def inactive(folder, hand, empty):
    """OpenXR's isActive, and no joints."""
    contents = gloves.openxr_frames(hand)
    for i in empty:
        contents["frames"][i] |= {"isActive": False, "joints": []}
    return gloves.write_openxr_json(folder, hand, contents)


@pytest.mark.parametrize("write", [zeros, identities, inactive])
def test_frames_in_which_a_tracker_saw_no_hand_are_lost(tmp_path, write):
    """Whatever it stores in them; too many of them are refused."""
    hand = moving()
    recording = read_recording(write(tmp_path, hand, [0, 7, 8]))
    assert np.flatnonzero(~recording.valid).tolist() == [0, 7, 8]
    np.testing.assert_allclose(recording.p_HK[recording.valid], hand.p_HK[recording.valid], atol=1e-6)
    assert "3 of 400 frames show no hand, the first is frame 0" in recording.metadata["warnings"][0]
    with pytest.raises(RecordingError, match=r"100 of 400 frames show no hand.*at most one in ten"):
        read_recording(write(tmp_path, hand, range(100)))


@pytest.mark.parametrize("flipped", [False, True])
def test_of_two_hands_in_a_picture_that_of_the_side_is_taken(tmp_path, flipped):
    """By the way their fingers bend, whether or not labels are those of a mirrored picture."""
    right = moving()
    left = dc.replace(right, p_HK=right.p_HK * [1.1, 1.0, 1.0], side="left")
    frames = gloves.mediapipe_frames(right)
    for frame, other in zip(frames, gloves.mediapipe_frames(left), strict=True):
        frame["worldLandmarks"] += other["worldLandmarks"]
        labels = ["Left", "Right"] if flipped else ["Right", "Left"]
        frame["handedness"] = [[{"categoryName": label}] for label in labels]
    path = gloves.write_mediapipe(tmp_path, right, frames)
    for side, hand in (("right", right), ("left", left)):
        recording, findings = open_recording(path, side)
        np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
        assert [finding.check for finding in findings] == ["handedness"] * flipped


def test_a_label_counts_where_fingers_hardly_bend(tmp_path):
    """Of an open hand there is nothing else to go by, and the message says so."""
    straight = moving(held=tuple((name, 0.0) for name in HumanHand.joint_names if "mcp" not in name))
    flat = dc.replace(straight, p_HK=np.repeat(straight.p_HK[:1], FRAMES, axis=0))
    frames = [{**frame, "handedness": [["Left"]]} for frame in gloves.mediapipe_frames(flat)]
    path = gloves.write_mediapipe(tmp_path, flat, frames)
    assert open_recording(path, "left")[0].side == "left"
    with pytest.raises(RecordingError, match="hand is labelled left, and its fingers do not bend"):
        open_recording(path, "right")
    warnings = read_recording(gloves.write_geort(tmp_path, straight)).metadata["warnings"]
    assert any("side of the hand cannot be checked" in warning for warning in warnings)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_wrong_side_is_noticed_in_a_file_that_states_none(tmp_path, side):
    """A hand read as the other side bends backwards and is refused."""
    path = gloves.write_geort(tmp_path, dc.replace(moving(), side=side))
    assert read_recording(path, side).metadata["rate_known"] is False
    assert read_recording(path, side, rate_hz=50.0).rate_hz == pytest.approx(50.0)
    with pytest.raises(RecordingError, match=f"bend backwards .* {side} hand .* --side {side}"):
        read_recording(path, "left" if side == "right" else "right")


def test_a_manus_skeleton_is_read_with_or_without_order_times_and_tracker(tmp_path):
    """Shuffled nodes with ids give the same; without times 30 Hz are assumed; a still wrist is no place."""
    hand = moving()
    sound = read_recording(gloves.write_manus(tmp_path, hand))
    data, order = np.load(tmp_path / "manus.npz")["data"], np.random.default_rng(0).permutation(25)
    shuffled = read_recording(gloves.write_manus(tmp_path, hand, data=data[:, order], keypoint_ids=order))
    assert shuffled.digest == sound.digest
    assert sound.metadata["wrist_position_tracked"] is True
    assert sound.metadata["start_time_unix_s"] == pytest.approx(1.7e9)
    # Neighbouring quaternions do not jump to their negatives, although the wrist turns by over 360°.
    assert np.sum(sound.X_WH[1:, :4] * sound.X_WH[:-1, :4], axis=1).min() > 0.9
    untimed, findings = open_recording(gloves.write_manus(tmp_path, hand, timestamps=None))
    assert untimed.metadata["format"] == "manus"
    assert [finding.check for finding in findings] == ["timestamps"]
    untracked = read_recording(gloves.write_manus(tmp_path, dc.replace(hand, p_WH=0 * hand.p_WH)))
    assert untracked.metadata["wrist_position_tracked"] is False
    np.testing.assert_allclose(untracked.X_WH[:, 4:], 0.0, atol=1e-7)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickles_of_every_protocol_are_read(tmp_path, protocol):
    """Plain data; see faults/hostile.py for what asks for a function."""
    plain = {"a": [np.arange(6.0).reshape(2, 3), np.float32(2.5), None, "ä"], "b": (1, True)}
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(plain, protocol))
    loaded = load_plain(path)
    np.testing.assert_array_equal(loaded["a"][0], plain["a"][0])
    assert loaded["a"][1:] == plain["a"][1:] and loaded["b"] == plain["b"]
    # An array goes on to another process as NumPy's own.
    assert type(pickle.loads(pickle.dumps(loaded))["a"][0]) is np.ndarray  # noqa: S301 (our own)


def test_geort_recording_has_its_known_anatomy(alex_npy):
    """GeoRT's file: 3498 frames, constant bones (index 26, 22, 20 mm), palm 92 mm, known pinches."""
    recording = read_recording(alex_npy, training=True)
    assert len(recording) == 3498
    lengths = 1e3 * bone_lengths(recording.p_HK).reshape(-1, 5, 4)
    np.testing.assert_allclose(lengths.std(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(lengths[0, 1:3], [[88.6, 26, 22, 20], [92, 26, 26, 22]], atol=0.06)
    pinches = [(distance < PINCH_M).sum() for distance in pinch_distances(recording).values()]
    assert pinches == [632, 355, 201, 0]


def test_manus_recording_has_its_known_anatomy(manus_npz):
    """The MANUS file: 118.5 Hz, index 44.4, 24.9, 21.9 mm, and a wrist that turns with the glove's."""
    recording = read_recording(manus_npz, training=True)
    assert recording.rate_hz == pytest.approx(118.5, abs=0.1)
    assert recording.duration_s == pytest.approx(43.38, abs=0.01)
    lengths = 1e3 * np.median(bone_lengths(recording.p_HK), axis=0).reshape(5, 4)
    np.testing.assert_allclose(lengths[1, 1:], [44.4, 24.9, 21.9], atol=0.1)
    assert recording.metadata["wrist_position_tracked"] is False
    # The glove's own wrist quaternion keeps its angle to frame H within 6°.
    with np.load(manus_npz) as raw:
        node = Rotation.from_quat(raw["data"][:, 0, 3:].astype(float), scalar_first=True)
    relative = node.inv() * Rotation.from_quat(recording.X_WH[:, :4], scalar_first=True)
    assert np.rad2deg((relative.mean().inv() * relative).magnitude()).max() < 6.0

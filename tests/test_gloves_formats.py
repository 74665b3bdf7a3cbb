"""Every format is read: files written by its documentation come back as the hand they were written from."""

import dataclasses as dc
import pickle

import numpy as np
import pytest
from glove_files import (
    FROM_WRIST_25,
    NAMES,
    TIMED,
    WRITERS,
    mediapipe_frames,
    openxr_frames,
    openxr_order,
    poses,
    published_manus_table,
    stacked,
    transforms,
    vision_pro_app_frames,
    vision_pro_arrays,
    write_dex_retargeting,
    write_manus,
    write_manus_csv,
    write_mediapipe,
    write_openxr,
    write_openxr_json,
    write_vision_pro,
    write_vision_pro_app,
    write_webxr,
)
from moving_hands import FRAMES, moving, random_hand
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.checks import examine
from geort_drake.people.checks.findings import Severity
from geort_drake.people.formats import FORMATS
from geort_drake.people.formats.unpickling import load_plain
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.readers import ASSUMED_RATE_HZ, open_recording, read_recording
from geort_drake.people.recording import Recording

# Files that hold the wrist's pose in the world.
POSED = set(WRITERS) - {"geort", "mediapipe", "mediapipe_npy", "mano_npy", "dex_retargeting"}


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("written", WRITERS)
def test_a_file_gives_back_the_hand_it_was_written_from(tmp_path, written, side):
    """Keypoints in H to 1e-6 m, times, the wrist's pose, and the format, which is told without a hint."""
    for seed in range(2):
        folder = tmp_path / str(seed)
        folder.mkdir()
        hand = random_hand(seed, side)
        recording, _ = open_recording(WRITERS[written](folder, hand), side)
        np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
        assert recording.valid.all()
        assert recording.side == side
        assert recording.metadata.get("format", "geort_drake") == NAMES[written]
        wanted = hand.t if written in TIMED else np.arange(len(hand.t)) / ASSUMED_RATE_HZ
        np.testing.assert_allclose(recording.t, wanted, atol=1e-6)
        assert recording.metadata.get("rate_known", True) == (written in TIMED)
        assert (recording.X_WH is not None) == (written in POSED)
        if written in POSED and side == "right":
            np.testing.assert_allclose(recording.X_WH[:, 4:], hand.p_WH, atol=1e-6)
            R_WH = Rotation.from_quat(recording.X_WH[:, :4], scalar_first=True).as_matrix()
            np.testing.assert_allclose(R_WH, hand.R_WH, atol=1e-5)


@pytest.mark.parametrize("written", WRITERS)
def test_a_sound_file_has_nothing_to_complain_of(tmp_path, written):
    """The moving hand is found sound in every format, but for missing times where the format has none."""
    recording, findings = open_recording(WRITERS[written](tmp_path, moving()))
    findings += examine(recording)[1]
    assert [finding.check for finding in findings] == ([] if written in TIMED else ["timestamps"])


def test_the_named_format_reads_the_same_as_the_one_detected(tmp_path):
    """Naming the format changes nothing; naming another says what it wanted."""
    path = WRITERS["openxr"](tmp_path, moving())
    assert read_recording(path, format="openxr").digest == read_recording(path).digest
    with pytest.raises(RecordingError, match=r"a raw MANUS file holds data, timestamps; not joints, t, hand"):
        open_recording(path, format="manus")
    with pytest.raises(RecordingError, match=r"'manus_csv' is read from \.csv, not '\.npz'"):
        open_recording(path, format="manus_csv")
    with pytest.raises(UnknownNameError, match="unknown format 'leap'; choose one of: auto, dex_retargeting"):
        open_recording(path, format="leap")


@pytest.mark.parametrize(("write", "order"), [(write_openxr, openxr_order()), (write_webxr, FROM_WRIST_25)])
def test_joints_may_be_points_poses_or_transforms(tmp_path, write, order):
    """All three give the same keypoints; matrices are read with the translation in the last column."""
    hand = random_hand(5, "right")
    p = stacked(hand.joints(), order)
    for joints in (p, poses(p, [0.5, 0.5, -0.5, 0.5]), transforms(p, hand.R_WH[:, None])):
        recording, findings = open_recording(write(tmp_path, hand, joints=joints))
        np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
        assert findings == []


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_the_shortest_recordings_are_examined(frames):
    """No check needs more frames than there are; what is missing is said."""
    hand = moving()
    recording = Recording(hand.t[:frames], hand.p_HK[:frames], np.ones(frames, bool))
    _, findings = examine(recording)
    assert f"{frames} valid frames, training needs at least 300" in " ".join(map(str, findings))


def test_every_format_documents_itself():
    """Each format's module says its source."""
    for name in FORMATS:
        module = "own" if name == "geort_drake" else name
        text = __import__(f"geort_drake.people.formats.{module}", fromlist=[module]).__doc__
        assert "Source: " in text, name


@pytest.mark.parametrize("unit", ["cm", "mm"])
def test_a_stated_unit_is_converted(tmp_path, unit):
    """A CSV in another unit is refused with the unit it seems to have, and read with it."""
    hand, scale = moving(), {"cm": 100.0, "mm": 1000.0}[unit]
    scaled = type(hand)(scale * hand.p_HK, hand.t, hand.R_WH, scale * hand.p_WH)
    path = write_manus_csv(tmp_path, scaled, delimiter=";")
    with pytest.raises(RecordingError, match=f"60 to 110 mm.*import them with --unit {unit}"):
        read_recording(path)
    np.testing.assert_allclose(read_recording(path, unit=unit).p_HK, hand.p_HK, atol=1e-6)
    with pytest.raises(UnknownNameError, match="unknown unit 'feet'"):
        read_recording(path, unit="feet")


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_published_manus_export_is_read(tmp_path, side):
    """Other names, centimetres, left-handed axes, a frame that goes with the hand; the name has the side."""
    hand = dc.replace(moving(), side=side)
    table = published_manus_table(hand)
    path = write_manus_csv(tmp_path, hand, table, name=f"take 1_{side[0].upper()}")
    recording = read_recording(path, side)
    np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
    assert recording.X_WH is None
    (told,) = recording.metadata["warnings"]
    assert f"the axes are left-handed: in them the fingers of this {side} hand" in told
    other = "left" if side == "right" else "right"
    with pytest.raises(RecordingError, match=f"holds a {side} hand, a {other} one was asked for"):
        read_recording(path, other)
    with pytest.raises(RecordingError, match="in mirrored axes"):
        read_recording(write_manus_csv(tmp_path, hand, table), side)
    # In right-handed axes nothing is turned round.
    sign = [-1 if column.endswith("_X") else 1 for column in table[0]]
    turned = [[*row[:3], *np.multiply(row[3:], sign[3:])] for row in table[1:]]
    recording = read_recording(write_manus_csv(tmp_path, hand, [table[0], *turned], name=path.stem), side)
    np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
    assert recording.metadata["warnings"] == []


def test_frames_without_a_hand_are_lost_and_nothing_else(tmp_path):
    """None among dex-retargeting's frames marks them invalid."""
    frames = list(moving().p_HK)
    frames[7] = frames[8] = None
    recording = read_recording(write_dex_retargeting(tmp_path, moving(), frames))
    assert np.flatnonzero(~recording.valid).tolist() == [7, 8]
    assert len(recording) == FRAMES


def identities(folder, hand, empty):
    """Vision Pro's stream of a hand that is not seen."""
    arrays = vision_pro_arrays(hand)
    for name in ("right_fingers", "right_wrist"):
        arrays[name][empty] = np.eye(4)
    return write_vision_pro(folder, hand, **arrays)


def zeros(write, field, order, quaternion):
    """Frames of zeros alone, quaternions among them."""

    def written(folder, hand, empty):
        joints = poses(stacked(hand.joints(), order), quaternion)
        joints[empty] = 0.0
        return write(folder, hand, **{field: joints})

    return written


def zero_matrices(folder, hand, empty):
    arrays = vision_pro_arrays(hand)
    for name in ("right_fingers", "right_wrist"):
        arrays[name][empty] = 0.0
    return write_vision_pro(folder, hand, **arrays)


def inactive(folder, hand, empty):
    """OpenXR's isActive, and no joints."""
    contents = openxr_frames(hand)
    for i in empty:
        contents["frames"][i] |= {"isActive": False, "joints": []}
    return write_openxr_json(folder, hand, contents)


def app_without(folder, hand, empty):
    frames = vision_pro_app_frames(hand)
    for i in empty:
        del frames[i]["rightHand"]
    return write_vision_pro_app(folder, hand, frames)


EMPTY = {
    "vision_pro": identities,
    "vision_pro, zero": zero_matrices,
    "openxr": zeros(write_openxr, "joints", openxr_order(), [0, 0, 0, 1.0]),
    "webxr": zeros(write_webxr, "joints", FROM_WRIST_25, [0, 0, 0, 1.0]),
    "manus": zeros(write_manus, "data", FROM_WRIST_25, [1.0, 0, 0, 0]),
    "openxr, inactive": inactive,
    "vision_pro, app": app_without,
}


@pytest.mark.parametrize("written", EMPTY)
def test_frames_in_which_a_tracker_saw_no_hand_are_lost(tmp_path, written):
    """Whatever it stores in them; what is stored as a point is counted, and too many of them are refused."""
    hand = moving()
    recording, findings = open_recording(EMPTY[written](tmp_path, hand, [0, 7, 8]))
    examined, found = examine(recording)
    assert np.flatnonzero(~examined.valid).tolist() == [0, 7, 8]
    np.testing.assert_allclose(examined.p_HK[examined.valid], hand.p_HK[examined.valid], atol=1e-6)
    assert "3 of 400 frames are not finite numbers" in str(found[0])
    if written not in ("openxr, inactive", "vision_pro, app"):
        (told,) = findings
        assert told.check == "lost frames"
        assert "3 of 400 frames hold no hand, as all keypoints are in one place; the first is frame 0" in str(
            told
        )
    path = EMPTY[written](tmp_path, hand, range(100))
    with pytest.raises(RecordingError, match=r"100 of 400 frames are not finite .* at most one in ten"):
        read_recording(path)


@pytest.mark.parametrize("flipped", [False, True])
def test_of_two_hands_in_a_picture_that_of_the_side_is_taken(tmp_path, flipped):
    """By the way their fingers bend, whether or not labels are those of a mirrored picture."""
    right = moving()
    left = dc.replace(right, p_HK=right.p_HK * [1.1, 1.0, 1.0], side="left")
    frames = mediapipe_frames(right)
    for frame, other in zip(frames, mediapipe_frames(left), strict=True):
        frame["worldLandmarks"] += other["worldLandmarks"]
        labels = ["Left", "Right"] if flipped else ["Right", "Left"]
        frame["handedness"] = [[{"categoryName": label}] for label in labels]
    path = write_mediapipe(tmp_path, right, frames)
    for side, hand in (("right", right), ("left", left)):
        recording, findings = open_recording(path, side)
        np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
        assert [finding.check for finding in findings] == ["handedness"] * flipped


def test_a_label_counts_where_fingers_hardly_bend(tmp_path):
    """Of an open hand there is nothing else to go by, and the message says so."""
    straight = moving(held=tuple((name, 0.0) for name in HumanHand.joint_names if "mcp" not in name))
    flat = dc.replace(straight, p_HK=np.repeat(straight.p_HK[:1], FRAMES, axis=0))
    frames = [{**frame, "handedness": [["Left"]]} for frame in mediapipe_frames(flat)]
    path = write_mediapipe(tmp_path, flat, frames)
    assert open_recording(path, "left")[0].side == "left"
    with pytest.raises(RecordingError, match="holds a left hand by its label, and its fingers do not bend"):
        open_recording(path, "right")


def test_a_raw_manus_skeleton_needs_no_timestamps(tmp_path):
    """It is known by its shape, and 30 Hz are assumed."""
    recording, findings = open_recording(write_manus(tmp_path, moving(), timestamps=None))
    assert recording.metadata["format"] == "manus"
    assert [finding.check for finding in findings] == ["timestamps"]


def test_suffixes_may_be_in_capitals(tmp_path):
    """As other systems write them."""
    path = WRITERS["geort"](tmp_path, moving())
    assert read_recording(path.rename(tmp_path / "HAND.NPY")).metadata["format"] == "geort"


class Harmful:
    """What a malicious pickle looks like: unpickling it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_what_was_unpickled_can_go_to_another_process(tmp_path):
    """An array arrives there as NumPy's own."""
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps({"a": np.arange(6.0).reshape(2, 3)}))
    again = pickle.loads(pickle.dumps(load_plain(path)))["a"]  # noqa: S301 (our own)
    assert type(again) is np.ndarray
    np.testing.assert_array_equal(again, np.arange(6.0).reshape(2, 3))


class Reduced:
    """What pickles as a call, and the state that its result is given."""

    def __init__(self, call, arguments, state):
        self.reduced = call, arguments, state

    def __reduce__(self):
        return self.reduced


REBUILT = (np.zeros(0).__reduce__()[0], (np.ndarray, (0,), b"b"))


@pytest.mark.parametrize(
    "contents",
    [
        Reduced(np.dtype, ("f4", False, True), (3, "<", None, -1, -1, 0)),
        Reduced(np.dtype, ("V8", False, True), (3, "|", None, ("a",), {"a": 1}, 8, 1, 0)),
        Reduced(*REBUILT, (1, (4,), np.dtype(object), False, [1, 2])),
        Reduced(*REBUILT, (1, (2, 10**9), np.dtype("f8"), False, b"\0" * 16)),
        Reduced(*REBUILT, (1, (-1,), np.dtype("f8"), False, b"")),
        Reduced(np.float64(0).__reduce__()[0], (np.dtype(object), b"\0" * 8), None),
    ],
    ids=["type cut off", "fields", "too few objects", "too large", "negative shape", "object from bytes"],
)
def test_pickles_that_mislead_numpy_are_refused(tmp_path, contents):
    """Some of them end the process where NumPy itself unpickles them."""
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(contents))
    with pytest.raises(RecordingError, match=r"x\.pkl: not a readable pickle"):
        load_plain(path)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickles_of_every_protocol_are_read_without_running_anything(tmp_path, protocol):
    """Plain data is read whichever way it was pickled; what asks for a function is refused by its name."""
    plain = {"a": [np.arange(6.0).reshape(2, 3), np.float32(2.5), None, "ä", b"\x80"], "b": (1, {2}, True)}
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(plain, protocol))
    if protocol >= 4:  # older ones name the builtin set
        loaded = load_plain(path)
        np.testing.assert_array_equal(loaded["a"][0], plain["a"][0])
        assert loaded["a"][1:] == plain["a"][1:]
        assert loaded["b"] == plain["b"]
    path.write_bytes(pickle.dumps([plain["a"][0], Harmful(tmp_path / "harm")], protocol))
    with pytest.raises(RecordingError, match=r"x\.pkl: the pickle asks for .*open, which could run code"):
        load_plain(path)
    assert not (tmp_path / "harm").exists()


def test_real_recordings_are_sound(alex_npy, manus_npz):
    """Of two people's recordings one is sound; the other has what is known of it, and no error."""
    for path, checks in (
        (manus_npz, []),
        (alex_npy, ["timestamps", "duplicated frames", "jumps", "pinches"]),
    ):
        recording, findings = open_recording(path)
        findings += examine(recording)[1]
        assert [finding.check for finding in findings] == checks
        assert all(finding.severity is Severity.WARNING for finding in findings)

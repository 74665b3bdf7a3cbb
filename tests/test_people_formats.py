"""Every format is read: files written by its documentation come back as the hand they were written from."""

import dataclasses as dc
import json

import glove_files as gloves
import numpy as np
import pytest
from glove_files import FRAMES, moving
from scipy.spatial.transform import Rotation

from geort_drake import Recording, read_recording
from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.coverage import pinch_distances
from geort_drake.people.keypoints import bone_lengths
from geort_drake.people.readers import ASSUMED_RATE_HZ
from geort_drake.people.recording import PINCH_M
from geort_drake.people.synthetic.hand import HumanHand

# Files with the wrist's pose in the world.
POSED = set(gloves.WRITERS) - {"geort", "mediapipe", "mediapipe_npy"}


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("written", gloves.WRITERS)
def test_a_file_gives_back_the_hand_it_was_written_from(tmp_path, written, side):
    """Keypoints in H to 1e-6 m, times, the wrist's pose, and the format, which is detected; no warning."""
    hand = dc.replace(moving(), side=side)
    recording = read_recording(gloves.WRITERS[written](tmp_path, hand), side)
    np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
    assert recording.valid.all()
    assert recording.side == side
    assert recording.metadata.get("format", "own") == gloves.NAMES[written]
    timed = written in gloves.TIMED
    expected = hand.t if timed else np.arange(len(hand.t)) / ASSUMED_RATE_HZ
    np.testing.assert_allclose(recording.t, expected, atol=1e-6)
    assert recording.metadata.get("rate_known", True) == timed
    assert ["no timestamps" in warning for warning in recording.metadata["warnings"]] == [True] * (not timed)
    assert (recording.X_WH is not None) == (written in POSED)
    if written in POSED:
        # The world of a left hand is mirrored with it, which our own format has done already.
        mirror = [1, -1, 1] if side == "left" and written != "own" else [1, 1, 1]
        np.testing.assert_allclose(recording.X_WH[:, 4:], hand.p_WH * mirror, atol=1e-6)
    if written in POSED and side == "right":
        R_WH = Rotation.from_quat(recording.X_WH[:, :4], scalar_first=True).as_matrix()
        np.testing.assert_allclose(R_WH, hand.R_WH, atol=1e-5)


def test_the_named_format_reads_the_same_as_the_detected_one(tmp_path):
    """Naming the format changes nothing; naming another says what it expected."""
    path = gloves.WRITERS["openxr"](tmp_path, moving())
    assert read_recording(path, format="openxr").digest == read_recording(path).digest
    with pytest.raises(RecordingError, match=r"lacks data; it contains joints, t"):
        read_recording(path, format="manus")
    with pytest.raises(RecordingError, match=r"'manus_csv' is read from \.csv, not '\.npz'"):
        read_recording(path, format="manus_csv")
    for name, value in (("format", "leap"), ("side", "both"), ("unit", "feet")):
        with pytest.raises(UnknownNameError, match=f"unknown {name} '{value}'; choose one of: "):
            read_recording(path, **{name: value})
    path = gloves.WRITERS["geort"](tmp_path, moving())
    assert read_recording(path.rename(tmp_path / "HAND.NPY")).metadata["format"] == "geort"


@pytest.mark.parametrize(
    ("write", "order"),
    [(gloves.write_openxr, gloves.openxr_order()), (gloves.write_webxr, gloves.FROM_WRIST_25)],
)
def test_joints_may_be_points_poses_or_transforms(tmp_path, write, order):
    """All three give the same keypoints; matrices are read with the translation in the last column."""
    hand = moving()
    p = gloves.stacked(hand.joints(), order)
    for joints in (p, gloves.poses(p, [0.5, 0.5, -0.5, 0.5]), gloves.transforms(p, hand.R_WH[:, None])):
        recording = read_recording(write(tmp_path, hand, joints=joints))
        np.testing.assert_allclose(recording.p_HK, hand.p_HK, atol=1e-6)
        assert recording.metadata["warnings"] == []


@pytest.mark.parametrize("joints", [25, 27])
def test_transforms_of_vision_pro_are_read_in_either_layout(tmp_path, joints):
    """Of 25 and 27 joints, with the forearm last or first, and transposed."""
    hand = moving()
    fields = gloves.vision_pro_arrays(hand, joints)
    X = fields["right_fingers"]
    layouts = [X, np.swapaxes(X, 2, 3)] + [np.roll(X, 2, axis=1)] * (joints == 27)
    for layout in layouts:
        path = gloves.write_vision_pro(tmp_path, hand, contents=fields | {"right_fingers": layout})
        np.testing.assert_allclose(read_recording(path).p_HK, hand.p_HK, atol=1e-6)


@pytest.mark.parametrize("unit", ["cm", "mm"])
def test_a_stated_unit_is_converted(tmp_path, unit):
    """A CSV in another unit is refused with the unit it seems to have, and read with it."""
    hand, scale = moving(), {"cm": 100.0, "mm": 1000.0}[unit]
    scaled = type(hand)(scale * hand.p_HK, hand.t, hand.R_WH, scale * hand.p_WH)
    path = gloves.write_manus_csv(tmp_path, scaled, delimiter=";")
    with pytest.raises(RecordingError, match=f"60 to 110 mm.*convert FILE --unit {unit}"):
        read_recording(path)
    np.testing.assert_allclose(read_recording(path, unit=unit).p_HK, hand.p_HK, atol=1e-6)
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
    assert f"axes are left-handed: by its name a {side} hand" in warning
    other = "left" if side == "right" else "right"
    with pytest.raises(RecordingError, match=f"contains a {side} hand, a {other} one was requested"):
        read_recording(path, other)


def test_a_table_that_names_a_column_twice_or_not_is_refused(tmp_path):
    """One of the two columns would be read, whichever it is."""
    table = gloves.manus_table(moving())
    (place,) = [i for i, name in enumerate(table[0]) if name == "Index_PIP_X"]
    for name, message in (
        ("Index_PIP_Y", "the header has the column Index_PIP_Y more than once"),
        ("Index_PIP_W", "the header lacks 1 of 63 columns, such as Index_PIP_X"),
    ):
        table[0][place] = name
        with pytest.raises(RecordingError, match=message):
            read_recording(gloves.write_manus_csv(tmp_path, moving(), table))


def zero_array(folder, hand, lost):
    fields = gloves.manus_fields(hand)
    fields["data"][lost] = 0.0
    return gloves.write_manus(folder, hand, contents=fields)


def inactive(folder, hand, lost):
    contents = gloves.openxr_frames(hand)
    for i in lost:
        contents["frames"][i] |= {"isActive": False}
    return gloves.write_openxr_json(folder, hand, contents)


def invalid_joints(folder, hand, lost):
    valid = np.ones((FRAMES, 26))
    valid[lost, 8] = 0
    return gloves.write_openxr(folder, hand, valid=valid)


def unseen(folder, hand, lost):
    frames = gloves.mediapipe_frames(hand)
    for i in lost:
        frames[i] |= {"worldLandmarks": [], "handedness": []}
    return gloves.write_mediapipe(folder, hand, frames)


def unreadable(folder, hand, lost):
    frames = gloves.mediapipe_frames(hand)
    for i in lost:
        frames[i] = frames[i] | {"worldLandmarks": [["?"] * 21]}
    return gloves.write_mediapipe(folder, hand, frames)


@pytest.mark.parametrize("write", [zero_array, inactive, invalid_joints, unseen, unreadable])
def test_frames_that_show_no_hand_are_lost_and_counted(tmp_path, write):
    """Two of 400 are invalid and named; 60 are refused."""
    recording = read_recording(write(tmp_path, moving(), [7, 90]))
    np.testing.assert_array_equal(np.flatnonzero(~recording.valid), [7, 90])
    assert any("2 of 400 frames show no hand or cannot be read" in w for w in recording.metadata["warnings"])
    with pytest.raises(RecordingError, match=r"60 of 400 frames show no hand .* at most one in ten"):
        read_recording(write(tmp_path, moving(), range(60)))


def with_stamps(written, stamps, field):
    """A writer of a format whose times are replaced by `stamps` of the index."""

    def write(folder, hand):
        if written == "manus_csv":
            table = gloves.manus_table(hand)
            for i, row in enumerate(table[1:]):
                row[1] = stamps(i)
            return gloves.write_manus_csv(folder, hand, table)
        contents = {"openxr_json": gloves.openxr_frames, "webxr_json": gloves.webxr_frames}.get(
            written, gloves.mediapipe_frames
        )(hand)
        frames = contents["frames"] if isinstance(contents, dict) else contents
        for i, frame in enumerate(frames):
            frame[field] = stamps(i)
        return gloves.WRITERS[written](folder, hand, contents)

    return write


STAMPED = {
    "openxr_json": ("time", lambda i: str(1_700_000_000_000_000_000 + 16_666_667 * i)),
    "webxr_json": ("time", lambda i: f"{1e3 * i / 60:.6f}"),
    "mediapipe": ("timestampMs", lambda i: f"{1e3 * i / 60:.6f}"),
    "manus_csv": ("", lambda i: f"{1e3 * i / 60:.6f}"),
}


@pytest.mark.parametrize("written", STAMPED)
def test_stamps_that_are_numbers_in_text_are_read_and_other_text_is_refused(tmp_path, written):
    """No stamp that is there is taken for absent, as if the rate were 30 Hz; a missing one costs a frame."""
    field, stamp = STAMPED[written]
    recording = read_recording(with_stamps(written, stamp, field)(tmp_path, moving()))
    assert recording.rate_hz == pytest.approx(60.0, rel=1e-4)
    assert recording.metadata["rate_known"]
    with pytest.raises(RecordingError, match=r"\[3\]: times must be numbers, not 'noon'"):
        read_recording(
            with_stamps(written, lambda i: "noon" if i == 3 else stamp(i), field)(tmp_path, moving())
        )
    absent = "" if written == "manus_csv" else None
    read = read_recording(
        with_stamps(written, lambda i: absent if i == 3 else stamp(i), field)(tmp_path, moving())
    )
    assert len(read) == FRAMES - 1
    assert any("1 of 400 frames have no time" in warning for warning in read.metadata["warnings"])


@pytest.mark.parametrize("written", ["manus", "openxr", "webxr", "vision_pro"])
def test_stamps_of_archives_are_numbers_or_refused(tmp_path, written):
    """Numbers in text are read; dates, words and a single time are refused with the field's name."""
    field = "timestamps" if written in ("manus", "vision_pro") else "t"
    write, t = gloves.WRITERS[written], moving().t
    read = read_recording(write(tmp_path, moving(), **{field: np.array([f"{x:.6f}" for x in t])}))
    np.testing.assert_allclose(read.t, t, atol=2e-6)
    for bad in ((1e9 * t).astype("datetime64[ns]"), np.array(["noon"] * len(t)), np.array(5.0)):
        with pytest.raises(RecordingError, match=f"{field}.*times must be numbers"):
            read_recording(write(tmp_path, moving(), **{field: bad}))
    with pytest.raises(RecordingError, match=f"399 {field} for 400 frames"):
        read_recording(write(tmp_path, moving(), **{field: t[1:]}))


def with_other_name(written, field, name, value=None):
    """A writer of JSON whose times are called `name`, or whose contents have one `value` of this name."""

    def write(folder, hand):
        frames = {"openxr_json": gloves.openxr_frames, "mediapipe": gloves.mediapipe_frames}[written](hand)
        contents = frames if isinstance(frames, dict) else {"frames": frames}
        for frame in contents["frames"]:
            stamp = frame.pop(field)
            if value is None:
                frame[name] = stamp
        if value is not None:
            contents[name] = value
        return gloves.WRITERS[written](folder, hand, contents)

    return write


def csv_with_times(folder, hand, name, time):
    table = gloves.manus_table(hand)
    table[0][1] = name
    for i, row in enumerate(table[1:]):
        row[1] = time(i)
    return gloves.write_manus_csv(folder, hand, table)


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (with_other_name("openxr_json", "time", "predictedDisplayTime"), "predictedDisplayTime"),
        (with_other_name("mediapipe", "timestampMs", "timestamp_us"), "timestamp_us"),
        (with_other_name("mediapipe", "timestampMs", "fps", 60), "fps"),
        (with_other_name("mediapipe", "timestampMs", "frameRate", 60), "frameRate"),
        (lambda folder, hand: gloves.write_manus(folder, hand, timestamps=None, times=hand.t), "times"),
        (lambda folder, hand: csv_with_times(folder, hand, "Time_s", lambda i: f"{i / 60:.6f}"), "Time_s"),
    ],
)
def test_a_clock_under_another_name_is_not_taken_for_absent(tmp_path, write, name):
    """Its rate would otherwise count as unknown, and all speeds would be wrong; the rate can be given."""
    path = write(tmp_path, moving())
    with pytest.raises(RecordingError, match=f"the field '{name}' is not read; give the frames per second"):
        read_recording(path)
    assert read_recording(path, rate_hz=60.0).rate_hz == pytest.approx(60.0)


def test_times_of_which_none_is_finite_are_not_taken_for_absent(tmp_path):
    """As an export with an empty column has them."""
    path = csv_with_times(tmp_path, moving(), gloves.manus_table(moving())[0][1], lambda i: "")
    with pytest.raises(RecordingError, match=r"a time for each frame, but none is a finite number; .*--rate"):
        read_recording(path)
    assert read_recording(path, rate_hz=60.0).metadata["rate_known"]


def test_a_side_that_frames_state_is_read(tmp_path):
    """Each frame may name the side; two sides in one file are refused."""
    contents = gloves.openxr_frames(moving())
    for frame in contents["frames"]:
        frame["hand"] = "left"
    path = gloves.write_openxr_json(tmp_path, moving(), contents)
    with pytest.raises(RecordingError, match=r"hand \(right\) and hand \(left\) state both sides"):
        read_recording(path)
    del contents["hand"]
    with pytest.raises(RecordingError, match="contains a left hand, a right one was requested"):
        read_recording(gloves.write_openxr_json(tmp_path, moving(), contents))


@pytest.mark.parametrize("labels", [[], [[{"categoryName": "Droite"}]], "Right"])
def test_labels_of_hands_that_cannot_be_read_are_not_taken_for_absent(tmp_path, labels):
    """A frame whose labels do not fit its hands is lost."""
    frames = gloves.mediapipe_frames(moving())
    for frame in frames[:60]:
        frame["handedness"] = labels
    with pytest.raises(RecordingError, match="60 of 400 frames show no hand or cannot be read"):
        read_recording(gloves.write_mediapipe(tmp_path, moving(), frames))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"valid": np.full((FRAMES, 26), "yes")}, "valid must be numbers"),
        ({"valid": np.ones((FRAMES - 1, 26))}, "399 valid for 400 frames"),
        ({"valid": np.ones(FRAMES)}, "valid must be numbers of shape"),
        ({"hand": np.array("both")}, "hand 'both' is none of: left, right"),
        ({"hand": np.array(3)}, "hand '3' is none of"),
    ],
)
def test_validity_and_side_that_cannot_be_read_are_refused(tmp_path, fields, message):
    """They are never taken for absent, which would make all joints valid, or the hand the requested one."""
    with pytest.raises(RecordingError, match=message):
        contents = gloves.openxr_fields(moving()) | fields
        read_recording(gloves.write_openxr(tmp_path, moving(), contents))


def test_flags_that_cannot_be_read_cost_their_frames(tmp_path):
    """Flags in text are read; others are no sign that a joint was tracked."""
    contents = gloves.openxr_frames(moving())
    for joint in contents["frames"][5]["joints"]:
        joint["locationFlags"] = "15"
    contents["frames"][6]["joints"][8]["locationFlags"] = "tracked"
    contents["frames"][7]["isActive"] = "perhaps"
    recording = read_recording(gloves.write_openxr_json(tmp_path, moving(), contents))
    np.testing.assert_array_equal(np.flatnonzero(~recording.valid), [6, 7])


def test_a_hand_whose_label_contradicts_its_fingers_is_read_by_its_fingers(tmp_path):
    """MediaPipe's labels often assume mirrored images."""
    frames = gloves.mediapipe_frames(moving())
    for frame in frames:
        frame["handedness"] = [[{"categoryName": "Left"}]]
    recording = read_recording(gloves.write_mediapipe(tmp_path, moving(), frames))
    np.testing.assert_allclose(recording.p_HK, moving().p_HK, atol=1e-6)
    assert any(
        "labelled left, but the fingers bend as a right hand's" in w for w in recording.metadata["warnings"]
    )


def test_of_two_hands_in_a_picture_that_of_the_side_is_read(tmp_path):
    left = dc.replace(moving(), side="left")
    frames = gloves.mediapipe_frames(moving())
    for frame, other in zip(frames, gloves.mediapipe_frames(left), strict=True):
        for field in ("worldLandmarks", "handedness"):
            frame[field] = [*other[field], *frame[field]]
    path = gloves.write_mediapipe(tmp_path, moving(), frames)
    for side in ("right", "left"):
        np.testing.assert_allclose(read_recording(path, side).p_HK, moving().p_HK, atol=1e-6)


def test_a_line_of_json_that_was_cut_off_costs_its_frame(tmp_path):
    path = tmp_path / "hand.jsonl"
    lines = [json.dumps(frame) for frame in gloves.mediapipe_frames(moving())]
    lines[-1] = lines[-1][:50]
    path.write_text("\n".join(lines))
    recording = read_recording(path)
    assert recording.valid.sum() == FRAMES - 1


def test_a_recording_of_any_device_is_made_from_its_keypoints():
    """In any frame, with either side; frames with NaN are invalid; shapes are checked."""
    hand = dc.replace(moving(), side="left")
    p_WK = gloves.stacked(hand.joints(), gloves.KEYPOINTS)
    p_WK[4] = np.nan
    recording = Recording.from_keypoints(p_WK, 5.0 + hand.t, "left", in_world=True)
    np.testing.assert_allclose(recording.p_HK[5:], hand.p_HK[5:], atol=1e-6)
    np.testing.assert_allclose(recording.t, hand.t, atol=1e-9)
    assert not recording.valid[4] and recording.valid.sum() == FRAMES - 1
    with pytest.raises(RecordingError, match=r"\(T, 21, 3\), T times and a side"):
        Recording.from_keypoints(p_WK, hand.t[1:])


def test_geort_recording_has_its_known_anatomy(alex_npy):
    """Bones to the millimetre of the published file, and the pinches that are known of it."""
    recording = read_recording(alex_npy)
    bones = 1e3 * np.median(bone_lengths(recording.p_HK), axis=0).reshape(5, 4)
    np.testing.assert_allclose(bones[1], [88.6, 26.0, 22.0, 20.0], atol=0.1)
    near = {finger: int((d < PINCH_M).sum()) for finger, d in pinch_distances(recording).items()}
    assert near == {"index": 632, "middle": 355, "ring": 201, "little": 0}


def test_manus_recording_has_its_known_anatomy(manus_npz):
    recording = read_recording(manus_npz)
    assert recording.metadata["warnings"] == []
    hand = HumanHand.fit(recording)
    np.testing.assert_allclose(1e3 * hand.lengths[1], [44.4, 24.9, 21.9], atol=0.1)

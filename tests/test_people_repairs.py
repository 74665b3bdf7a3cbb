"""A fault in a single frame never refuses a recording: it is reported, and the rest is read unchanged."""

import copy
import functools
import json
import pickle
import tempfile
from pathlib import Path

import numpy as np
import pytest
from glove_files import WRITERS, write_manus, write_own
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_hands import Hand, moving

from geort_drake.people.checks import examine, verdict
from geort_drake.people.readers import open_recording, read_recording

FRAMES = 80
TIME_FIELDS = ("t", "timestamps", "timestamp", "time", "timestampMs")


@functools.cache
def sound_hand() -> Hand:
    hand = moving()
    return Hand(hand.p_HK[:FRAMES], hand.t[:FRAMES], hand.R_WH[:FRAMES], hand.p_WH[:FRAMES])


# -- faults of one frame's numbers (an array of any shape), which change it in place


def set_to(value):
    def fault(numbers):
        numbers[...] = value

    return fault


def one_number(value):
    def fault(numbers):
        numbers.reshape(-1)[numbers.size // 2] = value

    return fault


def scaled(numbers):
    numbers *= 25.0


FRAME_FAULTS = {
    "all NaN": set_to(np.nan),
    "all zero": set_to(0.0),
    "all in one place": set_to(0.5),
    "all huge": set_to(1e30),
    "one NaN": one_number(np.nan),
    "one infinite": one_number(np.inf),
    "one far away": one_number(30.0),
    "scaled": scaled,
}
# Given the times and the frame.
TIME_FAULTS = {
    "NaN": lambda t, i: np.nan,
    "repeated": lambda t, i: t[i - 1] if i else t[i + 1],
    "backward": lambda t, i: t[i - 3] if i > 2 else t[i + 3],
    "slightly backward": lambda t, i: t[i - 1] - 0.4 * (t[1] - t[0]) if i else t[i + 1] + 0.4 * (t[1] - t[0]),
    "zero": lambda t, i: t[0] - 1e6,
    "far ahead": lambda t, i: t[0] + 1e6,
}
# What nobody reads does not count.
UNREAD = (
    "radius",
    "score",
    "systemTime",
    "videoFrameIndex",
    "camMat",
    "objName",
    "forearmWrist",
    "forearmArm",
)
# What stands in place of an object, a point or a time in JSON, or of an array in a pickle.
OBJECTS = (None, 7, "x", [], {}, [1.0], [[None, 1.0, 2.0]] * 21, 10**400, float("nan"), True)


def spoil_arrays(path: Path, i: int, draw) -> None:
    with np.load(path) as file:
        arrays = {"data": file} if isinstance(file, np.ndarray) else {name: file[name] for name in file.files}
    fields = [name for name, array in arrays.items() if array.dtype.kind == "f" and len(array) == FRAMES]
    field = draw(st.sampled_from(fields))
    if field in TIME_FIELDS:
        arrays[field][i] = TIME_FAULTS[draw(st.sampled_from(sorted(TIME_FAULTS)))](arrays[field], i)
    else:
        FRAME_FAULTS[draw(st.sampled_from(sorted(FRAME_FAULTS)))](arrays[field][i])
    np.savez(path, **arrays)


def spoil_array(path: Path, i: int, draw) -> None:
    array = np.load(path)
    FRAME_FAULTS[draw(st.sampled_from(sorted(FRAME_FAULTS)))](array[i])
    np.save(path, array)


def spoil_objects(frames: list, i: int, draw) -> None:
    """Something else stands at one place in a frame, or it is missing."""
    frame = copy.deepcopy(frames[i])
    parts = [(frames, i)]
    while isinstance(frame, dict | list) and len(frame):
        keys = [k for k in frame if k not in UNREAD] if isinstance(frame, dict) else range(len(frame))
        key = draw(st.sampled_from(list(keys)))
        parts.append((frame, key))
        frame = frame[key]
    place, key = parts[draw(st.integers(0, len(parts) - 1))]
    if len(parts) > 1:
        frames[i] = parts[1][0]
    if isinstance(place, dict) and draw(st.booleans()):
        del place[key]
    else:
        place[key] = copy.deepcopy(draw(st.sampled_from(OBJECTS)))


def spoil_json(path: Path, i: int, draw) -> None:
    contents = json.loads(path.read_text())
    frames = contents["frames"] if isinstance(contents, dict) else contents
    if draw(st.booleans()):
        text, frame = path.read_text(), json.dumps(frames[i])
        begin = text.index(frame)
        at = begin + draw(st.integers(0, len(frame) - 1))
        path.write_text(text[:at] + draw(st.sampled_from(["#", "{", "]", '"'])) + text[at + 1 :])
    else:
        spoil_objects(frames, i, draw)
        path.write_text(json.dumps(contents))


def spoil_lines(path: Path, i: int, draw) -> None:
    lines = path.read_text().splitlines()
    if draw(st.booleans()):
        lines[i] = lines[i][: draw(st.integers(1, len(lines[i]) - 1))]
    else:
        frames = [json.loads(line) for line in lines]
        spoil_objects(frames, i, draw)
        lines = [json.dumps(frame) for frame in frames]
    path.write_text("\n".join(lines))


def spoil_pickle(path: Path, i: int, draw) -> None:
    frames = pickle.loads(path.read_bytes())  # noqa: S301 (our own)
    if draw(st.booleans()):
        spoil_objects(frames, i, draw)
    else:
        frames[i] = copy.deepcopy(frames[i])
        fields = [frames[i]] if isinstance(frames[i], np.ndarray) else [
            value for value in frames[i].values() if isinstance(value, np.ndarray)
        ]  # fmt: skip
        FRAME_FAULTS[draw(st.sampled_from(sorted(FRAME_FAULTS)))](draw(st.sampled_from(fields)))
    path.write_bytes(pickle.dumps(frames))


def spoil_folder(path: Path, i: int, draw) -> None:
    file = sorted(path.iterdir())[i]
    if draw(st.booleans()):
        file.write_bytes(file.read_bytes()[: draw(st.integers(0, file.stat().st_size - 1))])
    else:
        frames = [pickle.loads(file.read_bytes())]  # noqa: S301 (our own)
        spoil_objects(frames, 0, draw)
        file.write_bytes(pickle.dumps(frames[0]))


def spoil_table(path: Path, i: int, draw) -> None:
    lines = path.read_text().splitlines()
    cells = lines[i + 1].split(",")
    kind = draw(st.sampled_from(["empty", "word", "cut", "bytes", "number"]))
    place = draw(st.sampled_from([1, *range(3, len(cells))]))
    if kind == "cut":
        cells = cells[:place]
    else:
        cells[place] = {"empty": "", "word": "n/a", "bytes": "\ufffd", "number": "1e30"}[kind]
    lines[i + 1] = ",".join(cells)
    path.write_text("\n".join(lines))


SPOIL = {
    ".npz": spoil_arrays, ".npy": spoil_array, ".json": spoil_json, ".jsonl": spoil_lines,
    ".pkl": spoil_pickle, ".csv": spoil_table, "": spoil_folder,
}  # fmt: skip


@pytest.mark.parametrize("written", WRITERS)
@settings(max_examples=12, deadline=None, derandomize=True)
@given(i=st.sampled_from([0, 1, 37, FRAMES - 2, FRAMES - 1]), data=st.data())
def test_a_fault_in_one_frame_costs_that_frame_at_most(written, i, data):
    """Wherever it is: the file is read, a finding names frame or repair, and other frames are the same."""
    with tempfile.TemporaryDirectory() as folder:
        path = WRITERS[written](Path(folder), sound_hand())
        sound, known = open_recording(path)
        _, known_too = examine(sound)
        SPOIL[path.suffix](path, i, data.draw)
        recording, findings = open_recording(path)
    recording, found = examine(recording)
    findings += found
    assert verdict(findings) != "refused", [str(finding) for finding in findings]
    assert set(np.flatnonzero(~recording.valid)) <= {i}
    others = np.arange(FRAMES) != i
    np.testing.assert_array_equal(recording.p_HK[others], sound.p_HK[others])
    # Where the first frame has no time, the clock starts with another.
    start = np.median(recording.t - sound.t)
    np.testing.assert_allclose(recording.t[others], sound.t[others] + start, atol=1e-6)
    if sound.X_WH is not None:
        np.testing.assert_allclose(np.abs(recording.X_WH[others]), np.abs(sound.X_WH[others]), atol=1e-9)
    if not recording.valid[i]:
        assert any(i in finding.lost for finding in findings)
    elif not np.allclose(recording.p_HK[i], sound.p_HK[i], atol=1e-6, equal_nan=True):
        new = {finding.check for finding in findings} - {finding.check for finding in [*known, *known_too]}
        assert new, [str(finding) for finding in findings]


@pytest.mark.parametrize("written", ["openxr_json", "mediapipe", "vision_pro_app", "manus_csv"])
def test_a_text_that_was_cut_off_is_read_up_to_there(tmp_path, written):
    """As of a recorder that was killed."""
    path = WRITERS[written](tmp_path, moving())
    sound, _ = open_recording(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 9 // 10])
    recording = read_recording(path)
    assert 350 < len(recording) < 370
    assert recording.valid[:-1].all() and not recording.valid[-1]
    np.testing.assert_array_equal(recording.p_HK[:-1], sound.p_HK[: len(recording) - 1])


def test_quaternions_that_are_not_used_do_not_matter(tmp_path):
    """A published recording has 246 of 125,000 with norm 0.983."""
    hand = moving()
    sound = read_recording(write_manus(tmp_path, hand))
    data = np.load(tmp_path / "manus.npz")["data"]
    rng = np.random.default_rng(0)
    data[rng.integers(0, len(data), 246), rng.integers(0, 25, 246), 3:] *= 0.983
    data[5, 3, 3:], data[6, 3, 3:] = 0.0, np.nan
    assert read_recording(write_manus(tmp_path, hand, data=data)).digest == sound.digest


def test_quaternions_of_the_wrist_are_scaled_or_their_frames_lost(tmp_path):
    """In our own files, where they are used."""
    hand = moving()
    X_WH = read_recording(write_own(tmp_path, hand)).X_WH.copy()
    X_WH[[3, 8], :4] *= 0.9
    X_WH[20, :4] = 0.0
    recording = read_recording(write_own(tmp_path, hand, X_WH=X_WH))
    assert np.flatnonzero(~recording.valid).tolist() == [20]
    np.testing.assert_allclose(np.linalg.norm(recording.X_WH[:, :4], axis=1), 1.0)
    told = " ".join(recording.metadata["warnings"])
    assert "2 of 400 quaternions of the wrist have a norm of 0.9 to 0.9" in told
    assert "1 of 400 frames have a wrist pose X_WH without a unit quaternion, the first is frame 20" in told

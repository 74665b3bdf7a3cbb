"""A fault in a single frame never refuses a recording: it is reported, and the rest is read unchanged."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from faults.mutations import VALUES, changed
from glove_files import WRITERS, moving, read_contents, write_contents, write_manus, write_own
from hypothesis import given, settings
from hypothesis import strategies as st

from geort_drake import read_recording
from geort_drake.people.checks import examine, verdict
from geort_drake.people.readers import open_recording

FRAMES = 80


# Each changes the numbers of one frame in place.
FRAME_FAULTS = [
    *(lambda numbers, value=value: numbers.fill(value) for value in (np.nan, 0.0, 0.5, 1e30)),
    *(lambda numbers, value=value: numbers.put(numbers.size // 2, value) for value in (np.nan, np.inf, 30.0)),
    lambda numbers: np.multiply(numbers, 25.0, out=numbers),
]
# The time of a frame, given the times: none, repeated, backward, slightly backward, far behind or ahead.
TIME_FAULTS = [
    lambda t, i: np.nan,
    lambda t, i: t[i - 1] if i else t[i + 1],
    lambda t, i: t[i - 3] if i > 2 else t[i + 3],
    lambda t, i: t[i - 1] - 0.4 * (t[1] - t[0]) if i else t[i + 1] + 0.4 * (t[1] - t[0]),
    lambda t, i: t[0] - 1e6,
    lambda t, i: t[0] + 1e6,
]


def spoil_arrays(path: Path, i: int, draw) -> None:
    loaded = read_contents(path)
    arrays = loaded if isinstance(loaded, dict) else {"data": loaded}
    fields = [name for name, array in arrays.items() if array.dtype.kind == "f" and len(array) == FRAMES]
    field = draw(st.sampled_from(fields))
    if arrays[field].ndim == 1:
        arrays[field][i] = draw(st.sampled_from(TIME_FAULTS))(arrays[field], i)
    else:
        draw(st.sampled_from(FRAME_FAULTS))(arrays[field][i])
    write_contents(path, loaded)


def spoiled(frame, draw):
    """The same frame with something else at one place, or without it."""
    if isinstance(frame, np.ndarray) and draw(st.booleans()):
        numbers = frame.copy()
        draw(st.sampled_from(FRAME_FAULTS))(numbers)
        return numbers
    if draw(st.integers(0, 3)) == 0:
        return draw(st.sampled_from(VALUES))
    return changed(frame, np.random.default_rng(draw(st.integers(0, 2**32 - 1))))


def spoil_objects(path: Path, i: int, draw) -> None:
    contents = read_contents(path)
    frames = contents if isinstance(contents, list) else contents.get("frames")
    if frames is None:
        contents = spoiled(contents, draw)  # a file with one frame
    else:
        frames[i] = spoiled(frames[i], draw)
    write_contents(path, contents)


def spoil_text(path: Path, i: int, draw) -> None:
    """Another character stands in a frame's text, or its line ends there."""
    text, begin = path.read_text(), 0
    if path.suffix == ".json":
        contents = json.loads(text)
        frame = json.dumps((contents if isinstance(contents, list) else contents["frames"])[i])
        begin = text.index(frame)
    else:
        lines = text.splitlines(keepends=True)
        row = i + (path.suffix == ".csv")
        frame, begin = lines[row].rstrip(), sum(map(len, lines[:row]))
    cut = path.suffix != ".json" and draw(st.booleans())
    at = draw(st.integers(int(cut), len(frame) - 1))  # an empty line is no frame
    end = begin + (len(frame) if cut else at + 1)
    path.write_text(text[: begin + at] + ("" if cut else draw(st.sampled_from('#{]"'))) + text[end:])


def spoil_file(path: Path, i: int, draw) -> None:
    if path.is_dir():
        file = sorted(path.iterdir())[i]
        if draw(st.booleans()):
            spoil_objects(file, i, draw)
        else:
            file.write_bytes(file.read_bytes()[: draw(st.integers(0, file.stat().st_size - 1))])
    elif path.suffix in (".npz", ".npy"):
        spoil_arrays(path, i, draw)
    elif path.suffix == ".csv" or (path.suffix != ".pkl" and draw(st.booleans())):
        spoil_text(path, i, draw)
    else:
        spoil_objects(path, i, draw)


@pytest.mark.parametrize("written", WRITERS)
@settings(max_examples=8, deadline=None, derandomize=True)
@given(i=st.sampled_from([0, 1, 37, FRAMES - 2, FRAMES - 1]), data=st.data())
def test_a_fault_in_one_frame_costs_that_frame_at_most(written, i, data):
    """Wherever it is: the file is read, a finding names frame or repair, and other frames are the same."""
    with tempfile.TemporaryDirectory() as folder:
        path = WRITERS[written](Path(folder), moving().part(slice(FRAMES)))
        sound, known = open_recording(path)
        _, known_too = examine(sound)
        spoil_file(path, i, data.draw)
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


@pytest.mark.parametrize("seconds", [-5.0, 500.0])
def test_a_stretch_of_wrong_times_costs_about_its_frames(tmp_path, seconds):
    """A clock that was set wrong for a while; other frames keep their times."""
    hand = moving()
    t = hand.t.copy()
    t[100:120] += seconds
    recording = read_recording(write_own(tmp_path, hand, t=t))
    assert 20 <= np.count_nonzero(~recording.valid) <= 22
    np.testing.assert_allclose(recording.t, hand.t, atol=1e-6)

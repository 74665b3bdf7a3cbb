"""Recordings, their file, and recordings that are kept while they are made."""

import dataclasses
import dataclasses as dc
import os
import threading

import numpy as np
import pytest
from glove_files import write_own
from moving_hands import moving

from geort_drake import Recording, read_recording, synthesize_play
from geort_drake.errors import OutputError, RecordingError
from geort_drake.people.recording_parts import RecordingParts


def recorded(frames=400) -> Recording:
    hand = moving()
    return Recording(hand.t[:frames], hand.p_HK[:frames], np.ones(frames, bool), None, {"side": "right"})


def test_a_recording_survives_saving_and_loading(tmp_path):
    """All arrays, the metadata and the digest are the same after a round trip through the file."""
    recording = recorded()
    pose = np.tile([1.0, 0, 0, 0, 0.1, 0.2, 0.3], (len(recording), 1))
    recording = dataclasses.replace(
        recording, X_WH=pose, metadata={"side": "left", "subject": "ä", "warnings": ["w"]}
    )
    recording.save(tmp_path / "r.npz")
    loaded = Recording.load(tmp_path / "r.npz")
    for name in ("t", "p_HK", "valid", "X_WH"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(recording, name))
    assert loaded.digest == recording.digest
    assert loaded.metadata == {**recording.metadata, "convention": 1}
    assert loaded.mirrored().side == "right"
    assert loaded.mirrored().metadata["recorded_side"] == "left"
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    with pytest.raises(RecordingError, match=r"saved as \.npz, not '\.pkl'"):
        recording.save(tmp_path / "r.pkl")


def test_the_digest_tells_recordings_apart():
    """Changing one keypoint, a flag, a time or the side changes the digest; a comment does not."""
    recording = recorded()
    moved, lost, later = recording.p_HK.copy(), recording.valid.copy(), recording.t.copy()
    moved[3, 4, 0] += 1e-6
    lost[5] = False
    later[-1] += 1e-9
    others = [{"p_HK": moved}, {"valid": lost}, {"t": later}, {"metadata": {"side": "left"}}]
    assert len({recording.digest, *(dataclasses.replace(recording, **other).digest for other in others)}) == 5
    assert dataclasses.replace(recording, metadata={"side": "right", "note": "x"}).digest == recording.digest


def test_gaps_and_lost_frames_do_not_disturb_rate_and_fingertips():
    """A gap of a second leaves the rate at 60 Hz; invalid frames do not show in fingertips."""
    recording = recorded()
    t, valid = recording.t.copy(), recording.valid.copy()
    t[200:] += 1.0
    valid[10:20] = False
    recording = dataclasses.replace(recording, t=t, valid=valid)
    assert recording.rate_hz == pytest.approx(60.0, rel=1e-6)
    assert recording.fingertips([8, 4]).shape == (390, 2, 3)
    np.testing.assert_array_equal(recording.fingertips([8, 4])[10], recording.p_HK[20][[8, 4]])


@pytest.mark.parametrize("field", ["t", "p_HK", "valid", "X_WH"])
def test_arrays_of_the_wrong_shape_or_type_are_refused(field):
    """The field and both shapes are named."""
    for value in (np.zeros((400, 20, 2)), np.full((400, 21, 3), "a")):
        with pytest.raises(RecordingError, match=rf"{field} must be numbers of shape .*, not .* \(400, 2"):
            dataclasses.replace(recorded(), **{field: value})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": None, "valid": None}, "it lacks t, valid"),
        ({"metadata": np.array("{")}, "metadata is not JSON"),
        ({"metadata": np.array('{"convention": 1}')}, "must name a side, one of: left, right"),
    ],
)
def test_malformed_files_are_refused(tmp_path, changes, message):
    """A file that lacks a field is named and refused."""
    with pytest.raises(RecordingError, match=message):
        Recording.load(write_own(tmp_path, moving(), **changes))


PLAY = dc.replace(synthesize_play(4, duration_s=8.0, rate_hz=50.0), metadata={"side": "right"})
PLAY = dc.replace(PLAY, X_WH=np.tile(np.eye(7)[0], (len(PLAY), 1)))
LATER = 3.25  # s, when the first frame came


def append(parts: RecordingParts, frames: range, step: int = 50) -> None:
    for start in frames[::step]:
        part = slice(start, min(start + step, frames.stop))
        parts.append(PLAY.t[part] + LATER, PLAY.p_HK[part], PLAY.valid[part], PLAY.X_WH[part])


def interrupt(parts: RecordingParts) -> None:
    """Ends the thread and leaves everything else as kill -9 would."""
    parts._waiting.put(None)
    parts._thread.join()


def test_parts_are_joined_to_one_recording(tmp_path):
    """Times from zero, nothing missing, and no part left."""
    parts = RecordingParts(tmp_path / "session.npz", PLAY.metadata)
    append(parts, range(len(PLAY)))
    assert parts.finish()
    assert [path.name for path in tmp_path.iterdir()] == ["session.npz"]
    joined = Recording.load(tmp_path / "session.npz")
    np.testing.assert_allclose(joined.t, PLAY.t, atol=1e-12)
    for name in ("p_HK", "valid", "X_WH"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(PLAY, name))


def test_an_interrupted_session_is_read_and_then_kept(tmp_path):
    """Under the file's name while there is none; under another one by the next session."""
    path = tmp_path / "session.npz"
    first = RecordingParts(path, PLAY.metadata)
    append(first, range(300))
    interrupt(first)
    read = read_recording(path)
    assert len(read) == 300
    np.testing.assert_array_equal(read.p_HK, PLAY.p_HK[:300])
    with pytest.raises(RecordingError, match="right"):
        read_recording(path, side="left")
    again = RecordingParts(path, PLAY.metadata)
    assert again.recovered == tmp_path / "session-interrupted-1.npz"
    assert Recording.load(again.recovered).digest == read.digest
    append(again, range(100))
    assert again.finish()
    assert len(read_recording(path)) == 100
    assert len(read_recording(again.recovered)) == 300


def test_a_full_disk_keeps_the_parts_before(tmp_path, monkeypatch):
    """The session goes on, with one warning; its end names the file, and the parts can be read."""
    save, saved = Recording.save, []

    def full(recording, path):
        if len(saved) == 3:
            raise OutputError(f"{path}: cannot be written: No space left on device")
        saved.append(path)
        save(recording, path)

    monkeypatch.setattr(Recording, "save", full)
    path = tmp_path / "session.npz"
    parts = RecordingParts(path, PLAY.metadata)
    with pytest.warns(RuntimeWarning, match="the recording ends here: .*No space left") as warned:
        append(parts, range(len(PLAY)))
        with pytest.raises(OutputError, match=r"000003\.npz: cannot be written: No space left"):
            parts.finish()
    assert len(warned) == 1
    assert len(read_recording(path)) == 150


def test_a_disk_that_hangs_holds_nobody_up(tmp_path, monkeypatch):
    """Memory stays bounded: what does not fit is left out, and told."""
    go_on = threading.Event()
    save = Recording.save
    monkeypatch.setattr(Recording, "save", lambda *arguments: (go_on.wait(), save(*arguments)))
    parts = RecordingParts(tmp_path / "session.npz", PLAY.metadata)
    with pytest.warns(RuntimeWarning, match="disk is too slow"):
        append(parts, range(200), step=10)
    go_on.set()
    with pytest.raises(OutputError, match="disk is too slow"):
        parts.finish()


def test_a_broken_part_is_named(tmp_path):
    """Nothing is joined or removed."""
    path = tmp_path / "session.npz"
    parts = RecordingParts(path, PLAY.metadata)
    append(parts, range(100))
    interrupt(parts)
    (tmp_path / "session.npz.parts" / "000001.npz").write_bytes(b"x")
    for read in (read_recording, lambda path: RecordingParts(path, {})):
        with pytest.raises(RecordingError, match=r"000001\.npz: not a readable NumPy file"):
            read(path)
    assert sorted(os.listdir(tmp_path)) == ["session.npz.parts"]

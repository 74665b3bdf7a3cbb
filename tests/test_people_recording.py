"""Recordings and their file."""

import dataclasses

import numpy as np
import pytest
from glove_files import write_own
from moving_hands import moving

from geort_drake.errors import RecordingError
from geort_drake.people.recording import Recording


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
        with pytest.raises(RecordingError, match=rf"{field} must hold numbers of shape .*, not .* \(400, 2"):
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

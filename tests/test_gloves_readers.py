"""Readers: files made here with a known hand, the real ones where they are at hand, and bad ones."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import bone_lengths, mirrored
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import ASSUMED_RATE_HZ, read_recording
from geort_drake.people.recording import PINCH_M
from geort_drake.people.summary import pinch_distances

RATE_HZ = 50.0


def pinches(recording):
    """Number of frames in which the thumb pinches each finger."""
    return {finger: int((d < PINCH_M).sum()) for finger, d in pinch_distances(recording).items()}


@pytest.fixture(scope="module")
def play():
    return synthesize_play(3, duration_s=12.0, rate_hz=RATE_HZ)


def wrist_motion(frames):
    """A wrist that turns and travels."""
    s = np.arange(frames) / frames
    R_WH = Rotation.from_euler("xyz", np.column_stack([7 * s, 0.8 * np.sin(9 * s), 1 - 3 * s]))
    return R_WH, np.column_stack([0.4 * s, 0.1 * np.cos(s), 1.0 + 0 * s])


def manus_arrays(play, side="right", tracked=True):
    """Raw MANUS arrays of the same hand: 25 nodes in a world frame, Unix time, metacarpal bases."""
    R_WH, p_WH = wrist_motion(len(play))
    # What is measured on a left hand is the mirror image of the hand as it is described.
    seen = mirrored(play.p_HK) if side == "left" else play.p_HK.astype(float)
    p_WK = np.einsum("tij,tkj->tki", R_WH.as_matrix(), seen) + (p_WH[:, None] if tracked else 0.0)
    bases = 0.3 * p_WK[:, [5, 9, 13, 17]] + 0.7 * p_WK[:, :1]
    nodes = np.concatenate(
        [
            p_WK[:, :5],
            *(np.concatenate([bases[:, [i]], p_WK[:, 5 + 4 * i : 9 + 4 * i]], axis=1) for i in range(4)),
        ],
        axis=1,
    )
    data = np.concatenate([nodes, np.tile([1.0, 0, 0, 0], (len(play), 25, 1))], axis=2).astype(np.float32)
    return {
        "data": data,
        "timestamps": 1.7e9 + play.t,
        "keypoint_ids": np.arange(25, dtype=np.int32),
        "chirality": np.array(side.upper()),
        "quaternion_order": np.array("wxyz"),
    }


def save(path, **arrays):
    np.savez(path, **arrays)
    return path


def test_geort_npy_in_the_wrist_frame_is_read_as_it_is(play, tmp_path):
    """Keypoints come back unchanged at the assumed 30 Hz, and the assumption is stated."""
    np.save(tmp_path / "hand.npy", play.p_HK.astype(float))
    recording = read_recording(tmp_path / "hand.npy", training=True)
    np.testing.assert_allclose(recording.p_HK, play.p_HK, atol=1e-7)
    assert recording.rate_hz == pytest.approx(ASSUMED_RATE_HZ)
    assert recording.metadata["rate_known"] is False
    assert any("no timestamps: 30 Hz assumed" in warning for warning in recording.metadata["warnings"])
    assert not any("wrist frame" in warning for warning in recording.metadata["warnings"])
    assert recording.metadata["format"] == "geort"
    assert read_recording(tmp_path / "hand.npy", rate_hz=50.0).metadata["rate_known"] is True
    assert recording.X_WH is None


def test_npy_in_another_frame_is_brought_to_the_wrist(play, tmp_path):
    """World landmarks of a moving hand give the same keypoints; as GeoRT's file, they are warned of."""
    R_WH, p_WH = wrist_motion(len(play))
    p_WK = np.einsum("tij,tkj->tki", R_WH.as_matrix(), play.p_HK.astype(float)) + p_WH[:, None]
    np.save(tmp_path / "world.npy", p_WK)
    recording = read_recording(tmp_path / "world.npy")
    np.testing.assert_allclose(recording.p_HK, play.p_HK, atol=1e-6)
    assert recording.metadata["format"] == "mediapipe"
    warnings = read_recording(tmp_path / "world.npy", format="geort").metadata["warnings"]
    assert any("not given in the wrist frame: moved by" in warning for warning in warnings)


@pytest.mark.parametrize("side", ["right", "left"])
def test_manus_nodes_become_keypoints_and_a_wrist_pose(play, tmp_path, side):
    """25 nodes in a world frame give the 21 keypoints, the wrist's motion and time from 0."""
    path = save(tmp_path / "manus.npz", **manus_arrays(play, side))
    recording = read_recording(path, side)
    np.testing.assert_allclose(recording.p_HK, play.p_HK, atol=1e-6)
    np.testing.assert_allclose(recording.t, play.t, atol=1e-6)
    assert recording.side == side
    assert recording.metadata["wrist_position_tracked"] is True
    assert recording.metadata["start_time_unix_s"] == pytest.approx(1.7e9)
    R_WH, p_WH = wrist_motion(len(play))
    if side == "right":
        turned = Rotation.from_quat(recording.X_WH[:, :4], scalar_first=True)
        assert (turned.inv() * R_WH).magnitude().max() < 1e-4
        np.testing.assert_allclose(recording.X_WH[:, 4:], p_WH, atol=1e-6)
    else:
        # The world is mirrored with the hand: y of the path is negated.
        np.testing.assert_allclose(recording.X_WH[:, 4:], mirrored(p_WH), atol=1e-6)
    # Neighbouring quaternions do not jump to their negatives, although the wrist turns by over 360°.
    assert np.sum(recording.X_WH[1:, :4] * recording.X_WH[:-1, :4], axis=1).min() > 0.9


def test_manus_nodes_are_found_by_their_ids(play, tmp_path):
    """Shuffled nodes with their ids give the same recording."""
    arrays = manus_arrays(play)
    order = np.random.default_rng(0).permutation(25)
    shuffled = {**arrays, "data": arrays["data"][:, order], "keypoint_ids": order}
    expected = read_recording(save(tmp_path / "a.npz", **arrays))
    assert read_recording(save(tmp_path / "b.npz", **shuffled)).digest == expected.digest


def test_a_glove_without_tracker_gives_orientation_alone(play, tmp_path):
    """With the wrist node at the origin the pose's position is zero and metadata says why."""
    recording = read_recording(save(tmp_path / "m.npz", **manus_arrays(play, tracked=False)))
    assert recording.metadata["wrist_position_tracked"] is False
    np.testing.assert_allclose(recording.X_WH[:, 4:], 0.0, atol=1e-7)


def test_lost_manus_frames_are_marked(play, tmp_path):
    """NaN nodes in two frames make those frames invalid; the wrist poses of the others are unharmed."""
    arrays = manus_arrays(play)
    arrays["data"][[5, 6]] = np.nan
    recording = read_recording(save(tmp_path / "m.npz", **arrays))
    assert np.flatnonzero(~recording.valid).tolist() == [5, 6]
    assert np.isfinite(recording.X_WH[recording.valid]).all()
    assert recording.metadata["wrist_position_tracked"] is True


def test_our_own_files_are_read_and_checked(play, tmp_path):
    """A saved recording comes back equal; one that went bad is refused under its file's name."""
    play.save(tmp_path / "own.npz")
    assert read_recording(tmp_path / "own.npz", training=True).digest == play.digest
    spoilt = type(play)(play.t, play.p_HK * 1000, play.valid, None, play.metadata)
    spoilt.save(tmp_path / "mm.npz")
    with pytest.raises(RecordingError, match=r"mm\.npz: .*millimetres"):
        read_recording(tmp_path / "mm.npz")


@pytest.mark.parametrize("given", ["right", "left"])
def test_the_wrong_side_is_noticed_without_being_told(play, tmp_path, given):
    """A hand read as the other side bends backwards and is refused, in both directions."""
    seen = mirrored(play.p_HK) if given == "left" else play.p_HK
    np.save(tmp_path / "hand.npy", seen)
    other = "left" if given == "right" else "right"
    np.testing.assert_allclose(read_recording(tmp_path / "hand.npy", given).p_HK, play.p_HK, atol=1e-6)
    with pytest.raises(RecordingError, match=f"bend backwards .* {given} hand .* side '{given}'"):
        read_recording(tmp_path / "hand.npy", other)


def test_files_that_say_their_side_must_agree(play, tmp_path):
    """Asking for the right hand of a file that says LEFT is an error, for MANUS and our own files."""
    left = save(tmp_path / "m.npz", **manus_arrays(play, "left"))
    with pytest.raises(RecordingError, match="the file holds a left hand, a right one was asked for"):
        read_recording(left)
    play.save(tmp_path / "own.npz")
    with pytest.raises(RecordingError, match="the file holds a right hand, a left one was asked for"):
        read_recording(tmp_path / "own.npz", "left")
    with pytest.raises(UnknownNameError, match="unknown side 'both'; choose one of: left, right"):
        read_recording(left, "both")


def bad_file(tmp_path, play, kind):
    path = tmp_path / (
        "bad.npy" if kind in ("flat npy", "complex npy", "object npy", "no numpy") else "bad.npz"
    )
    arrays = manus_arrays(play)
    if kind == "flat npy":
        np.save(path, play.p_HK.reshape(-1, 63))
    elif kind == "complex npy":
        np.save(path, play.p_HK.astype(complex))
    elif kind == "object npy":
        np.save(path, np.array([{"index": 1}], dtype=object), allow_pickle=True)
    elif kind == "no numpy":
        path.write_text("t,x,y,z\n")
    elif kind == "truncated":
        play.save(path)
        path.write_bytes(path.read_bytes()[:5000])
    elif kind == "other npz":
        np.savez(path, joints=np.zeros(3))
    elif kind == "26 nodes":
        save(path, **{**arrays, "data": np.zeros((50, 26, 7))})
    elif kind == "fewer timestamps":
        save(path, **{**arrays, "timestamps": arrays["timestamps"][:-3]})
    elif kind == "ids":
        save(path, **{**arrays, "keypoint_ids": np.arange(1, 26)})
    elif kind == "chirality":
        save(path, **{**arrays, "chirality": np.array("BOTH")})
    elif kind == "empty":
        save(path, **{**arrays, "data": arrays["data"][:0], "timestamps": arrays["timestamps"][:0]})
    elif kind == "suffix":
        path = tmp_path / "bad.txt"
        path.write_bytes(b"\x80")
    elif kind == "missing":
        path = tmp_path / "nowhere.npz"
    return path


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("flat npy", r"array must hold numbers of shape \(T, 21, 3\), not float32 \(600, 63\)"),
        ("complex npy", r"array must hold numbers of shape \(T, 21, 3\), not complex"),
        ("object npy", "pickled objects, which are never read"),
        ("no numpy", r"bad\.npy: not a readable NumPy file"),
        ("truncated", r"bad\.npz: not a readable NumPy file"),
        (
            "other npz",
            r"holds joints\(3,\), which fits no format known; choose one for '.npz' files: geort_drake",
        ),
        ("26 nodes", r"data must hold numbers of shape \(T, 25, 7\), not float64 \(50, 26, 7\)"),
        ("fewer timestamps", "597 timestamps for 600 frames of data"),
        ("ids", "keypoint_ids must be the numbers 0 to 24 in some order"),
        ("chirality", "chirality 'both' is none of: left, right"),
        ("empty", "at least 2 frames are needed, 0 given"),
        ("suffix", r"recordings are read from \.csv, .*, \.pkl, not '\.txt'"),
        ("missing", r"nowhere\.npz: no such file"),
    ],
)
def test_unreadable_files_are_refused_with_one_clear_message(play, tmp_path, kind, message):
    """File and field are named, and what was wanted and given."""
    with pytest.raises(RecordingError, match=message):
        read_recording(bad_file(tmp_path, play, kind))


@pytest.mark.parametrize("suffix", ["csv", "json", "jsonl", "npy", "npz", "pkl"])
def test_a_git_lfs_pointer_is_named_with_the_way_out(tmp_path, suffix):
    """In place of any recording, also of one of HO-3D's pickles."""
    path = tmp_path / f"0000.{suffix}"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    for read in (path, tmp_path) if suffix == "pkl" else (path,):
        with pytest.raises(RecordingError, match=rf"0000\.{suffix}: is a Git LFS pointer.*`git lfs pull`"):
            read_recording(read)


def test_geort_recording_has_its_known_anatomy(alex_npy):
    """GeoRT's file: 3498 frames, constant bones (index 26, 22, 20 mm), palm 92 mm, known pinches."""
    recording = read_recording(alex_npy, training=True)
    assert len(recording) == 3498
    lengths = 1e3 * bone_lengths(recording.p_HK).reshape(-1, 5, 4)
    np.testing.assert_allclose(lengths.std(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(lengths.mean(axis=0)[1], [88.6, 26.0, 22.0, 20.0], atol=0.06)
    np.testing.assert_allclose(lengths.mean(axis=0)[2], [92.0, 26.0, 26.0, 22.0], atol=0.06)
    assert pinches(recording) == {"index": 632, "middle": 355, "ring": 201, "little": 0}
    said = " ".join(recording.metadata["warnings"])
    assert "the thumb never comes within 15 mm of: little (15 mm)" in said
    assert "264 of 3498 frames repeat the one before exactly" in said


def test_manus_recording_has_its_known_anatomy(manus_npz):
    """The MANUS file: 118.5 Hz, index 44.4, 24.9, 21.9 mm, knuckles and pinches as measured before."""
    recording = read_recording(manus_npz, training=True)
    assert recording.rate_hz == pytest.approx(118.5, abs=0.1)
    assert recording.duration_s == pytest.approx(43.38, abs=0.01)
    lengths = 1e3 * np.median(bone_lengths(recording.p_HK), axis=0).reshape(5, 4)
    np.testing.assert_allclose(lengths[1, 1:], [44.4, 24.9, 21.9], atol=0.1)
    np.testing.assert_allclose(lengths[0, 1:], [48.8, 34.9, 29.3], atol=0.1)
    knuckles = 1e3 * np.median(recording.p_HK[:, [5, 13, 17]], axis=0)
    np.testing.assert_allclose(
        knuckles, [[4.5, 26.1, 94.6], [4.5, -21.2, 90.5], [10.8, -40.0, 83.3]], atol=1.0
    )
    assert recording.metadata["warnings"] == []
    assert recording.metadata["wrist_position_tracked"] is False
    share = np.array(list(pinches(recording).values())) / len(recording)
    assert ((share > 0.065) & (share < 0.105)).all()


def test_the_manus_wrist_node_turns_with_the_wrist_frame(manus_npz):
    """Frame H found from the keypoints keeps its angle to the glove's own wrist quaternion within 6°."""
    recording = read_recording(manus_npz)
    with np.load(manus_npz) as raw:
        node = Rotation.from_quat(raw["data"][:, 0, 3:].astype(float), scalar_first=True)
    found = Rotation.from_quat(recording.X_WH[:, :4], scalar_first=True)
    relative = node.inv() * found
    assert np.rad2deg((relative.mean().inv() * relative).magnitude()).max() < 6.0
    assert np.rad2deg((node[:-1].inv() * node[1:]).magnitude()).sum() > 360.0


def test_metadata_is_json(play, tmp_path):
    """What the readers note can be stored: it is JSON without special types."""
    path = save(tmp_path / "m.npz", **manus_arrays(play))
    metadata = read_recording(path).metadata
    assert json.loads(json.dumps(metadata)) == metadata


def test_a_left_hand_replays_as_a_mirrored_one(play, tmp_path):
    """A left recording, described in its mirror image, fits the same hand model."""
    recording = read_recording(save(tmp_path / "m.npz", **manus_arrays(play, "left")), "left")
    hand = HumanHand.fit(recording)
    np.testing.assert_allclose(hand.lengths, HumanHand.anatomical().lengths, atol=1e-5)

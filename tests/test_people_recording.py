"""Recordings: their file, those that are kept while they are made, and the commands around them."""

import dataclasses as dc
import json
import os

import numpy as np
import pytest
from glove_files import moving, write_own

from geort_drake import Recording, read_recording, synthesize_play
from geort_drake.cli import run_command
from geort_drake.errors import OutputError, RecordingError, UsageError
from geort_drake.people.recording_log import RecordingLog, recover
from geort_drake.people.synthetic.population import sample_person


def recorded(frames=400) -> Recording:
    hand = moving()
    return Recording(hand.t[:frames], hand.p_HK[:frames], np.ones(frames, bool), None, {"side": "right"})


def test_a_recording_survives_saving_and_loading(tmp_path):
    """All arrays, the metadata and the digest are the same after a round trip through the file."""
    metadata = {"side": "left", "subject": "ä", "warnings": ["w"]}
    recording = dc.replace(recorded(), X_WH=np.arange(2800.0).reshape(400, 7), metadata=metadata)
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
    assert len({recording.digest, *(dc.replace(recording, **other).digest for other in others)}) == 5
    assert dc.replace(recording, metadata={"side": "right", "note": "x"}).digest == recording.digest


def test_gaps_and_lost_frames_do_not_change_rate_and_fingertips():
    """A gap of a second leaves the rate at 60 Hz; invalid frames do not show in fingertips."""
    recording = recorded()
    t, valid = recording.t.copy(), recording.valid.copy()
    t[200:] += 1.0
    valid[10:20] = False
    recording = dc.replace(recording, t=t, valid=valid)
    assert recording.rate_hz == pytest.approx(60.0, rel=1e-6)
    assert recording.fingertips([8, 4]).shape == (390, 2, 3)
    np.testing.assert_array_equal(recording.fingertips([8, 4])[10], recording.p_HK[20][[8, 4]])


@pytest.mark.parametrize("field", ["t", "p_HK", "valid", "X_WH"])
def test_arrays_of_the_wrong_shape_or_type_are_refused(field):
    """The field and both shapes are named."""
    for value in (np.zeros((400, 20, 2)), np.full((400, 21, 3), "a")):
        with pytest.raises(RecordingError, match=rf"{field} must be numbers of shape .*, not .* \(400, 2"):
            dc.replace(recorded(), **{field: value})
    with pytest.raises(RecordingError, match="one of: left, right"):
        dc.replace(recorded(), metadata={"side": "Left"})


@pytest.mark.parametrize("value", [0.5, 255, np.nan])
def test_a_frame_is_valid_or_not(value):
    """Nothing between is taken for valid."""
    with pytest.raises(RecordingError, match="valid must be true or false, or 1 or 0"):
        dc.replace(recorded(), valid=np.full(400, value))
    assert dc.replace(recorded(), valid=np.ones(400, int)).valid.dtype == bool


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": None, "valid": None}, "it lacks t, valid"),
        ({"metadata": np.array("{")}, "metadata is not JSON"),
        ({"metadata": np.array('{"convention": 1}')}, "must name a side, one of: left, right"),
        (
            {"metadata": np.array('{"side": "left", "convention": 1, "warnings": 5}')},
            "warnings must be a list of strings, not 5",
        ),
        (
            {"metadata": np.array('{"side": "left", "convention": 1, "robot_signals": "arm"}')},
            "robot_signals must be a list of strings, not 'arm'",
        ),
    ],
)
def test_malformed_files_are_refused(tmp_path, changes, message):
    """A file that lacks a field is named and refused."""
    with pytest.raises(RecordingError, match=message):
        Recording.load(write_own(tmp_path, moving(), **changes))


PLAY = dc.replace(synthesize_play(4, duration_s=8.0, rate_hz=50.0), metadata={"side": "right"})
PLAY = dc.replace(PLAY, X_WH=np.tile(np.eye(7)[0], (len(PLAY), 1)))
LATER = 3.25  # s, when the first frame came


def append(log: RecordingLog, frames: range) -> None:
    for i in frames:
        log.append(np.concatenate([[PLAY.t[i] + LATER], PLAY.p_HK[i].ravel(), [PLAY.valid[i]], PLAY.X_WH[i]]))


def test_appended_frames_become_the_recording(tmp_path):
    """Times from zero, nothing missing, facts from the end, no other file left; without frames, none."""
    path = tmp_path / "session.npz"
    log = RecordingLog(path, PLAY.metadata)
    append(log, range(len(PLAY)))
    assert log.finish(outcome="held")
    assert os.listdir(tmp_path) == ["session.npz"]
    recording = read_recording(path)
    np.testing.assert_allclose(recording.t, PLAY.t, atol=1e-12)
    for name in ("p_HK", "valid", "X_WH"):
        np.testing.assert_array_equal(getattr(recording, name), getattr(PLAY, name))
    assert recording.metadata["outcome"] == "held"
    assert not RecordingLog(tmp_path / "empty.npz", PLAY.metadata).finish()
    assert os.listdir(tmp_path) == ["session.npz"]


def test_the_joints_of_a_robot_are_kept(tmp_path):
    signals = {**PLAY.metadata, "robot_signals": ["a", "b"]}
    log = RecordingLog(tmp_path / "session.npz", signals)
    q = np.arange(100.0).reshape(50, 2)
    for i in range(50):
        log.append(np.concatenate([PLAY.t[i : i + 1], PLAY.p_HK[i].ravel(), [1.0], PLAY.X_WH[i], q[i]]))
    assert log.finish()
    np.testing.assert_array_equal(Recording.load(tmp_path / "session.npz").robot, q)


def test_frames_of_a_killed_session_become_its_recording(tmp_path):
    """Also those before a last row that was cut off; a session that goes on keeps its log."""
    path, other = tmp_path / "session.npz", RecordingLog(tmp_path / "other.npz", PLAY.metadata)
    append(RecordingLog(path, PLAY.metadata), range(300))  # never finished, as after kill -9
    with open(tmp_path / "session.npz.log", "ab") as file:
        file.write(b"12345")
    append(other, range(100))
    with pytest.warns(UserWarning) as told:
        recover(tmp_path)
    assert [str(each.message).split("/")[-1] for each in told] == [
        "other.npz.log: another process is writing to it",
        "session.npz, the recording of a session that was interrupted",
    ]
    np.testing.assert_array_equal(read_recording(path).p_HK, PLAY.p_HK[:300])
    assert other.finish()
    assert sorted(os.listdir(tmp_path)) == ["other.npz", "session.npz"]
    recover(tmp_path / "none")


def test_recovery_replaces_no_recording(tmp_path):
    path = tmp_path / "session.npz"
    append(RecordingLog(path, PLAY.metadata), range(300))  # never finished, as after kill -9
    PLAY.save(path)
    before = path.read_bytes()
    with pytest.warns(UserWarning, match=r"session\.npz\.log: not recovered: session\.npz exists; move one"):
        recover(tmp_path)
    assert path.read_bytes() == before and (tmp_path / "session.npz.log").exists()


def test_a_damaged_log_is_named_and_kept(tmp_path):
    (tmp_path / "session.npz.log").write_bytes(b"[1]x")
    with pytest.warns(UserWarning, match=r"session\.npz\.log: not recovered: Extra data"):
        recover(tmp_path)
    with pytest.raises(OutputError, match=r"session\.npz\.log: an earlier session left this file"):
        RecordingLog(tmp_path / "session.npz", PLAY.metadata)
    assert (tmp_path / "session.npz.log").read_bytes() == b"[1]x"
    with pytest.raises(RecordingError, match=r"saved as \.npz, not '\.csv'"):
        RecordingLog(tmp_path / "session.csv", PLAY.metadata)


def test_a_full_disk_ends_the_recording_with_a_warning(tmp_path, monkeypatch):
    """Later frames are dropped, the error comes at the end, and what was written stays."""
    log = RecordingLog(tmp_path / "session.npz", PLAY.metadata)
    append(log, range(100))
    log._file.close()
    monkeypatch.setattr(log, "_file", open("/dev/full", "wb", buffering=0))
    with pytest.warns(RuntimeWarning, match="cannot be written: No space left"):
        append(log, range(100, 200))
    assert log.error is not None
    with pytest.raises(OutputError, match="No space left"):
        log.finish()
    with pytest.warns(UserWarning, match="interrupted"):
        recover(tmp_path)
    assert len(Recording.load(tmp_path / "session.npz")) == 100


@pytest.fixture(scope="module")
def npy(tmp_path_factory):
    path = tmp_path_factory.mktemp("glove") / "hand.npy"
    np.save(path, synthesize_play(0, duration_s=15.0, rate_hz=30.0).p_HK)
    return path


def test_synthesizing_writes_the_recording_of_that_seed(npy, tmp_path):
    """The file equals synthesize_play with the same arguments; with --hand-of it has that person's bones."""
    run_command(
        "recording synthesize",
        ["--output", str(tmp_path / "play.npz"), "--seed", "3", "--duration", "12", "--rate", "60"],
    )
    assert Recording.load(tmp_path / "play.npz").digest == synthesize_play(3, 12.0, 60.0).digest
    run_command(
        "recording synthesize",
        ["--output", str(tmp_path / "p.npz"), "--duration", "5", "--hand-of", str(npy)],
    )
    bones = np.linalg.norm(np.diff(Recording.load(tmp_path / "p.npz").p_HK[:, 5:9], axis=1), axis=-1)
    expected = np.linalg.norm(np.diff(np.load(npy)[0, 5:9], axis=0), axis=-1)
    np.testing.assert_allclose(bones, np.tile(expected, (len(bones), 1)), atol=1e-5)


def test_people_are_written(tmp_path, capsys):
    """One file a person, at their device's rate unless --rate is given; they have hands of their own.

    People of an earlier run stay, with a warning.
    """
    options = ["--people", "2", "--seed", "3", "--duration", "12"]
    run_command("recording synthesize", ["--output", str(tmp_path / "all"), *options])
    for number in range(2):
        read = read_recording(tmp_path / "all" / f"person_{number:03d}.npz")
        assert read.digest == sample_person(3, number).record(12.0).digest
    run_command(
        "recording synthesize",
        ["--output", str(tmp_path / "slow"), *options, "--rate", "30", "--side", "left"],
    )
    slow = Recording.load(tmp_path / "slow" / "person_001.npz")
    assert (len(slow), slow.side) == (360, "left")
    assert "another run" not in capsys.readouterr().err
    run_command(
        "recording synthesize", ["--output", str(tmp_path / "slow"), "--people", "1", "--duration", "12"]
    )
    assert "another run, such as person_001.npz" in " ".join(capsys.readouterr().err.split())
    with pytest.raises(UsageError, match="--people"):
        run_command(
            "recording synthesize", ["--output", str(tmp_path / "p.npz"), *options, "--hand-of", "hand.npy"]
        )


def test_converting_writes_a_recording_and_reports_its_health(npy, tmp_path, capsys):
    """The file equals what the reader gives; the report has rate, fingers, verdict and what is next."""
    run_command("recording convert", [str(npy), "--output", str(tmp_path / "hand.npz")])
    saved, read = Recording.load(tmp_path / "hand.npz"), read_recording(npy)
    assert saved.digest == read.digest and saved.metadata["warnings"] == read.metadata["warnings"]
    said = " ".join(capsys.readouterr().err.split())
    for part in ("450 valid", "15.0 s at 30.0 Hz (assumed)", "no timestamps: 30 Hz assumed", "next: "):
        assert part in said
    assert said.endswith(f" grasp --recording {tmp_path / 'hand.npz'}")


def test_a_recording_is_mirrored_for_a_hand_of_the_other_side(npy, tmp_path, capsys):
    """The other hand makes the same motion: stored in the mirror, the keypoints are the same."""
    run_command(
        "recording convert", [str(npy), "--output", str(tmp_path / "left.npz"), "--mirror", "--json", "-"]
    )
    out = capsys.readouterr()
    report = json.loads(out.out)
    assert (report["side"], report["recorded_side"]) == ("left", "right")
    assert "left hand, mirrored from a right one" in out.err
    assert out.err.rstrip().endswith(f"--recording {tmp_path / 'left.npz'} --hand allegro_left")
    right, left = read_recording(npy), read_recording(tmp_path / "left.npz", "left", training=True)
    np.testing.assert_array_equal(left.p_HK, right.p_HK)
    assert left.metadata["recorded_side"] == "right" and left.digest != right.digest
    with pytest.raises(RecordingError, match=r"contains a left hand, .*convert FILE --side left --mirror"):
        read_recording(tmp_path / "left.npz")
    assert left.mirrored().digest == right.digest


def test_the_report_is_also_written_as_json(npy, tmp_path, capsys):
    """One object on stdout: verdict, sentences, figures; for what is refused, the reason."""
    run_command("recording check", [str(npy), "--json", "-", "--rate", "60"])
    said = capsys.readouterr()  # other commands have no --rate, so the next one is convert
    assert f"recording convert {npy} --output {npy.with_name('hand_converted.npz')} --rate 60.0" in " ".join(
        said.err.split()
    )
    report = json.loads(said.out)
    assert report["fit_for_training"] is True
    known = {"format": "geort", "side": "right", "frames": 450, "wrist": "none", "rate_known": True}
    assert known.items() <= report.items()
    assert report["sha256"] == read_recording(npy, rate_hz=60.0).digest
    assert len(report["fingers"]["index"]["bones_mm"]) == 4
    assert report["verdict"] == "usable" and report["warnings"] == []
    np.save(tmp_path / "mm.npy", 1e3 * np.load(npy))
    for path, reason in ((tmp_path / "mm.npy", "in mm"), (tmp_path, "is no file")):
        with pytest.raises(RecordingError):
            run_command("recording check", [str(path), "--json", "-"])
        report = json.loads(capsys.readouterr().out)
        assert (report["verdict"], report["fit_for_training"]) == ("refused", False)
        assert reason in report["reason"]

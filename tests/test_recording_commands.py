"""The commands that make, check and convert recordings."""

import json

import numpy as np
import pytest

from geort_drake import Recording, read_recording, synthesize_play
from geort_drake.cli import run_command
from geort_drake.errors import RecordingError, UsageError
from geort_drake.people.population import sample_person


@pytest.fixture(scope="module")
def npy(tmp_path_factory):
    path = tmp_path_factory.mktemp("glove") / "hand.npy"
    np.save(path, synthesize_play(0, duration_s=15.0, rate_hz=30.0).p_HK)
    return path


def test_synthesizing_writes_the_recording_of_that_seed(npy, tmp_path):
    """The file equals synthesize_play with the same arguments; with --hand-of it has that person's bones."""
    arguments = ["--seed", "3", "--duration", "12", "--rate", "60"]
    run_command("synthesize", [str(tmp_path / "play.npz"), *arguments])
    assert Recording.load(tmp_path / "play.npz").digest == synthesize_play(3, 12.0, 60.0).digest
    run_command("synthesize", [str(tmp_path / "p.npz"), "--duration", "5", "--hand-of", str(npy)])
    bones = np.linalg.norm(np.diff(Recording.load(tmp_path / "p.npz").p_HK[:, 5:9], axis=1), axis=-1)
    expected = np.linalg.norm(np.diff(np.load(npy)[0, 5:9], axis=0), axis=-1)
    np.testing.assert_allclose(bones, np.tile(expected, (len(bones), 1)), atol=1e-5)


def test_people_are_written(tmp_path):
    """One file a person, at their device's rate unless --rate is given; they have hands of their own."""
    options = ["--people", "2", "--seed", "3", "--duration", "12"]
    run_command("synthesize", [str(tmp_path / "all"), *options])
    for number in range(2):
        read = read_recording(tmp_path / "all" / f"person_{number:03d}.npz")
        assert read.digest == sample_person(3, number).record(12.0).digest
    run_command("synthesize", [str(tmp_path / "slow"), *options, "--rate", "30", "--side", "left"])
    slow = Recording.load(tmp_path / "slow" / "person_001.npz")
    assert (len(slow), slow.side) == (360, "left")
    with pytest.raises(UsageError, match="--people"):
        run_command("synthesize", [str(tmp_path / "p.npz"), *options, "--hand-of", "hand.npy"])


def test_converting_writes_a_recording_and_reports_its_health(npy, tmp_path, capsys):
    """The file equals what the reader gives; the report has rate, fingers, verdict and what is next."""
    run_command("convert", [str(npy), str(tmp_path / "hand.npz")])
    saved = Recording.load(tmp_path / "hand.npz")
    assert saved.digest == read_recording(npy).digest
    assert saved.metadata["warnings"] == read_recording(npy).metadata["warnings"]
    said = " ".join(capsys.readouterr().err.split())
    for part in ("450 valid", "15.0 s at 30.0 Hz (assumed)", "thumb never comes within 15 mm", "next: "):
        assert part in said
    assert said.endswith(f" grasp --recording {tmp_path / 'hand.npz'}")


def test_a_recording_is_mirrored_for_a_hand_of_the_other_side(npy, tmp_path, capsys):
    """The other hand makes the same motion: stored in the mirror, the keypoints are the same."""
    run_command("convert", [str(npy), str(tmp_path / "left.npz"), "--mirror", "--json"])
    out = capsys.readouterr()
    report = json.loads(out.out)
    assert (report["side"], report["recorded_side"]) == ("left", "right")
    assert "left hand, mirrored from a right one" in out.err
    assert out.err.rstrip().endswith(f"--recording {tmp_path / 'left.npz'} --hand allegro_left")
    right, left = read_recording(npy), read_recording(tmp_path / "left.npz", "left", training=True)
    np.testing.assert_array_equal(left.p_HK, right.p_HK)
    assert left.metadata["recorded_side"] == "right"
    assert left.digest != right.digest
    with pytest.raises(RecordingError, match=r"contains a left hand, .* with --side left --mirror"):
        read_recording(tmp_path / "left.npz")
    assert left.mirrored().digest == right.digest


def test_the_report_is_also_given_as_json(npy, tmp_path, capsys):
    """One object on stdout: verdict, findings with place and advice, figures; also of what is refused."""
    run_command("check-recording", [str(npy), "--json", "--rate", "60"])
    report = json.loads(capsys.readouterr().out)
    assert report["fit_for_training"] is True
    known = {"format": "geort", "side": "right", "frames": 450, "wrist": "none", "rate_known": True}
    assert known.items() <= report.items()
    assert report["sha256"] == read_recording(npy, rate_hz=60.0).digest
    assert len(report["fingers"]["index"]["bones_mm"]) == 4
    assert {"check", "severity", "what", "where", "advice", "lost_frames"} == report["findings"][0].keys()
    np.save(tmp_path / "mm.npy", 1e3 * np.load(npy))
    for path, check in ((tmp_path / "mm.npy", "unit"), (tmp_path, "file")):
        with pytest.raises(RecordingError):
            run_command("check-recording", [str(path), "--json"])
        report = json.loads(capsys.readouterr().out)
        assert (report["verdict"], report["fit_for_training"]) == ("refused", False)
        assert report["findings"][-1]["check"] == check

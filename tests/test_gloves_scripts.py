"""The scripts that make and import recordings, run as a user runs them."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from geort_drake.gloves.play import synthesize_play
from geort_drake.gloves.readers import read_recording
from geort_drake.gloves.recording import Recording

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


def run(script, *arguments):
    command = [sys.executable, str(SCRIPTS / script), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def npy(tmp_path_factory):
    path = tmp_path_factory.mktemp("glove") / "hand.npy"
    np.save(path, synthesize_play(0, duration_s=15.0, rate_hz=30.0).p_HK)
    return path


def test_synthesizing_writes_the_recording_of_that_seed_and_a_plot(npy, tmp_path):
    """The file equals synthesize_play with the same arguments; the plot is a PNG of some size."""
    output, plot = tmp_path / "play.npz", tmp_path / "play.png"
    arguments = ["--seed", 3, "--duration", 12, "--rate", 60, "--plot", plot, "--compare", npy]
    result = run("synthesize_recording.py", output, *arguments)
    assert result.returncode == 0, result.stderr
    assert Recording.load(output).digest == synthesize_play(3, 12.0, 60.0).digest
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert plot.stat().st_size > 50_000


def test_synthesizing_with_somebodys_hand_uses_their_bones(npy, tmp_path):
    """With --hand_of the bones are those of that recording."""
    result = run("synthesize_recording.py", tmp_path / "p.npz", "--duration", 5, "--hand_of", npy)
    assert result.returncode == 0, result.stderr
    bones = np.linalg.norm(np.diff(Recording.load(tmp_path / "p.npz").p_HK[:, 5:9], axis=1), axis=-1)
    expected = np.linalg.norm(np.diff(np.load(npy)[0, 5:9], axis=0), axis=-1)
    np.testing.assert_allclose(bones, np.tile(expected, (len(bones), 1)), atol=1e-5)


def test_importing_converts_and_reports_the_hands_health(npy, tmp_path):
    """The written file equals what the reader gives, and the report names rate, fingers and verdict."""
    result = run("import_recording.py", npy, tmp_path / "hand.npz")
    assert result.returncode == 0, result.stderr
    assert Recording.load(tmp_path / "hand.npz").digest == read_recording(npy).digest
    assert "450 frames, 450 valid, 15.0 s at 30.0 Hz (assumed)" in result.stderr
    assert "warning: no timestamps: 30 Hz assumed" in result.stderr
    assert "verdict: fit for training" in result.stderr


def test_a_recording_too_short_for_training_is_imported_with_that_verdict(npy, tmp_path):
    """100 frames can be replayed; the verdict says why they do not train."""
    np.save(tmp_path / "short.npy", np.load(npy)[:100])
    result = run("import_recording.py", tmp_path / "short.npy")
    assert result.returncode == 0, result.stderr
    assert "verdict: fit for replay, not for training" in result.stderr
    assert "training needs at least 300" in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["short.npy"]


def test_bad_input_ends_with_exit_code_2_and_one_line(npy, tmp_path):
    """A mirrored hand is refused by name, nothing is written and there is no traceback."""
    result = run("import_recording.py", npy, tmp_path / "hand.npz", "--side", "left")
    assert result.returncode == 2
    assert result.stderr.startswith("error: ")
    assert "bend backwards" in result.stderr
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("script", ["import_recording.py", "synthesize_recording.py"])
def test_help_names_every_option(script):
    """--help exits with 0 and explains the arguments."""
    result = run(script, "--help")
    assert result.returncode == 0
    assert "usage:" in result.stdout
    assert "--side" in result.stdout

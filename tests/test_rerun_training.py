"""The recording of a training: what it holds, and that recording changes nothing."""

import numpy as np
import pytest
from rerun_world import entities, read, rerun

from geort_drake.cli import run_command
from geort_drake.comparison import training_recording
from geort_drake.retargeting.retargeter import load_retargeter


@pytest.mark.usefixtures("light_evaluation")
def test_a_training_is_the_same_when_it_is_recorded(tmp_path, play, allegro, monkeypatch):
    """Its weights are; losses, criteria and the robot hand are recorded step by step up to the final map."""
    monkeypatch.setattr(training_recording, "_SAMPLES", 2000)
    play.save(tmp_path / "play.npz")
    common = ["--recording", str(tmp_path / "play.npz"), "--robot-samples", "1000", "--steps", "5", "--quiet"]
    path = tmp_path / "training.rrd"
    for name, more in (("plain", []), ("seen", ["--rrd", str(path)])):
        assert run_command("train", [*common, "--output", str(tmp_path / name), *more]) == 0
    plain, seen = ((tmp_path / name / "weights.safetensors").read_bytes() for name in ("plain", "seen"))
    assert plain == seen
    assert rerun("rrd", "verify", path).returncode == 0
    steps, closed = read(path, "/criteria/pinch", "Scalars:scalars", timeline="step")
    assert (steps[0], steps[-1]) == (1, 5) and ((np.array(closed) >= 0) & (np.array(closed) <= 1)).all()
    for loss in (entity for entity in entities(path) if entity.startswith("/losses/")):
        steps, values = read(path, loss, "Scalars:scalars", timeline="step")
        assert steps[0] == 0 and np.isfinite(values).all()
    # The thumb's lattice at the end is in the final map's image of the hands that it is made of.
    thumb = allegro.finger_names[0]
    _, lattices = read(path, f"/world/robot/lattice/{thumb}", "LineStrips3D:strips", timeline="step")
    lattice = training_recording.Lattice(play.fingertips(allegro.description.human_keypoints), 0)
    q = load_retargeter(tmp_path / "seen", allegro)(lattice.hands)
    np.testing.assert_allclose(lattices[-1], lattice.segments(allegro.fingertips(q)[:, 0]), atol=1e-5)

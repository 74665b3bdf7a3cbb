"""Checkpoints are whole or refused, give back the map that was saved, and tell where it was trained."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from faults.sound import TIPS, checkpoint, play, smooth_arrays

from geort_drake import Retargeter, load_retargeter
from geort_drake.errors import CheckpointError
from geort_drake.retargeting.checkpoint import REQUIRED, load_checkpoint
from geort_drake.retargeting.trained_space import trained_points


def test_a_checkpoint_comes_back_as_it_was(tmp_path, allegro, rng):
    """Same outputs after saving and loading; an earlier checkpoint is replaced."""
    checkpoint(tmp_path, history=[{"step": 1}, {"step": 2}])
    path = checkpoint(tmp_path, metrics={"coverage": 0.5})
    p, loaded = rng.normal(0.05, 0.05, (50, 4, 3)), load_retargeter(path)
    names = allegro.finger_names, allegro.joint_names
    saved = Retargeter(smooth_arrays(), *names, TIPS, allegro.lower, allegro.upper)
    np.testing.assert_array_equal(loaded(p), saved(p))
    assert (list(loaded.finger_names), list(loaded.joint_names)) == tuple(map(list, names))
    assert (path / "history.csv").read_text().split() == ["step,total", "0,1.0"]
    assert json.loads((path / "metrics.json").read_text()) == {"coverage": 0.5}
    assert [entry.name for entry in tmp_path.iterdir()] == ["checkpoint"]


@pytest.mark.parametrize("name", REQUIRED)
def test_missing_and_altered_files_are_named(tmp_path, name):
    """One flipped bit is enough; both digests are in the message."""
    path = checkpoint(tmp_path)
    content = bytearray((path / name).read_bytes())
    if name != "config.json":
        content[-3] ^= 1
        (path / name).write_bytes(content)
        message = f"{name}: the file was altered: its sha256 is .* config.json says"
        with pytest.raises(CheckpointError, match=message):
            load_retargeter(path)
    (path / name).unlink()
    with pytest.raises(CheckpointError, match=f"{name} missing; a checkpoint contains"):
        load_retargeter(path)


def test_a_checkpoint_for_another_hand_is_refused(tmp_path, allegro):
    """Joints, fingers and the model's digest must agree; the message has both sides."""
    path = checkpoint(tmp_path)
    load_retargeter(path, allegro)
    facts = {name: getattr(allegro, name) for name in ("finger_names", "joint_names", "digest")}
    for changes, message in (
        ({"joint_names": ["a", "b"]}, "joints joint_12.*expected a, b"),
        ({"digest": "def"}, f"model digest {allegro.digest}, expected def"),
    ):
        with pytest.raises(CheckpointError, match=f"another hand, 'allegro_right': {message}"):
            load_retargeter(path, SimpleNamespace(**facts | changes))


def test_a_failed_save_leaves_the_earlier_checkpoint_and_other_folders_alone(tmp_path):
    """NaN is no JSON; a folder that is not a checkpoint is not replaced, an empty one may be."""
    path = checkpoint(tmp_path)
    with pytest.raises(ValueError, match="JSON"):
        checkpoint(tmp_path, metrics={"coverage": float("nan")})
    assert load_checkpoint(path).config["method"] == "geort"
    assert [entry.name for entry in tmp_path.iterdir()] == ["checkpoint"]
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "thesis.tex").write_text("years")
    (tmp_path / "work" / "config.json").write_text("{}")  # a benchmark has one, too
    for existing in (tmp_path / "work", tmp_path / "work" / "thesis.tex"):
        with pytest.raises(CheckpointError, match="exists and is not a checkpoint"):
            checkpoint(existing.parent, existing.name)
    assert (tmp_path / "work" / "thesis.tex").read_text() == "years"
    (tmp_path / "empty").mkdir()
    assert load_checkpoint(checkpoint(tmp_path, "empty")).config["method"] == "geort"


PLAY = play()
HAND = PLAY.p_HK[0].astype(float)


def test_a_checkpoint_tells_where_it_was_trained_and_an_older_one_still_loads(tmp_path):
    """Without the places, nothing is known about the distance, and the retargeter is the same."""
    new, old = (load_retargeter(checkpoint(tmp_path, str(known), known)) for known in (True, False))
    np.testing.assert_array_equal(new.trained_space.points, trained_points(PLAY.p_HK[:, list(TIPS)]))
    assert old.trained_space is None
    np.testing.assert_array_equal(new(HAND), old(HAND))

"""The NumPy retargeter against the torch network, and checkpoints that are whole or refused."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from retargeting_toy import toy_kinematics, uneven_kinematics

from geort_drake.errors import CheckpointError, GeortError, UnknownNameError
from geort_drake.retargeting.checkpoint import REQUIRED, load_checkpoint, save_checkpoint
from geort_drake.retargeting.retargeter import Retargeter, load_retargeter
from geort_drake.retargeting.training.networks import RetargetingNetwork

KEYPOINTS = (4, 8, 12)


def network_of(kinematics, seed=0) -> RetargetingNetwork:
    generator = torch.Generator().manual_seed(seed)
    mean = 0.05 * torch.rand(len(kinematics.fingers), 3, generator=generator)
    scale = 0.005 + 0.03 * torch.rand(len(kinematics.fingers), 3, generator=generator)
    return RetargetingNetwork(kinematics, mean, scale, 128, generator)


def retargeter_of(kinematics, network) -> Retargeter:
    return Retargeter(
        network.arrays(), kinematics.finger_names, kinematics.joint_names, KEYPOINTS,
        kinematics.lower, kinematics.upper,
    )  # fmt: skip


def save(path, kinematics=None, **changes):
    kinematics = kinematics or toy_kinematics()
    hand = {
        "name": "toy",
        "finger_names": list(kinematics.finger_names),
        "joint_names": list(kinematics.joint_names),
        "lower": kinematics.lower.tolist(),
        "upper": kinematics.upper.tolist(),
        "model_sha256": "abc",
    }
    arguments = {
        "method": "geort", "hand": hand, "human_keypoints": KEYPOINTS, "training": {"steps": 1},
        "provenance": {"seed": 0}, "history": [{"step": 0, "total": 1.5}], "metrics": {"coverage": 0.5},
    }  # fmt: skip
    return save_checkpoint(path, network_of(kinematics).arrays(), **(arguments | changes))


@pytest.mark.parametrize("kinematics", [toy_kinematics(), uneven_kinematics()], ids=["even", "uneven"])
def test_numpy_equals_torch(kinematics, rng):
    """Folding the normalisation into the weights changes nothing, for any joint layout."""
    network = network_of(kinematics)
    retarget = retargeter_of(kinematics, network)
    p = rng.normal(0.05, 0.05, (300, 3, 3))
    expected = network.double()(torch.tensor(p)).detach().numpy()
    np.testing.assert_allclose(retarget(p), expected, atol=1e-6)
    np.testing.assert_allclose(retarget(p[7]), retarget(p)[7], atol=1e-12)


def test_whole_hands_are_reduced_to_the_fingertips(rng):
    """(21, 3) and (N, 21, 3) give what their fingertips give."""
    kinematics = toy_kinematics()
    retarget = retargeter_of(kinematics, network_of(kinematics))
    hands = rng.normal(0.05, 0.05, (5, 21, 3))
    np.testing.assert_array_equal(retarget(hands), retarget(hands[:, list(KEYPOINTS)]))
    np.testing.assert_array_equal(retarget(hands[2]), retarget(hands[2, list(KEYPOINTS)]))


@pytest.mark.parametrize("kinematics", [toy_kinematics(), uneven_kinematics()], ids=["even", "uneven"])
def test_jacobian_equals_finite_differences(kinematics, rng):
    """Analytic rad/m against central differences, zero between fingers."""
    retarget = retargeter_of(kinematics, network_of(kinematics))
    p = rng.normal(0.05, 0.03, (3, 3))
    J = retarget.jacobian(p)
    assert J.shape == (len(kinematics.joint_names), 3, 3)
    numeric = np.zeros_like(J)
    step = 1e-6
    for finger in range(3):
        for axis in range(3):
            e = np.zeros((3, 3))
            e[finger, axis] = step
            numeric[:, finger, axis] = (retarget(p + e) - retarget(p - e)) / (2 * step)
    assert np.abs(numeric).max() > 0.1
    np.testing.assert_allclose(J, numeric, atol=1e-6)


def test_outputs_never_leave_the_joint_limits():
    """Saturated outputs are inside the limits to the last bit."""
    kinematics = toy_kinematics()
    retarget = retargeter_of(kinematics, network_of(kinematics))
    for scale in (1.0, 1e3, 1e9):
        q = retarget(scale * np.random.default_rng(0).normal(size=(2000, 3, 3)))
        assert (q >= kinematics.lower).all()
        assert (q <= kinematics.upper).all()


def test_wrong_input_is_refused():
    """Shapes are listed; NaN and infinity are not passed on."""
    kinematics = toy_kinematics()
    retarget = retargeter_of(kinematics, network_of(kinematics))
    for shape in ((3,), (4, 3), (2, 5, 3), (3, 2), (1, 1, 3, 3)):
        with pytest.raises(ValueError, match=r"\(3, 3\) or \(N, 3, 3\).*thumb, index, middle"):
            retarget(np.zeros(shape))
    for bad in (np.nan, np.inf, -np.inf):
        p = np.zeros((4, 3, 3))
        p[2, 1, 0] = bad
        with pytest.raises(GeortError, match="must be finite"):
            retarget(p)
    with pytest.raises(ValueError, match="jacobian takes one hand"):
        retarget.jacobian(np.zeros((2, 3, 3)))


def test_a_checkpoint_comes_back_as_it_was(tmp_path, rng):
    """Same outputs after saving and loading; an earlier checkpoint is replaced."""
    kinematics = toy_kinematics()
    path = save(tmp_path / "run", history=[{"step": 1}, {"step": 2}])
    save(path)
    p = rng.normal(0.05, 0.05, (50, 3, 3))
    expected = retargeter_of(kinematics, network_of(kinematics))(p)
    loaded = load_retargeter(path)
    np.testing.assert_array_equal(loaded(p), expected)
    assert loaded.joint_names == kinematics.joint_names
    assert loaded.finger_names == kinematics.finger_names
    assert (path / "history.csv").read_text().split() == ["step,total", "0,1.5"]
    assert json.loads((path / "metrics.json").read_text()) == {"coverage": 0.5}
    assert [entry.name for entry in tmp_path.iterdir()] == ["run"]


def test_loading_needs_neither_torch_nor_pydrake(tmp_path):
    """A robot's computer has NumPy and safetensors."""
    path = save(tmp_path / "run")
    code = (
        "import sys; from geort_drake.retargeting.retargeter import load_retargeter; "
        f"load_retargeter({str(path)!r}); "
        "sys.exit(len({'torch', 'pydrake', 'rerun'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", REQUIRED)
def test_a_missing_file_is_named(tmp_path, name):
    """The message says which file and what a checkpoint holds."""
    path = save(tmp_path / "run")
    (path / name).unlink()
    with pytest.raises(CheckpointError, match=f"{name} missing; a checkpoint holds"):
        load_retargeter(path)


@pytest.mark.parametrize("name", [name for name in REQUIRED if name != "config.json"])
def test_an_altered_file_is_refused(tmp_path, name):
    """One flipped bit is enough; both digests are in the message."""
    path = save(tmp_path / "run")
    content = bytearray((path / name).read_bytes())
    content[-3] ^= 1
    (path / name).write_bytes(content)
    with pytest.raises(
        CheckpointError, match=f"{name}: the file was altered: its sha256 is .* config.json says"
    ):
        load_retargeter(path)


def test_other_broken_checkpoints_are_refused(tmp_path):
    """No directory, no JSON, missing fields, another format, an unknown method, foreign names."""
    with pytest.raises(CheckpointError, match="no such checkpoint directory"):
        load_retargeter(tmp_path / "nowhere")
    path = save(tmp_path / "run")
    config = json.loads((path / "config.json").read_text())

    def load_with(content):
        (path / "config.json").write_text(content if isinstance(content, str) else json.dumps(content))
        return load_retargeter(path)

    with pytest.raises(CheckpointError, match="not valid JSON"):
        load_with("{")
    with pytest.raises(CheckpointError, match="must hold an object"):
        load_with("[]")
    with pytest.raises(CheckpointError, match="method missing"):
        load_with({key: value for key, value in config.items() if key != "method"})
    with pytest.raises(CheckpointError, match="format is 99"):
        load_with(config | {"format": 99})
    with pytest.raises(UnknownNameError, match="geort"):
        load_with(config | {"method": "magic"})
    with pytest.raises(CheckpointError, match="joint_names differ"):
        load_with(config | {"joint_names": ["a"]})
    with pytest.raises(CheckpointError, match="3 fingers need as many human_keypoints"):
        load_with(config | {"human_keypoints": [4]})
    assert load_with(config)(np.zeros((3, 3))).shape == (9,)


def test_weights_of_a_wrong_shape_are_refused():
    """The message names the array, what was wanted and what was given."""
    kinematics = toy_kinematics()
    arrays = network_of(kinematics).arrays()
    names = (kinematics.finger_names, kinematics.joint_names, KEYPOINTS, kinematics.lower, kinematics.upper)
    with pytest.raises(CheckpointError, match="'bias1' is missing; there are"):
        Retargeter({k: v for k, v in arrays.items() if k != "bias1"}, *names)
    with pytest.raises(CheckpointError, match=r"'weight1' must be finite and of shape \(3, 128, 128\)"):
        Retargeter(arrays | {"weight1": np.zeros((3, 2, 128))}, *names)
    with pytest.raises(CheckpointError, match="'bias0' must be finite"):
        Retargeter(arrays | {"bias0": np.full((3, 1, 128), np.nan)}, *names)
    with pytest.raises(CheckpointError, match="columns must be 9 different numbers below 9"):
        Retargeter(arrays | {"columns": np.zeros(9, dtype=int)}, *names)


def test_a_checkpoint_for_another_hand_is_refused(tmp_path):
    """Joints, fingers and the model's digest must agree; the message has both sides."""
    path = save(tmp_path / "run")
    kinematics = toy_kinematics()
    facts = {
        "finger_names": list(kinematics.finger_names),
        "joint_names": list(kinematics.joint_names),
        "digest": "abc",
    }
    load_retargeter(path, SimpleNamespace(**facts))
    with pytest.raises(CheckpointError, match=r"another hand, 'toy': its joints is thumb_0.*wanted is a, b"):
        load_retargeter(path, SimpleNamespace(**facts | {"joint_names": ["a", "b"]}))
    with pytest.raises(CheckpointError, match="its model digest is abc, wanted is def"):
        load_retargeter(path, SimpleNamespace(**facts | {"digest": "def"}))
    assert load_checkpoint(path).provenance == {"seed": 0}


def test_a_failed_save_leaves_the_earlier_checkpoint(tmp_path):
    """NaN is no JSON: nothing is written, and what was there stays."""
    path = save(tmp_path / "run")
    with pytest.raises(ValueError, match="JSON"):
        save(path, metrics={"coverage": float("nan")})
    assert load_checkpoint(path).config["method"] == "geort"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run"]


def test_a_directory_that_is_not_a_checkpoint_is_not_replaced(tmp_path):
    """A slip in --output must not cost anybody their files; an empty directory may be used."""
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "thesis.tex").write_text("years")
    with pytest.raises(CheckpointError, match="exists and is not a checkpoint"):
        save(tmp_path / "work")
    with pytest.raises(CheckpointError, match="exists and is not a checkpoint"):
        save(tmp_path / "work" / "thesis.tex")
    assert (tmp_path / "work" / "thesis.tex").read_text() == "years"
    (tmp_path / "empty").mkdir()
    assert load_checkpoint(save(tmp_path / "empty")).config["method"] == "geort"

"""A map that was trained on one person, fitted to another."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from retargeting_toy import toy_data, toy_human, toy_kinematics

from geort_drake.cli import run_command
from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.comparison.train import train_checkpoint
from geort_drake.errors import CheckpointError, RecordingError, TrainingError
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.affine_refit import AffineMaps, fit_affine, folded
from geort_drake.retargeting.checkpoint import load_checkpoint, save_checkpoint
from geort_drake.retargeting.methods.coupled import CoupledRetargeter, fine_tune
from geort_drake.retargeting.methods.coupled.config import CoupledConfig, fine_tuning_config
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.retargeter import Retargeter, load_retargeter
from geort_drake.retargeting.trained_space import TrainedSpace, trained_points
from geort_drake.retargeting.training.networks import RetargetingNetwork

NAMES = ("thumb", "index", "middle")
KEYPOINTS = (4, 8, 12)


@pytest.fixture(scope="module")
def hand():
    return toy_kinematics(NAMES)


@pytest.fixture(scope="module")
def person(hand):
    """Fingertips of the person that was trained on."""
    return toy_human(hand, frames=3000)


def space_of(p_HF):
    return TrainedSpace(trained_points(p_HF), KEYPOINTS)


def other(p_HF):
    """The same hand, larger and elsewhere: each axis of each finger in its own way."""
    stretch = np.array([[1.2, 0.9, 1.1], [1.1, 1.15, 0.95], [0.9, 1.1, 1.2]])
    return stretch * p_HF + np.array([[0.01, 0.02, -0.01], [0.0, 0.015, 0.01], [0.005, -0.01, 0.02]])


@pytest.mark.parametrize(
    ("network_type", "retargeter_type", "widths"),
    [(RetargetingNetwork, Retargeter, (16,)), (CoupledNetwork, CoupledRetargeter, (16, 12))],
)
def test_folded_weights_answer_as_the_old_ones_do_at_the_mapped_fingertips(
    hand, person, network_type, retargeter_type, widths, rng
):
    """For any affine maps."""
    mean, scale = torch.tensor(person.mean(axis=0)), torch.tensor(person.std(axis=0))
    network = network_type(hand, mean, scale, *widths, torch.Generator().manual_seed(0))
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.5, generator=torch.Generator().manual_seed(1))
    maps = AffineMaps(
        np.eye(3) + 0.3 * rng.normal(size=(3, 3, 3)), 0.02 * rng.normal(size=(3, 3)), np.zeros(3)
    )
    given = NAMES, hand.joint_names, KEYPOINTS, hand.lower, hand.upper
    before = retargeter_type(network.arrays(), *given)
    after = retargeter_type(folded(network.arrays(), maps), *given)
    np.testing.assert_allclose(after(person[:50]), before(maps(person[:50])), atol=1e-9)


def test_the_map_between_two_people_is_found(person):
    """Every fingertip of a stretched and moved hand lands where it was in training."""
    person = person + np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.2, 0.0]])  # too far apart to pinch
    maps = fit_affine(space_of(person), other(person), NAMES)
    error = np.linalg.norm(maps(other(person)) - person, axis=-1)
    assert error.mean() < 0.003, error.mean(axis=0)
    assert (maps.miss < 0.003).all()


def test_pinches_tie_the_fingers(person, rng, monkeypatch):
    """Where two tips of the new person meet, the maps keep them nearer to each other than without ties."""
    rows = rng.permutation(len(person))[:600]

    def pinching(p_HF):
        p_HF = p_HF.copy()
        p_HF[rows, 0] = p_HF[rows, 1] = 0.5 * (p_HF[rows, 0] + p_HF[rows, 1])
        return p_HF

    def apart():
        maps = fit_affine(space_of(pinching(person)), pinching(other(person)), NAMES)
        mapped = maps(pinching(other(person))[rows])
        return np.median(np.linalg.norm(mapped[:, 0] - mapped[:, 1], axis=1))

    tied = apart()
    monkeypatch.setattr("geort_drake.retargeting.affine_refit.PINCH_WEIGHT", 0.0)
    assert tied < 0.6 * apart()


def test_fine_tuning_starts_from_the_weights(hand, person):
    """A first step hardly changes them, sixty lower the loss; those of another hand are refused."""
    network = CoupledNetwork(
        hand, torch.zeros(3, 3), torch.full((3, 3), 0.03), 8, 6, torch.Generator().manual_seed(0)
    )
    data, start = toy_data(hand, other(person)), network.arrays()
    still = fine_tune(start, data, {}, steps=1)
    p = torch.tensor(person[:20], dtype=torch.float32)
    with torch.no_grad():
        torch.testing.assert_close(still.network(p), network(p), atol=1e-3, rtol=0)
    history = fine_tune(start, data, {}, steps=60).history
    assert np.mean([row["total"] for row in history[-10:]]) < np.mean([row["total"] for row in history[:5]])
    with pytest.raises(TrainingError, match=r"columns must be of shape \(6,\), it is \(9,\)"):
        fine_tune(start, toy_data(toy_kinematics(NAMES[:2])), {}, steps=1)


def test_fine_tuning_keeps_the_targets_of_the_checkpoint():
    """Under their former names as well; settings of other versions are ignored."""
    kept = {"cross_talk_wanted": 0.033, "even_share": 1.0, "pinch_weight": 4.0, "assign_every": 10, "seed": 3}
    expected = {"cross_talk_target": 0.033, "even_fraction": 1.0, "pinch_weight": 4.0}
    assert fine_tuning_config(kept, 10) == CoupledConfig(
        **expected, steps=10, learning_rate=0.01, averaging=0.98
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a quickly trained checkpoint of the Allegro hand."""
    folder = tmp_path_factory.mktemp("refit")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
        settings = {"hidden": 8, "residual_hidden": 6, "steps": 10}
        train_checkpoint(
            "allegro_right", synthesize_play(0, 60.0, 30.0), folder / "old", show_progress=False,
            settings=settings, robot_samples=2000,
        )  # fmt: skip
        yield folder


def test_the_command_writes_an_ordinary_checkpoint(trained):
    """It loads, knows the new person's fingertips, and says where it came from."""
    hand = synthesize_play(5, 40.0, 30.0)
    hand = dataclasses.replace(hand, p_HK=1.1 * hand.p_HK)
    hand.save(trained / "hand.npz")
    arguments = [str(trained / "old"), str(trained / "hand.npz"), str(trained / "new"), "--steps", "10"]
    run_command("refit", arguments)
    old, new = load_checkpoint(trained / "old"), load_checkpoint(trained / "new")
    retarget = load_retargeter(trained / "new")
    q = retarget(hand.p_HK[:30])
    assert np.isfinite(q).all()
    assert not np.allclose(q, load_retargeter(trained / "old")(hand.p_HK[:30]))
    assert retarget.trained_space.distances(hand.p_HK[100]).max() < 0.012
    assert new.provenance["refit"]["from_recording"] == old.provenance["recording"]
    assert new.provenance["recording"]["sha256"] == hand.digest
    assert json.loads((trained / "new" / "metrics.json").read_text())["recording_sha256"] == hand.digest


def test_unusable_checkpoints_and_recordings_are_refused(trained):
    """A checkpoint without the places of its training, and a recording of the other hand."""
    old = load_checkpoint(trained / "old")
    arrays = {name: array for name, array in old.arrays.items() if name != "trained_points"}
    save_checkpoint(
        trained / "blind", arrays, method="geort_coupled", hand=old.hand,
        human_keypoints=old.config["human_keypoints"], training={}, provenance={}, history=[],
    )  # fmt: skip
    with pytest.raises(CheckpointError, match="lacks the fingertips of its training"):
        refit_checkpoint(trained / "blind", synthesize_play(5, 12.0, 30.0), trained / "x")
    with pytest.raises(RecordingError, match="of a left hand, the robot's is a right hand"):
        refit_checkpoint(trained / "old", synthesize_play(5, 12.0, 30.0, side="left"), trained / "x")

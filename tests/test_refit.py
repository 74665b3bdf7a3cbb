"""The map for everyone, fitted to one person."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from grasp_setup import allegro
from retargeting_toy import toy_data, toy_human, toy_kinematics
from universal_map import FINGERS, map_of, random_network

from geort_drake.cli import run_command
from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.errors import CheckpointError, RecordingError, TrainingError
from geort_drake.hands.mirror import canonical_kinematics
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.methods.coupled import CoupledConfig, train_coupled
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.retargeter import load_retargeter


def test_a_training_starts_from_given_weights():
    """A first step hardly changes them, sixty lower the loss; those of another hand are refused."""
    hand = toy_kinematics()
    network = CoupledNetwork(
        hand, torch.zeros(3, 3), torch.full((3, 3), 0.03), 8, 6, torch.Generator().manual_seed(0)
    )
    data, start = toy_data(hand), network.arrays()

    def config(steps):
        return CoupledConfig(steps=steps, hidden=8, residual_hidden=6, learning_rate=0.01)

    still = train_coupled(data, config(1), start=start)
    p = torch.tensor(toy_human(hand)[:20], dtype=torch.float32)
    with torch.no_grad():
        torch.testing.assert_close(still.network(p), network(p), atol=1e-3, rtol=0)
    history = train_coupled(data, config(60), start=start).history
    assert np.mean([row["total"] for row in history[-10:]]) < np.mean([row["total"] for row in history[:5]])
    with pytest.raises(TrainingError, match=r"columns must be of shape \(6,\), it is \(9,\)"):
        train_coupled(toy_data(toy_kinematics(("thumb", "index"))), config(1), start=start)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a random map for everyone of the Allegro hand."""
    folder, hand = tmp_path_factory.mktemp("refit"), allegro()
    file = dataclasses.replace(
        map_of(random_network(FINGERS, canonical_kinematics(hand))),
        hands={"allegro_right": hand.digest},
        joint_names=hand.joint_names,
        lower=hand.lower.tolist(),
        upper=hand.upper.tolist(),
    )
    file.save(folder / "map.safetensors")
    return folder


def test_the_command_writes_an_ordinary_checkpoint(folder, monkeypatch):
    """It loads, starts from the map for everyone, knows the person's fingertips, and names its origin."""
    monkeypatch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
    hand = synthesize_play(5, 40.0, 30.0)
    hand.save(folder / "hand.npz")
    arguments = ["hand.npz", "own", "--map", "map.safetensors", "--steps", "1"]
    monkeypatch.chdir(folder)
    run_command("refit", arguments)
    retarget, checkpoint = load_retargeter("own"), load_checkpoint("own")
    folded = load_retargeter("map.safetensors").for_person(hand.p_HK)
    np.testing.assert_allclose(retarget(hand.p_HK[:30]), folded(hand.p_HK[:30]), atol=1e-2)
    assert retarget.trained_space.distances(hand.p_HK[100]).max() < 0.012
    assert checkpoint.provenance["map"]["name"] == "map.safetensors"
    assert checkpoint.provenance["recording"]["sha256"] == hand.digest
    assert json.loads((folder / "own" / "metrics.json").read_text())["recording_sha256"] == hand.digest
    with pytest.raises(CheckpointError, match="a map for everyone is needed"):
        refit_checkpoint(hand, "other", map_file="own")


def test_hands_without_a_map_and_other_hands_are_refused(folder, monkeypatch):
    """A robot hand that no map is shipped for, one that the map is not for, and the person's other hand."""
    monkeypatch.setattr("geort_drake.comparison.refit.shipped_maps", lambda: {})
    play = synthesize_play(5, 12.0, 30.0)
    with pytest.raises(CheckpointError, match=r"shipped for allegro_right.*geort-drake pretrain"):
        refit_checkpoint(play, folder / "x")
    with pytest.raises(CheckpointError, match="the map is for another hand"):
        refit_checkpoint(play, folder / "x", "leap_right", folder / "map.safetensors")
    left = synthesize_play(5, 12.0, 30.0, side="left")
    with pytest.raises(RecordingError, match="of a left hand, the robot's is a right hand"):
        refit_checkpoint(left, folder / "x", map_file=folder / "map.safetensors")

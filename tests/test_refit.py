"""The map for everyone, fitted to one person."""

import dataclasses
import json

import numpy as np
import pytest
from grasp_setup import allegro
from universal_map import FINGERS, map_of, random_network

from geort_drake.cli import run_command
from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.errors import CheckpointError, RecordingError
from geort_drake.hands.mirror import canonical_kinematics
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter


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
    assert np.abs(retarget(hand.p_HK[:30]) - folded(hand.p_HK[:30])).max() < 0.2  # after one step
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

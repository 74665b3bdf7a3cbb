"""What is still missing of the figures that a map should have."""

import dataclasses

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics

from geort_drake.comparison.metrics import pinch
from geort_drake.retargeting.methods.coupled import violations as coupled_wanted
from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.training import CoupledConfig
from geort_drake.retargeting.methods.coupled.violations import Shortfalls
from geort_drake.retargeting.training.map_figures import (
    coverage,
    cross_talk,
    motion_preservation,
    motion_preservation_track,
    robot_voxels,
)


@pytest.fixture
def hand():
    return toy_kinematics()


@pytest.fixture
def network(hand):
    generator = torch.Generator().manual_seed(3)
    mean, scale = torch.zeros(len(hand.fingers), 3), torch.full((len(hand.fingers), 3), 0.03)
    network = CoupledNetwork(hand, mean, scale, 16, 16, generator)
    with torch.no_grad():
        network.residual.weights[-1].uniform_(-0.3, 0.3, generator=generator)
    return network


def shortfalls(hand, frames, config) -> Shortfalls:
    hands = TrainingHands(frames, hand.finger_names, config, torch.Generator().manual_seed(0))
    return Shortfalls(hands, hand, config, seed=0)


def figures(hand, network, frames) -> tuple[dict[str, float], float, float]:
    """Coverage, cross-talk and the closed pinches as an evaluation has them, but for the numbers drawn."""

    def g(p_HF):
        with torch.no_grad():
            return hand.fingertips(network(torch.tensor(p_HF, dtype=torch.float32))).numpy()

    q = np.random.default_rng(7).uniform(hand.lower, hand.upper, (200_000, len(hand.joint_names)))
    voxels = robot_voxels(hand.fingertips(torch.tensor(q, dtype=torch.float32)).numpy())
    reached = coverage(voxels, list(np.moveaxis(g(frames), 1, 0)))
    talk = cross_talk(g, frames, np.random.default_rng(8), 4000)
    return reached, talk, pinch(frames, g(frames), hand.finger_names, hand.tip_radius)["closed"]


def test_a_map_that_is_as_wanted_lacks_nothing(hand, network):
    """The evaluation's figures, given as wanted, come out as no error; a worse one is its share of it."""
    frames, hand = toy_human(hand), dataclasses.replace(hand, tip_radius=0.02)  # some pinches close
    reached, talk, closed = figures(hand, network, frames)
    assert 0 < closed < 1
    config = CoupledConfig(
        motion_wanted=-9.0,
        coverage_wanted=reached["10mm"],
        far_coverage_wanted=reached["15mm"],
        cross_talk_wanted=talk,
        closed_wanted=closed,
    )
    errors = shortfalls(hand, frames, config)(network)
    assert errors == pytest.approx({"coverage": 0.0, "cross_talk": 0.0, "pinch": 0.0}, abs=0.03)
    config = dataclasses.replace(
        config,
        far_coverage_wanted=1 - (1 - reached["15mm"]) / 1.5,
        cross_talk_wanted=2 * talk,
        closed_wanted=1 - (1 - closed) / 4,
    )
    errors = shortfalls(hand, frames, config)(network)
    assert errors == pytest.approx({"coverage": 0.5, "cross_talk": -0.5, "pinch": 3.0}, abs=0.05)


def test_motion_comes_before_coverage(hand, network):
    """However little is covered, it is too much where motion preservation is too low, in either sense."""
    frames = toy_human(hand)

    def g(p_HF):
        with torch.no_grad():
            return hand.fingertips(network(torch.tensor(p_HF, dtype=torch.float32))).numpy()

    motion = motion_preservation(g, frames, np.random.default_rng(0))
    least = min(motion, motion_preservation_track(frames, g(frames)))
    config = CoupledConfig(motion_wanted=1 - (1 - least) / 1.2, coverage_wanted=0.99)
    assert shortfalls(hand, frames, config)(network)["coverage"] == pytest.approx(-0.2, abs=0.02)


def test_a_map_is_asked_the_same_each_time(hand, network):
    """Otherwise weights would follow the draws."""
    asked = shortfalls(hand, toy_human(hand), CoupledConfig())
    assert asked(network) == asked(network)


def test_who_pinches_nothing_lacks_no_pinches(hand, network):
    """There is no share of nothing."""
    frames = toy_human(hand) + 0.1 * np.arange(len(hand.fingers))[:, None]
    config = CoupledConfig(pinch_weight=0.0)
    assert np.isnan(shortfalls(hand, frames, config)(network)["pinch"])


def test_a_long_recording_is_thinned(hand, monkeypatch):
    """Evenly, so that all of it counts."""
    monkeypatch.setattr(coupled_wanted, "FRAMES", 50)
    frames = toy_human(hand)
    kept = shortfalls(hand, frames, CoupledConfig())._frames
    assert 25 <= len(kept) <= 50 < len(frames)
    np.testing.assert_allclose(kept, frames[:: len(frames) // 50 + 1], rtol=1e-6)

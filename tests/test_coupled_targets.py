"""Lagrange multipliers of `geort_coupled`, and the violations that drive them."""

import dataclasses
from functools import partial

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics
from torch import nn

from geort_drake.comparison.metrics import pinch
from geort_drake.retargeting.methods.coupled import CoupledConfig, violations
from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.methods.coupled.multipliers import (
    EVERY,
    START,
    LagrangeMultipliers,
)
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.violations import ConstraintViolations
from geort_drake.retargeting.training import map_figures
from geort_drake.retargeting.training.background import BackgroundProcess


class Map(nn.Module):
    """A map of one number."""

    def __init__(self):
        super().__init__()
        self.value = nn.Parameter(torch.ones(()))


def multipliers_after(measurements, limits, measure) -> dict[str, float]:
    """The factors at the end of a training in which the map becomes the factor of coverage."""
    network = Map()
    start = partial(BackgroundProcess({"violations": measure}, separate=False).start, "violations")
    multipliers = LagrangeMultipliers(limits, start)
    # The measurement that would end after the training is not started.
    steps = round((measurements + 1) * EVERY / (1 - START))
    for step in range(steps):
        multipliers.update(network, step, steps)
        network.value.data.fill_(multipliers.factors["coverage"])
    return multipliers.factors


@pytest.mark.parametrize("right", [0.9, 1.1])
def test_a_figure_that_its_weight_can_move_reaches_its_target(right):
    """From above and from below."""
    factors = multipliers_after(
        60, {"coverage": (0.5, 1.3)}, lambda m: {"coverage": right / float(m.value.detach()) - 1}
    )
    assert factors == pytest.approx({"coverage": right}, rel=1e-3)


@pytest.fixture
def hand():
    return dataclasses.replace(toy_kinematics(), tip_radius=0.02)  # some pinches close


@pytest.fixture
def network(hand):
    generator = torch.Generator().manual_seed(3)
    network = CoupledNetwork(hand, torch.zeros(3, 3), torch.full((3, 3), 0.03), 16, 16, generator)
    with torch.no_grad():
        network.residual.weights[-1].uniform_(-0.3, 0.3, generator=generator)
    return network


def violations_of(hand, network, frames, **settings) -> dict[str, float]:
    config = CoupledConfig(**settings)
    hands = TrainingHands(frames, hand.finger_names, config, torch.Generator().manual_seed(0))
    return ConstraintViolations(hands, hand, config, seed=0)(network)


def test_violations_are_relative_to_the_figures_of_an_evaluation(hand, network, monkeypatch):
    """None where the targets are the map's own figures; motion has priority over coverage."""
    frames = toy_human(hand)

    def g(p_HF):
        with torch.no_grad():
            return hand.fingertips(network(torch.tensor(p_HF, dtype=torch.float32))).numpy()

    q = np.random.default_rng(7).uniform(hand.lower, hand.upper, (200_000, len(hand.joint_names)))
    voxels = map_figures.robot_voxels(hand.fingertips(torch.tensor(q, dtype=torch.float32)).numpy())
    reached = map_figures.coverage(voxels, list(np.moveaxis(g(frames), 1, 0)))
    cross_talk = map_figures.cross_talk(g, frames, np.random.default_rng(8), 4000)
    closed = pinch(frames, g(frames), hand.finger_names, hand.tip_radius)["closed"]
    motion = min(
        map_figures.motion_preservation(g, frames, np.random.default_rng(0)),
        map_figures.motion_preservation_track(frames, g(frames)),
    )
    monkeypatch.setattr(violations, "COVERAGE_TARGET", reached["10mm"])
    monkeypatch.setattr(violations, "FAR_COVERAGE_TARGET", reached["15mm"])
    targets = {"motion_target": -9.0, "cross_talk_target": cross_talk, "closed_target": closed}
    found = violations_of(hand, network, frames, **targets)
    assert found == pytest.approx({"coverage": 0.0, "cross_talk": 0.0, "pinch": 0.0}, abs=0.03)
    worse = {"cross_talk_target": 2 * cross_talk, "closed_target": 1 - (1 - closed) / 4}
    found = violations_of(hand, network, frames, **targets | worse)
    assert found == pytest.approx({"coverage": 0.0, "cross_talk": -0.5, "pinch": 3.0}, abs=0.05)
    monkeypatch.setattr(violations, "COVERAGE_TARGET", 0.99)
    found = violations_of(hand, network, frames, motion_target=1 - (1 - motion) / 1.2)
    assert found["coverage"] == pytest.approx(-0.2, abs=0.02)

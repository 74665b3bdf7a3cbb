"""The hands and batches that `geort_coupled` is trained with."""

import dataclasses
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from retargeting_toy import toy_human, toy_kinematics, toy_samples

from geort_drake.retargeting.clouds import first_in_voxels, voxel_centres, voxel_index
from geort_drake.retargeting.methods.coupled import CoupledConfig
from geort_drake.retargeting.methods.coupled.batches import Batches, BatchMaker
from geort_drake.retargeting.methods.coupled.coverage import CoverageTargets
from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.training.background import BackgroundProcess
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes

NAMES = ("thumb", "index", "middle")
CONFIG = CoupledConfig(mixed_pinch_fraction=0.0, jitter=1e-9)


@pytest.fixture(scope="module")
def hand():
    return toy_kinematics()


@pytest.fixture(scope="module")
def human(hand):
    return toy_human(hand)


def hands_of(human, config=CONFIG, seed=0) -> TrainingHands:
    return TrainingHands(human, NAMES, config, torch.Generator().manual_seed(seed))


def recorded(tips: torch.Tensor, frames: np.ndarray) -> np.ndarray:
    """For each point (N, D) whether it is one of the frames (T, D)."""
    distance = np.linalg.norm(tips.numpy()[:, None] - frames.astype(np.float32)[None], axis=-1)
    return distance.min(axis=1) < 1e-7


def test_postures_are_equally_likely_however_long_they_were_held(human):
    """Of a hand that rests for nine tenths of a recording, draws have little."""
    rest = human[0] + 1e-5 * np.arange(1350)[:, None, None]
    rest[:, :2] = human[0, :1] + 1e-5 * np.arange(1350)[:, None, None]  # a pinch
    held = np.concatenate([human[:150], rest])
    drawn = {}
    for fraction in (0.0, 1.0):
        config = dataclasses.replace(CONFIG, even_fraction=fraction)
        some = hands_of(held, config).recorded(2000)
        drawn[fraction] = recorded(some.flatten(1), rest.reshape(len(rest), -1)).mean()
    assert drawn[0.0] > 0.85 and drawn[1.0] < 0.2


def test_batches_are_moved_to_the_device_of_the_network(hand, human):
    """They are prepared on the CPU; the gaps between shapes move as well."""
    generator = torch.Generator().manual_seed(0)
    people = TrainingHands(human, NAMES, CONFIG, generator)
    with torch.no_grad():
        p_BF = hand.fingertips(torch.tensor(toy_samples(hand)).float()).numpy()
    space = CoverageTargets(people.frames, hand, [voxel_centres(p_BF[:, i], 0.005) for i in range(3)], 0)
    X = np.tile(np.eye(4), (2, 1, 1))
    X[:, 2, 3] = 0.04
    fingertips = CollisionShapes(np.array([5, 8]), X, np.zeros((2, 3)), np.full(2, 0.05), np.array([[0, 1]]))
    gaps = CollisionGaps(hand, fingertips)
    network = CoupledNetwork(hand, people.mean, people.scale, 16, 16, generator)
    makers = {"batches": BatchMaker(people, space, gaps, CONFIG)}
    start = partial(BackgroundProcess(makers, separate=False).start, "batches")
    batch = Batches(start, torch.device("meta")).next(network, 0.5)
    tensors = [*vars(batch).values(), *vars(batch.near_collisions).values(), *vars(gaps.to("meta")).values()]
    assert {value.device.type for value in tensors if isinstance(value, torch.Tensor)} == {"meta"}


@given(st.integers(1, 200), st.integers(0, 2**32 - 1))
def test_one_point_of_each_voxel_remains(count, seed):
    """The first in order; centres are those of the voxels that hold points."""
    points = np.random.default_rng(seed).normal(0.0, 0.01, (count, 3))
    cells, first = np.unique(voxel_index(points, 0.005), axis=0, return_index=True)
    np.testing.assert_array_equal(first_in_voxels(points, 0.005), np.sort(first))
    np.testing.assert_allclose(voxel_centres(points, 0.005), (cells + 0.5) * 0.005)

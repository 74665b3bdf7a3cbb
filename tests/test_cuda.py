"""Trainings on a GPU; skipped where torch finds no CUDA device."""

import dataclasses

import numpy as np
import pytest
import torch
from retargeting_toy import toy_data, toy_kinematics

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.methods import trained_methods
from geort_drake.retargeting.methods.coupled import CoupledConfig
from geort_drake.retargeting.methods.coupled.training import train_universal

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA device")


@pytest.mark.parametrize("name", trained_methods())
def test_a_training_on_the_gpu_begins_as_on_the_cpu(name):
    """The same draws give the same first losses; later ones differ by rounding. Weights return to the CPU."""
    method = trained_methods()[name]
    config = dataclasses.replace(method.config(), steps=30)
    cpu, gpu = (method.train(toy_data(toy_kinematics()), config, 0, device) for device in ("cpu", "cuda"))
    first, other = cpu.history[0], gpu.history[0]
    for loss in first.keys() - {"seconds"}:
        assert other[loss] == pytest.approx(first[loss], rel=0.01, abs=1e-4), loss
    assert gpu.stopped_at is None and gpu.history[-1]["total"] == pytest.approx(
        cpu.history[-1]["total"], rel=0.3
    )
    assert all(np.isfinite(array).all() for array in gpu.network.arrays().values())


def test_a_universal_map_trains_on_the_gpu():
    """Its first losses are those on the CPU."""
    hand = HandModel("allegro_right")
    shapes, config = collision_shapes(hand), CoupledConfig(steps=60)
    rows: dict[str, list] = {"cpu": [], "cuda": []}
    for device, seen in rows.items():
        report = lambda step, steps, row, network, seen=seen: seen.append(row)  # noqa: E731
        result = train_universal(hand.kinematics(), shapes, config, 8, 0, device, report)
        assert all(np.isfinite(array).all() for array in result.arrays.values())
    for loss in rows["cpu"][0].keys() - {"seconds"}:
        assert rows["cuda"][0][loss] == pytest.approx(rows["cpu"][0][loss], rel=0.01, abs=1e-4), loss
    assert rows["cuda"][-1]["total"] == pytest.approx(rows["cpu"][-1]["total"], rel=0.3)

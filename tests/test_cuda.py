"""Trainings on a GPU; skipped where torch finds no CUDA device."""

import dataclasses

import pytest
import torch
from retargeting_toy import HAND, HUMAN, ToyHand

from geort_drake.retargeting import METHODS

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA device")


@pytest.mark.parametrize("name", ["geort", "telekinesis"])
def test_a_training_on_the_gpu_begins_as_on_the_cpu(name):
    """The same draws give the same first losses; later ones differ by rounding. Weights return to the CPU."""
    config = dataclasses.replace(METHODS[name].config(), steps=30)
    histories = {
        device: METHODS[name].fit(ToyHand(HAND), HUMAN, config=config, device=device).info["history"]
        for device in ("cpu", "cuda")
    }
    for loss in histories["cpu"][0].keys() - {"step"}:
        first = histories["cpu"][0][loss]
        assert histories["cuda"][0][loss] == pytest.approx(first, rel=0.01, abs=1e-4), loss
    assert histories["cuda"][-1]["total"] == pytest.approx(histories["cpu"][-1]["total"], rel=0.3)

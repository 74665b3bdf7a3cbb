"""Algorithm 1 on a small hand whose right answer is known."""

import dataclasses

import numpy as np
import pytest
import torch
from retargeting_toy import HAND, HUMAN, PLANTED, answers, toy_collides, toy_data

from geort_drake.errors import TrainingError, UnknownNameError
from geort_drake.retargeting.methods.geort import PRESETS, GeortConfig, train_geort, training
from geort_drake.retargeting.training.soap import Soap

QUICK = GeortConfig(
    steps=200, points=64, targets=96, pinches=32, frames=32, hidden=32,
    classifier_steps=150, kinematics_steps=50, refreshes=1,
)  # fmt: skip


@pytest.fixture(autouse=True)
def short_refreshes(monkeypatch):
    """Few steps of the classifier are enough for the toy hand."""
    monkeypatch.setattr(training, "REFRESH_STEPS", 30)
    monkeypatch.setattr(training, "REFRESH_SAMPLES", 300)


def quick(human=HUMAN, seed=0, device="cpu", data=None, report=None, **settings):
    data = toy_data(HAND, human, **data or {})
    return train_geort(data, dataclasses.replace(QUICK, **settings), seed, device, report)


def final(result, name):
    """A loss at the end, averaged over the last tenth of the history."""
    return np.mean([row[name] for row in result.history[-len(result.history) // 10 :]])


def test_training_finds_the_planted_map():
    """A person who is a scaled robot can be followed: directions agree and the C-space is covered."""
    result = quick(steps=250, pinch_weight=0.0, collision_weight=0.0)
    first = result.history[0]
    assert final(result, "direction") < -0.9
    assert final(result, "coverage") < 0.2 * first["coverage"]
    error = np.linalg.norm(answers(result.network) - PLANTED, axis=-1)
    # An independent judge: the planted map is close to the one that was found, and was not shown.
    assert np.median(error) < 0.015


def test_the_weight_of_a_criterion_lowers_its_loss():
    """Each of the criteria II to V acts: with its weight its own loss ends lower than without."""
    base = {"coverage_weight": 4.0, "flatness_weight": 0.0, "pinch_weight": 0.0, "collision_weight": 0.0}
    # Coverage pulls at what flatness, pinch and collision hold back, so it is what they are compared to.
    covering = quick(**base)
    for criterion, weight in (("flatness", 100.0), ("pinch", 20.0), ("collision", 2.0)):
        having = quick(**{**base, f"{criterion}_weight": weight})
        assert final(having, criterion) < 0.7 * final(covering, criterion), criterion
    free = quick(**{**base, "coverage_weight": 0.0})
    assert final(covering, "coverage") < 0.7 * final(free, "coverage")


def test_a_map_that_is_driven_into_its_limits_is_noticed():
    """Its loss is finite and worse than at the start."""
    with pytest.warns(RuntimeWarning, match=r"loss did not fall: \S+ at the start, \S+ at the end"):
        quick(learning_rate=100.0)


def test_labels_of_own_outputs_reduce_collisions():
    """A classifier that was taught that nothing collides learns better from the oracle."""

    def colliding(collides):
        data = {"labels": lambda: np.zeros(4000, dtype=bool), "collides": collides}
        result = quick(data=data, collision_weight=3.0, refreshes=2)
        with torch.no_grad():
            return toy_collides(result.network(torch.tensor(HUMAN).float()).numpy()).mean()

    assert colliding(toy_collides) < 0.5 * colliding(None)


def test_the_choices_of_the_public_code_train():
    """With neural kinematics, which report their error; progress is reported up to the last step."""
    seen = []
    settings = {**PRESETS["public"], "steps": 3, "kinematics_steps": 50, "points": 64, "targets": 64}
    result = quick(report=lambda *given: seen.append(given), **settings)
    errors = result.neural_kinematics
    assert 0 < errors["mean_mm"] < errors["p95_mm"] < errors["max_mm"]
    assert [step for step, *_ in seen] == [1, 2, 3] and seen[-1][1] == 3
    assert {"direction", "coverage", "flatness", "pinch", "collision", "total"} <= set(seen[-1][2])


def test_unusable_input_is_refused_with_what_is_expected():
    """Shape, NaN, a finger that does not move, no pinch, and bad devices."""
    broken, still = HUMAN.copy(), HUMAN.copy()
    broken[5, 1, 2] = np.nan
    still[:, 1] = still[0, 1]
    apart = HUMAN + np.array([[0.0, 1.0, 0.0], [0, 2.0, 0], [0, 3.0, 0]])
    for given, message in (
        (HUMAN[:, :2], r"shape \(T, 3, 3\) for thumb, index, middle"),
        (broken, "must be finite"),
        (still, "index tip visits only 1 places"),
        (apart, "contains no pinch"),
    ):
        with pytest.raises(TrainingError, match=message):
            quick(given)
    with pytest.raises(TrainingError, match="points must be a number, it is 'many'"):
        quick(points="many")
    quick(apart, pinch_weight=0.0, steps=2)
    with pytest.raises(UnknownNameError, match="cpu, cuda"):
        quick(device="tpu")
    if not torch.cuda.is_available():
        with pytest.raises(TrainingError, match="no CUDA device"):
            quick(device="cuda")


def test_gradients_are_clipped_together():
    """A gradient a thousand times too long moves as one of the greatest length does, in all groups."""

    def ends(factor):
        parameters = [torch.nn.Parameter(torch.ones(2, 3, 4)), torch.nn.Parameter(torch.ones(1, 4))]
        soap = Soap([{"params": [p], "weight_decay": 0.0} for p in parameters], lr=0.1, eps=1.0, clip=0.5)
        generator = torch.Generator().manual_seed(0)
        for _ in range(3):
            gradients = [torch.randn(p.shape, generator=generator) for p in parameters]
            length = torch.cat([g.flatten() for g in gradients]).norm()
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = factor * 0.5 / length * gradient
            soap.step()
        return [p.detach() for p in parameters]

    for clipped, longest, shorter in zip(ends(1000.0), ends(1.0), ends(0.5), strict=True):
        torch.testing.assert_close(clipped, longest, atol=1e-5, rtol=0)
        assert (shorter - longest).abs().max() > 1e-3

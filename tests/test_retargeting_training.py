"""Algorithm 1 on a small hand whose right answer is known."""

import dataclasses
import math
import warnings

import numpy as np
import pytest
import torch
from retargeting_toy import toy_collides, toy_human, toy_kinematics, toy_samples

from geort_drake.errors import GeortError, TrainingError, UnknownNameError
from geort_drake.retargeting.methods.geort import PUBLIC_CHOICES, TrainingConfig, criteria, train_geort
from geort_drake.retargeting.training.descent import descend
from geort_drake.retargeting.training.pretraining import fit_classifier, fit_neural_kinematics

QUICK = TrainingConfig(
    steps=200, points=64, targets=96, pinches=32, frames=32, hidden=32,
    classifier_steps=150, kinematics_steps=300, refreshes=2, refresh_steps=30,
)  # fmt: skip


@pytest.fixture(scope="module")
def hand():
    return toy_kinematics()


@pytest.fixture(scope="module")
def samples(hand):
    return toy_samples(hand)


@pytest.fixture(scope="module")
def human(hand):
    return toy_human(hand)


def quick(hand, samples, human, seed=0, oracle=toy_collides, **settings):
    config = dataclasses.replace(QUICK, **settings)
    return train_geort(human, hand, samples, config, seed, collides_beyond_tips=oracle)


def final(result, name):
    """A loss at the end, averaged over the last tenth of the history."""
    return np.mean([row[name] for row in result.history[-len(result.history) // 10 :]])


def test_training_finds_the_planted_map(hand, samples, human):
    """A person who is a scaled robot can be followed: directions agree and the C-space is covered."""
    result = quick(hand, samples, human, steps=350, pinch_weight=0.0, collision_weight=0.0)
    first = result.history[0]
    assert final(result, "direction") < -0.9
    assert final(result, "coverage") < 0.2 * first["coverage"]
    with torch.no_grad():
        tips = hand.fingertips(result.network(torch.tensor(human).float())).numpy()
    planted = (human - [0.0, 0.0, 0.05]) / 0.8
    error = np.linalg.norm(tips - planted, axis=-1)
    # An independent judge: the planted map is close to the one that was found, and was not shown.
    assert np.median(error) < 0.015


@pytest.mark.parametrize(
    ("criterion", "weight"), [("coverage", 50.0), ("flatness", 100.0), ("pinch", 20.0), ("collision", 2.0)]
)
def test_the_weight_of_a_criterion_lowers_its_loss(hand, samples, human, criterion, weight):
    """Each of the criteria II to V acts: with its weight its own loss ends lower than without."""
    base = {"coverage_weight": 4.0, "flatness_weight": 0.0, "pinch_weight": 0.0, "collision_weight": 0.0}
    # Coverage pulls at what flatness, pinch and collision hold back, so it is what they are compared to.
    without = quick(hand, samples, human, **{**base, f"{criterion}_weight": 0.0})
    having = quick(hand, samples, human, **{**base, f"{criterion}_weight": weight})
    assert final(having, criterion) < 0.7 * final(without, criterion)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(hand, samples, human):
    """Every draw comes from the seed, whatever the global generators were left at."""
    runs = []
    for seed, elsewhere in ((3, 0), (3, 1), (4, 0)):
        torch.manual_seed(elsewhere)
        runs.append(quick(hand, samples, human, seed=seed, steps=40).network.arrays())
    for name in runs[0]:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
    assert np.abs(runs[0]["weight1"] - runs[2]["weight1"]).max() > 1e-3


def test_training_leaves_torch_threads_as_they_were(hand, samples, human):
    """The single thread of training is given back."""
    before = torch.get_num_threads()
    quick(hand, samples, human, steps=2)
    assert torch.get_num_threads() == before


def test_outputs_respect_the_joint_limits(hand, samples, human):
    """Even far outside of what was recorded."""
    result = quick(hand, samples, human, steps=20)
    far = 10.0 * torch.randn(500, 3, 3, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        q = result.network(far).double().numpy()
    assert (q >= hand.lower - 1e-6).all()
    assert (q <= hand.upper + 1e-6).all()


def test_a_loss_that_stops_being_finite_keeps_the_last_good_weights(hand, samples, human):
    """An absurd learning rate ends in a warning and finite weights, or in an error at once."""
    with pytest.warns(RuntimeWarning, match="stopped being finite at step"):
        result = quick(hand, samples, human, learning_rate=1e30)
    assert result.stopped_at is not None
    assert all(np.isfinite(array).all() for array in result.network.arrays().values())


def test_a_last_step_into_nothing_is_noticed():
    """Weights that no loss has seen are checked too: √0 is finite, its gradient is not."""
    network = torch.nn.Linear(1, 1)
    before = network.weight.item()

    def losses(_step):
        return torch.sqrt(0.0 * network.weight).sum(), {}

    with pytest.warns(RuntimeWarning, match="at step 1 of 1"):
        assert descend(network, losses, 1, 1e-2).stopped_at == 1
    assert network.weight.item() == before


def test_a_map_that_is_driven_into_its_limits_is_noticed(hand, samples, human):
    """Its loss is finite and worse than at the start."""
    with pytest.warns(RuntimeWarning, match=r"loss did not fall: \S+ at the start, \S+ at the end"):
        quick(hand, samples, human, learning_rate=100.0)


def test_a_loss_that_is_never_finite_is_an_error(hand, samples, human):
    """There are no good weights to keep."""
    with pytest.raises(TrainingError, match="not finite at the first step"):
        quick(hand, samples, human, coverage_weight=1e300)


def test_the_best_weights_of_a_descent_are_not_older_than_a_hundredth_of_it():
    """A loss that breaks at step 150 of 200 leaves the weights of step 150, two steps being a hundredth."""
    network = torch.nn.Linear(1, 1)
    seen = []

    def losses(step):
        seen.append(network.weight.item())
        value = (network.weight * (math.nan if step == 151 else 1.0)).square().sum()
        return value, {"square": value}

    with pytest.warns(RuntimeWarning, match="at step 151 of 200"):
        descent = descend(network, losses, 200, 1e-2)
    assert descent.stopped_at == 151 and len(seen) == 152
    assert network.weight.item() == seen[150]
    assert descent.history[-1]["step"] == 150


def test_a_finger_that_never_pinches_is_named(hand, samples, human):
    """The others keep pinching, so training goes on; without the criterion nobody is asked to pinch."""
    apart = human.copy()
    apart[:, 2, 1] += 0.2
    with pytest.warns(RuntimeWarning, match=r"no pinch of the thumb with: middle \(nearest \d+ mm\)"):
        quick(hand, samples, apart, steps=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quick(hand, samples, human, steps=2)
        quick(hand, samples, apart, steps=2, pinch_weight=0.0)


def test_independent_resampling_puts_hands_together_that_nobody_made(hand, samples, human, monkeypatch):
    """Every finger is where it was recorded, but not at the same time; by default hands are frames."""
    judged = []
    weights_of = criteria.pinch_weights

    def pinch_weights(p_HF, *arguments):
        judged.append(p_HF.numpy())
        return weights_of(p_HF, *arguments)

    monkeypatch.setattr(criteria, "pinch_weights", pinch_weights)
    quick(hand, samples, human, steps=3)
    assert [len(hands) for hands in judged] == [len(human)]
    quick(hand, samples, human, steps=3, resampling="independent")
    assert [len(hands) for hands in judged[2:]] == [QUICK.pinches] * 3
    same = judged[2][:, None] == human.astype(np.float32)[None]  # (hands, frames, fingers, coordinates)
    assert same.all(axis=3).any(axis=1).all()
    assert not same.all(axis=(2, 3)).any()


def test_the_public_choices_are_settings_that_train(hand, samples, human):
    """Each of them is a field, and together they make a valid configuration."""
    config = dataclasses.replace(TrainingConfig(**PUBLIC_CHOICES), steps=3, kinematics_steps=5, points=64)
    result = train_geort(human, hand, samples, dataclasses.replace(config, targets=64, classifier_steps=5))
    assert np.isfinite(result.history[-1]["total"])
    assert result.neural_kinematics["mean_mm"] > 0


def test_neural_kinematics_train_the_map_as_exact_ones_do(hand, samples, human):
    """The paper's neural kinematics are selectable and report their error on held-out samples."""
    result = quick(hand, samples, human, fk="neural", steps=60)
    errors = result.neural_kinematics
    assert 0 < errors["mean_mm"] < errors["p95_mm"] < errors["max_mm"]
    assert quick(hand, samples, human, steps=2).neural_kinematics == {}


def test_neural_kinematics_learn_the_fingertips(hand, samples):
    """The reported error is that of fresh samples, within sampling noise, and small."""
    model, errors = fit_neural_kinematics(
        hand, samples, torch.Generator().manual_seed(0), torch.device("cpu"), steps=1000, batch=256, hidden=64
    )
    fresh = toy_samples(hand, 2000, seed=9)
    tips = model.fingertips(torch.tensor(fresh.q).float()).numpy()
    exact = hand.fingertips(torch.tensor(fresh.q)).numpy()
    mean_mm = 1000 * np.linalg.norm(tips - exact, axis=-1).mean()
    assert errors["mean_mm"] < 1.0
    assert mean_mm == pytest.approx(errors["mean_mm"], rel=0.15)


def test_the_classifier_learns_the_labels(hand, samples):
    """A half-space is found; the held-out accuracy is that of fresh samples."""
    model, figures = fit_classifier(
        hand, samples, torch.Generator().manual_seed(0), torch.device("cpu"), steps=400, batch=256, hidden=32
    )
    fresh = toy_samples(hand, 2000, seed=9)
    guessed = (model(torch.tensor(fresh.q).float()) > 0).numpy()
    assert figures["accuracy"] > 0.97
    assert (guessed == fresh.collides_beyond_tips).mean() == pytest.approx(figures["accuracy"], abs=0.02)


def test_labels_of_own_outputs_reduce_collisions(hand, human):
    """A classifier that was taught that nothing collides learns better from the oracle."""
    blind = toy_samples(hand)
    blind.collides_beyond_tips = np.zeros(len(blind.q), dtype=bool)

    def share(oracle):
        result = quick(hand, blind, human, oracle=oracle, collision_weight=3.0, refreshes=4)
        with torch.no_grad():
            return toy_collides(result.network(torch.tensor(human).float()).numpy()).mean()

    assert share(toy_collides) < 0.5 * share(None)


def test_unusable_input_is_refused_with_what_was_wanted(hand, samples, human):
    """Shape, NaN, a finger that does not move, no pinch, bad settings and devices."""
    with pytest.raises(TrainingError, match=r"shape \(T, 3, 3\) for thumb, index, middle"):
        quick(hand, samples, human[:, :2])
    broken = human.copy()
    broken[5, 1, 2] = np.nan
    with pytest.raises(TrainingError, match="must be finite"):
        quick(hand, samples, broken)
    still = human.copy()
    still[:, 1] = still[0, 1]
    with pytest.raises(TrainingError, match="index tip visits only 1 places"):
        quick(hand, samples, still)
    apart = human + np.array([[0.0, 1.0, 0.0], [0, 2.0, 0], [0, 3.0, 0]])
    with pytest.raises(TrainingError, match="holds no pinch"):
        quick(hand, samples, apart)
    quick(hand, samples, apart, pinch_weight=0.0, steps=2)
    with pytest.raises(TrainingError, match="learning_rate must be positive, it is -1"):
        quick(hand, samples, human, learning_rate=-1)
    with pytest.raises(UnknownNameError, match="exact, neural"):
        quick(hand, samples, human, fk="guess")
    with pytest.raises(UnknownNameError, match=r"unknown resampling 'often'.*frames, independent"):
        quick(hand, samples, human, resampling="often")
    with pytest.raises(UnknownNameError, match="cpu, cuda"):
        train_geort(human, hand, samples, QUICK, device="tpu")
    if not torch.cuda.is_available():
        with pytest.raises(TrainingError, match="sees no CUDA device"):
            train_geort(human, hand, samples, QUICK, device="cuda")
    few = toy_samples(hand, 10)
    with pytest.raises(TrainingError, match="at least 1000"):
        quick(hand, few, human)
    assert issubclass(TrainingError, GeortError)


def test_progress_is_reported(hand, samples, human):
    """The callback counts up to the last step and carries every loss."""
    seen = []
    train_geort(
        human, hand, samples, dataclasses.replace(QUICK, steps=50),
        report=lambda step, steps, row, _network: seen.append((step, steps, set(row))),
    )  # fmt: skip
    assert seen[-1][:2] == (50, 50)
    assert [step for step, _, _ in seen] == sorted({step for step, _, _ in seen})
    assert {"direction", "coverage", "flatness", "pinch", "collision", "total"} <= seen[0][2]

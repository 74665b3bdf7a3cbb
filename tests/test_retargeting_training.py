"""Algorithm 1 on a small hand whose right answer is known, and the torch networks."""

import dataclasses
from functools import cache

import numpy as np
import pytest
import torch
from faults.sound import play
from retargeting_toy import (
    HAND,
    HUMAN,
    PLANTED,
    ToyHand,
    answers,
    toy_collides,
    toy_kinematics,
    uneven_kinematics,
)

from geort_drake import Recording
from geort_drake.errors import MismatchError, RecordingError, TrainingError, UnknownNameError
from geort_drake.people.keypoints import mirrored
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.geort import GeortConfig, NeuralKinematics, RetargetingModel, pretrain
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.train import check_fingertips, training_config, training_recording

QUICK = GeortConfig(
    steps=300, points=96, gestures=96, hidden=32, robot_samples=3000, pretraining_steps=300,
    pretraining_batch=128, cover_weight=40.0,
)  # fmt: skip


def quick(human=HUMAN, seed=0, device="cpu", report=None, hand=HAND, **settings):
    config = dataclasses.replace(QUICK, **settings)
    return METHODS["geort"].fit(ToyHand(hand), human, seed=seed, config=config, device=device, report=report)


def final(retarget, name):
    """A loss at the end, averaged over the last tenth of the history."""
    history = retarget.info["history"]
    return np.mean([row[name] for row in history[-len(history) // 10 :]])


@cache
def weighted(seed, fk, **weights):
    """A map trained with these weights, and zero for the other criteria II to V."""
    none = dict.fromkeys(("cover_weight", "flat_weight", "pinch_weight", "collision_weight"), 0.0)
    return quick(seed=seed, fk=fk, **none | weights)


@pytest.mark.training
@pytest.mark.parametrize("fk", ["neural", "exact"])
def test_training_finds_the_planted_map(fk, training_seed, reaches):
    """A person who is a scaled robot can be followed: directions agree and the C-space is covered."""
    retarget = weighted(training_seed, fk, cover_weight=200.0)
    reaches("direction", 1.0 + final(retarget, "direction") / len(HAND.fingers), 0.3)
    reaches("cover", final(retarget, "cover") / retarget.info["history"][0]["cover"], 0.8)
    # The planted map is an independent judge, which the training does not see.
    error = np.linalg.norm(answers(retarget) - PLANTED, axis=-1)
    reaches("error, m", float(np.median(error)), 0.03)


@pytest.mark.slow
@pytest.mark.training
def test_the_weight_of_a_criterion_lowers_its_loss(training_seed, reaches):
    """Each of the criteria II to V acts: with its weight its own loss ends lower than without."""
    # Coverage pulls at what flatness, pinch and collision hold back, so it is what they are compared with.
    free, covering = weighted(training_seed, "exact"), weighted(training_seed, "exact", cover_weight=200.0)
    reaches("cover", final(covering, "cover") / final(free, "cover"), 1.0)
    for criterion, weight in (("flat", 2e4), ("pinch", 1e4), ("collision", 3.0)):
        held_back = weighted(training_seed, "exact", cover_weight=200.0, **{f"{criterion}_weight": weight})
        reaches(criterion, final(held_back, criterion) / final(covering, criterion), 1.0)


@pytest.mark.training
def test_training_avoids_what_the_classifier_learned(training_seed, reaches):
    """The share of colliding hands falls, although the classifier is fixed while the map trains."""

    def colliding(**weights):
        retarget = weighted(training_seed, "exact", cover_weight=200.0, **weights)
        return float(toy_collides(retarget(HUMAN)).mean())

    reaches("colliding", colliding(collision_weight=3.0) / colliding(), 0.8)


@pytest.mark.training
def test_neural_kinematics_learn_the_fingertips(training_seed, reaches):
    """Held-out postures are within millimetres, of fingers with unlike numbers of joints, too."""
    hand = uneven_kinematics()
    q, held_out = (torch.tensor(ToyHand(hand).sample(3000, seed)).float() for seed in (0, 1))
    p, generator = fingertips(hand, q), torch.Generator().manual_seed(training_seed)
    FK = NeuralKinematics(hand, p, 32, generator)
    config = dataclasses.replace(QUICK, pretraining_steps=300)
    pretrain(FK, lambda x, y: ((x - y) / FK.scale).square().mean(), q, p, config, generator)
    error = (FK(held_out) - fingertips(hand, held_out)).norm(dim=-1)
    reaches("error, m", float(error.mean()), 0.006)
    assert not any(parameter.requires_grad for parameter in FK.parameters())


@pytest.mark.parametrize("hand", [toy_kinematics(), uneven_kinematics()], ids=["even", "uneven"])
def test_numpy_equals_torch(hand, rng):
    """For any order and number of joints."""
    tips = rng.normal(0.03, 0.05, (300, 3, 3))
    model = RetargetingModel(
        hand, list(rng.normal(0.03, 0.03, (3, 60, 3))), 64, torch.Generator().manual_seed(0)
    )
    retarget = model.retargeter(ToyHand(hand), [])
    expected = model.double()(torch.tensor(tips)).numpy(force=True)
    np.testing.assert_allclose(retarget(tips), expected, atol=1e-6)
    np.testing.assert_allclose([retarget(tip) for tip in tips], retarget(tips), atol=1e-12)


def test_the_seed_alone_decides_the_weights():
    """To the last bit: global generators change nothing, other seeds do."""
    runs = []
    for seed, elsewhere in ((3, 0), (3, 1), (4, 0)):
        torch.manual_seed(elsewhere)
        np.random.seed(elsewhere)  # noqa: NPY002
        runs.append(quick(seed=seed, steps=5, pretraining_steps=5).arrays)
    for name in runs[0]:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
    assert np.abs(runs[0]["weight0"] - runs[2]["weight0"]).max() > 1e-3


def test_progress_is_reported_up_to_the_last_step():
    rows = []
    retarget = quick(report=lambda *row: rows.append(row), steps=3, pretraining_steps=2)
    assert [row[:2] for row in rows] == [(1, 3), (2, 3), (3, 3)]
    assert [row for *_, row in rows] == retarget.info["history"]
    assert rows[-1][2].keys() == {"step", "total", "direction", "cover", "flat", "pinch", "collision"}


def test_a_loss_that_is_not_finite_ends_the_training():
    with pytest.raises(TrainingError, match=r"not finite at step \d+ of 300; lower the learning rate"):
        quick(learning_rate=1e30, pretraining_steps=1, fk="exact")


def test_recordings_that_spoil_the_map_are_named_or_refused():
    """A finger that does not move and no pinch at all are refused; a finger that never pinches is named."""
    names = HAND.finger_names
    still, apart, one = HUMAN.copy(), HUMAN + np.array([[0.0, 1, 0], [0, 2, 0], [0, 3, 0]]), HUMAN.copy()
    still[:, 1] = still[0, 1]
    one[:, 2] += [0.0, 1.0, 0.0]
    for p_HF, message in ((still, "index tip visits only 1 places"), (apart, "contains no pinch")):
        with pytest.raises(TrainingError, match=message):
            check_fingertips(p_HF, names)
    (sentence,) = check_fingertips(one, names)
    assert "no pinch of the thumb with the middle" in sentence


def test_recordings_in_another_unit_or_of_the_other_side_are_refused_before_training():
    """Also those that were made from arrays, which no reader has checked."""
    p_HK, t = play().p_HK.astype(float), play().t
    for points, message in ((1e3 * p_HK, "if lengths were in mm"), (mirrored(p_HK), "of the other side")):
        with pytest.raises((RecordingError, MismatchError), match=f"the recording: .*{message}"):
            training_recording(Recording.from_keypoints(points, t), "right")
    assert training_recording(play(), "right") is play()
    with pytest.raises(RecordingError, match="no frame has finite keypoints"):
        training_recording(Recording.from_keypoints(np.nan * p_HK, t), "right")


def test_unusable_settings_are_refused():
    for name, value, message in (
        ("points", "many", "points must be a number, it is 'many'"),
        ("steps", 0, "steps must be at least 1, it is 0"),
        ("pinch_weight", float("nan"), "pinch_weight must be at least 0, it is nan"),
    ):
        with pytest.raises(TrainingError, match=message):
            training_config("geort", {name: value})
    for call in (
        lambda: training_config("geort", {"speed": 1}),
        lambda: quick(fk="analytic"),
        lambda: quick(device="tpu"),
    ):
        with pytest.raises(UnknownNameError):
            call()
    with pytest.raises(TrainingError, match="hold is not trained"):
        training_config("hold")
    if not torch.cuda.is_available():
        with pytest.raises(TrainingError, match="no CUDA device"):
            quick(device="cuda")

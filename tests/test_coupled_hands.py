"""The hands that `geort_coupled` is trained with: what of them was recorded, and what was made up."""

import dataclasses

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics

from geort_drake.retargeting.methods.coupled import hands as coupled_hands
from geort_drake.retargeting.methods.coupled.hands import STEP_LAGS, STEP_RANGE, TrainingHands, rarity
from geort_drake.retargeting.methods.coupled.training import CoupledConfig

NAMES = ("thumb", "index", "middle")
RECORDED = CoupledConfig(spread_share=0.0, strange_pinch_share=0.0, strange_hand_share=0.0)


@pytest.fixture(scope="module")
def human():
    return toy_human(toy_kinematics())


def hands_of(human, config=RECORDED, seed=0) -> TrainingHands:
    generator = torch.Generator().manual_seed(seed)
    return TrainingHands(human, NAMES, config, generator)


def rows_of(tips: torch.Tensor, recorded: np.ndarray) -> np.ndarray:
    """For each point (N, 3) whether it is one of the recorded ones."""
    distance = np.linalg.norm(tips.numpy()[:, None] - recorded.astype(np.float32)[None], axis=-1)
    return distance.min(axis=1) < 1e-7


def test_without_spread_every_hand_was_recorded(human):
    """Hands in which a finger is moved, and those before and after a step, are rows of the recording."""
    hands = hands_of(human)
    x, d = hands.one_moved(20)
    assert x.shape == (3, 20, 3, 3) and d.shape == (3, 20, 3)
    assert rows_of(x.flatten(0, 1).flatten(1), human.reshape(len(human), -1)).all()
    length = d.norm(dim=-1)
    assert length.min() >= 0.001 and length.max() <= 0.011
    before, after = hands.steps(50)
    track = human.astype(np.float32).reshape(len(human), -1)
    start = np.abs(before.flatten(1).numpy()[:, None] - track).max(-1).argmin(1)
    end = np.abs(after.flatten(1).numpy()[:, None] - track).max(-1).argmin(1)
    assert set(end - start) <= set(STEP_LAGS)
    step = (after - before).norm(dim=-1).max(dim=1).values
    assert step.min() > 0.99 * STEP_RANGE[0] and step.max() < 1.01 * STEP_RANGE[1]


def test_a_share_of_the_hands_is_displaced_by_the_spread(human):
    """Every fingertip of it by itself; steps keep their length and direction."""
    config = dataclasses.replace(RECORDED, spread_share=0.4, spread=0.02)
    hands = hands_of(human, config)
    x, _ = hands.one_moved(1000)
    x = x.flatten(0, 1)
    displaced = ~rows_of(x[:, 0], human[:, 0])
    assert displaced.mean() == pytest.approx(0.4, abs=0.03)
    np.testing.assert_array_equal(displaced, ~rows_of(x[:, 2], human[:, 2]))
    same, moved = hands_of(human, RECORDED).steps(300), hands_of(human, config).steps(300)
    torch.testing.assert_close(moved[1] - moved[0], same[1] - same[0], atol=1e-6, rtol=0.0)
    offset = (moved[0] - same[0]).flatten()
    assert offset[offset.abs() > 1e-6].std() == pytest.approx(0.02, rel=0.1)


def test_made_up_pinches_meet_whatever_the_other_finger_does(human):
    """The pair pinches around one point; the third fingertip is from another instant in a share."""
    config = dataclasses.replace(RECORDED, strange_pinch_share=0.5, pinch_spread=1e-9)
    hands, weights = hands_of(human, config).made_up_pinches(400)
    assert (weights.sum(1) == 1).all()
    for pair, (first, second) in enumerate([(0, 1), (0, 2)]):
        chosen = hands[weights[:, pair] == 1]
        assert len(chosen) > 20
        distance = (chosen[:, first] - chosen[:, second]).norm(dim=-1)
        assert distance.max() <= config.pinch_threshold + 1e-6 and distance.std() > 0.002
        other = 3 - second
        assert rows_of(chosen[:, other], human[:, other]).all()
    # Where the third fingertip was recorded, the pair that met was under pinch_reach apart.
    reach = np.linalg.norm(human[:, 0] - human[:, 1], axis=-1) < config.pinch_reach
    kept = hands[200:][weights[200:, 0] == 1]
    assert rows_of(kept[:, 2], human[reach, 2]).all()
    strange = hands[:200][weights[:200, 0] == 1]
    assert not rows_of(strange[:, 2], human[reach, 2]).all()


def test_made_up_pinches_are_apart_in_recorded_directions_or_displaced_ones(human):
    """The offset between the tips turns with its spread, and is no longer than in any pinch."""
    recorded = (human[:, 1] - human[:, 0])[np.linalg.norm(human[:, 1] - human[:, 0], axis=-1) < 0.03]
    recorded = torch.tensor(recorded / np.linalg.norm(recorded, axis=-1, keepdims=True)).float()
    turned = {}
    for spread in (0.0, 0.006, 0.06):
        config = dataclasses.replace(RECORDED, pinch_offset_spread=spread)
        hands, weights = hands_of(human, config).made_up_pinches(2000)
        offset = (hands[:, 1] - hands[:, 0])[weights[:, 0] == 1]
        length = offset.norm(dim=-1, keepdim=True)
        assert length.max() <= config.pinch_threshold + 1e-6 and length.std() > 0.002
        cosine = (offset / length) @ recorded.T
        turned[spread] = cosine[length[:, 0] > 0.001].max(dim=1).values.quantile(0.05).item()
        print(spread, turned)
    assert turned[0.0] > 0.9999
    assert 0.0 < turned[0.06] < turned[0.006] < 0.99


def test_postures_are_alike_however_long_they_were_held(human):
    """Of a hand that rests for nine tenths of a recording, every draw of recorded hands has little."""
    held = np.concatenate([human[:150], human[0] + 1e-5 * np.arange(1350)[:, None, None]])
    held[150:, :2] = human[0, :1] + 1e-5 * np.arange(1350)[:, None, None]  # a pinch
    drawn = {}
    for share in (0.0, 0.5, 1.0):
        config = dataclasses.replace(RECORDED, even_share=share, posture_radius=0.02, recorded_hand_share=1.0)
        hands = hands_of(held, config)
        rest = torch.tensor(held[150:].astype(np.float32))
        drawn[share] = [
            rows_of(some.flatten(1), rest.flatten(1).numpy()).mean()
            for some in (
                hands.recorded(2000),
                hands.one_moved(500)[0].flatten(0, 1),
                hands.pinches(500)[0][:500],
            )
        ]
    assert min(drawn[0.0]) > 0.85
    assert max(drawn[1.0][:2]) < 0.1 and drawn[1.0][2] < 0.8 * drawn[0.0][2]
    np.testing.assert_allclose(drawn[0.5][:2], [0.45, 0.45], atol=0.1)


def test_a_share_of_the_hands_in_which_a_finger_is_moved_pinches(human):
    """For every finger some with the other fingers displaced, and some with strange ones."""
    config = dataclasses.replace(RECORDED, pinching_hand_share=0.5, strange_pinch_share=0.5)
    hands = hands_of(human, config)
    x, _ = hands.one_moved(400)
    near = torch.stack([(x[:, :, 0] - x[:, :, i]).norm(dim=-1) for i in (1, 2)]).amin(0)
    assert (near[:, 200:] <= config.pinch_threshold + 1e-6).all()
    assert (near[:, :200] <= config.pinch_threshold).float().mean() < 0.5
    for finger in range(3):
        whole = rows_of(x[finger, 200:, 2][:, None].flatten(1), human[:, 2])
        assert 0.2 < whole.mean() < 0.95


def test_a_person_without_near_fingertips_is_moved_without_pinches(human):
    """There is nothing to make pinches of."""
    apart = human + np.array([0.0, 0.0, 0.5]) * np.array([0, 1, 1])[:, None]
    config = dataclasses.replace(RECORDED, pinch_weight=0.0, pinching_hand_share=0.5)
    x, _ = hands_of(apart, config).one_moved(20)
    assert rows_of(x.flatten(0, 1).flatten(1), apart.reshape(len(apart), -1)).all()


def test_recombined_hands_take_each_finger_from_an_instant_of_its_own(human):
    """Every fingertip was recorded, hardly any hand was."""
    hands = hands_of(human).recombined(200)
    for finger in range(3):
        assert rows_of(hands[:, finger], human[:, finger]).all()
    assert rows_of(hands.flatten(1), human.reshape(len(human), -1)).mean() < 0.05


def test_one_seed_draws_the_same_hands(human):
    """And another seed others."""
    drawn = [hands_of(human, CoupledConfig(), seed).pinches(30)[0] for seed in (1, 1, 2)]
    assert torch.equal(drawn[0], drawn[1])
    assert not torch.equal(drawn[0], drawn[2])


def test_a_hand_without_near_fingertips_makes_up_no_pinches(human):
    """The other fingers stay far from the thumb."""
    apart = human + np.array([0.0, 0.0, 0.5]) * np.array([0, 1, 1])[:, None]
    hands, weights = hands_of(apart, dataclasses.replace(RECORDED, pinch_weight=0.0)).pinches(10)
    assert hands.shape == (0, 3, 3) and weights.shape == (0, 2)


@pytest.mark.parametrize("counted", [5000, 300])
def test_rare_points_weigh_more_so_that_places_weigh_alike(rng, monkeypatch, counted):
    """In any number of dimensions, and nearly so where not all are counted."""
    monkeypatch.setattr(coupled_hands, "COUNTED", counted)
    points = np.concatenate([n + rng.uniform(0.0, 0.1, (count, 6)) for n, count in enumerate((900, 100, 1))])
    odds = rarity(rng.permutation(points), 0.5)
    order = np.sort(odds)
    assert order[:900] == pytest.approx(np.full(900, 1001 / 900), rel=0.1)
    assert order[900:1000] == pytest.approx(np.full(100, 1001 / 100), rel=0.4)
    assert order[1000] > 5 * order[999]

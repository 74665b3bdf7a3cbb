"""The training of a universal map."""

import numpy as np
import pytest
import torch
from retargeting_toy import toy_kinematics
from scipy.spatial.transform import Rotation

from geort_drake import HandModel, load_hand
from geort_drake.errors import TrainingError
from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.population import sample_population
from geort_drake.retargeting.methods.coupled import CoupledConfig
from geort_drake.retargeting.methods.coupled.losses import RobotTips, constraint_terms
from geort_drake.retargeting.methods.coupled.people import TrainingPeople
from geort_drake.retargeting.methods.coupled.population import code_people, likely_plays
from geort_drake.retargeting.methods.coupled.training import train_universal
from geort_drake.retargeting.training.human_data import pinch_pairs

FINGERS = ("thumb", "index", "middle", "ring")


@pytest.fixture(scope="module")
def people():
    p_HK = sample_population(4, seed=0, duration_s=20.0)
    rng, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    coded = code_people(p_HK, FINGERS, rng)
    p_HF = p_HK[:, :, [TIP_KEYPOINT[name] for name in FINGERS]]
    pairs = pinch_pairs(FINGERS)
    weights, cpu = [1] * 4, torch.device("cpu")
    return TrainingPeople(p_HF, pairs, generator, rng, coded.codes, coded.reach, 0.005, weights, cpu)


def test_the_seed_determines_the_map_to_the_last_bit():
    """A small map of the Allegro hand, twice; another seed gives another."""
    hand = HandModel(load_hand("allegro_right"))
    config = CoupledConfig(steps=12)

    def arrays(seed):
        return train_universal(hand.kinematics(), collision_shapes(hand), config, 6, seed).arrays

    first, again, other = arrays(0), arrays(0), arrays(1)
    for name, array in first.items():
        np.testing.assert_array_equal(array, again[name])
    assert not np.array_equal(first["weight0"], other["weight0"])


def test_a_perfect_map_violates_nothing(people):
    """The robot's fingertips move as the person's, over a distance where touching tips overlap by the aim."""
    hands = people.draw(4)
    d = torch.nn.functional.one_hot(hands.finger, 4)[..., None] * hands.d[:, :, None]
    tips = RobotTips(hands.moved, hands.moved + d, hands.moved - d, hands.before, hands.after, hands.pinching)
    figures = {
        name: float(figure) for name, (_, figure) in constraint_terms(hands, tips, people, 0.012).items()
    }
    for name in ("direction", "track", "cross_talk", "curvature", "uneven", "open_pinch", "false_pinch"):
        assert figures[name] < 1e-3, name
    still = RobotTips(*(torch.zeros_like(part) for part in vars(tips).values()))
    terms = constraint_terms(hands, still, people, 0.012)
    assert float(terms["direction"][1]) == pytest.approx(1.0)
    assert float(terms["deep_pinch"][1]) == 1.0 and float(terms["false_pinch"][1]) == 1.0


def test_figures_are_ratios(people):
    """Others that move a quarter as far, a bent answer, and a gain that differs in one of four hands."""
    hands = people.draw(4)
    d = torch.nn.functional.one_hot(hands.finger, 4)[..., None] * hands.d[:, :, None]
    others = torch.where(d == 0, 0.25 * hands.d[:, :, None], d)
    large = torch.where(torch.arange(hands.d.shape[1])[:, None, None] % 4 == 0, 3.0, 1.0)

    def figures(ahead, behind):
        tips = [hands.moved, hands.moved + ahead, hands.moved + behind, hands.before, hands.after]
        terms = constraint_terms(hands, RobotTips(*tips, hands.pinching), people, 0.012)
        return {name: float(figure) for name, (_, figure) in terms.items()}

    assert figures(others, -others)["cross_talk"] == pytest.approx(0.25, abs=0.02)
    assert figures(d, -0.5 * d)["curvature"] == pytest.approx(0.25, abs=1e-3)
    assert figures(large * d, -large * d)["uneven"] == pytest.approx(0.25)


def test_likely_plays_are_those_of_the_persons_hand():
    """For a person of the population itself, seen in another frame and scale, they are that person's play."""
    (play,) = sample_population(1, seed=5, duration_s=10.0).astype(float)
    R = Rotation.from_euler("xyz", [10, -20, 15], degrees=True).as_matrix()
    seen = 1.2 * play @ R.T + [0.01, 0.0, -0.02]
    (likely,) = likely_plays(seen, FINGERS, seed=5, people=1, duration_s=10.0)
    np.testing.assert_allclose(likely, seen[:, [TIP_KEYPOINT[name] for name in FINGERS]], atol=1e-4)


def test_unusable_settings_and_hands_are_refused():
    with pytest.raises(TrainingError, match="steps must be positive, it is 0"):
        CoupledConfig(steps=0).validate()
    with pytest.raises(TrainingError, match="needs a thumb and another finger, it has index, middle"):
        train_universal(toy_kinematics(("index", "middle")), None)

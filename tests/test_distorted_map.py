"""Maps that are distorted in known ways, and the design of such maps."""

from types import SimpleNamespace

import numpy as np
import pytest

from studies.distorted_map import DistortedMap, Distortion, design, distortion_of, half

FINGERS = ("thumb", "index", "middle", "ring")
RUNS = design()


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def distorted(**how):
    """A map that returns its fingertips as they are, distorted; and fingertips far from a pinch."""
    through = SimpleNamespace(
        finger_names=FINGERS, joint_names=tuple("abcdefghijkl"), lower=-np.ones(12), upper=np.ones(12)
    )
    map_of = type("Map", (), {"__call__": lambda _, p: p.reshape(*p.shape[:-2], 12), **vars(through)})()
    rest = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0.1, 0.2, 0]])
    frames = rest + np.random.default_rng(1).uniform(-0.03, 0.03, (500, 4, 3))
    return DistortedMap(map_of, frames, [4, 8, 12, 16], Distortion(**how), 3), frames


def tips(how, p_HF):
    return how(p_HF).reshape(*p_HF.shape)


def test_the_design_is_balanced_and_its_factors_are_orthogonal():
    """So is the half with which each seed begins."""
    for names in (list(RUNS), half(RUNS)):
        chosen = np.array([RUNS[name] for name in names])
        assert (chosen.sum(axis=0) == 0).all()
        products = chosen.T @ chosen
        assert (products == np.diag(np.diag(products))).all()
    assert len(RUNS) == 96 and len(half(RUNS)) == 48
    assert distortion_of((-1,) * 7) == Distortion()


def test_each_distortion_does_what_it_says():
    """Pinches are kept but for the gap."""
    step = np.array([0.0, 0.0, 0.004])
    neutral, frames = distorted()
    here = frames[np.linalg.norm(frames[:, 1:] - frames[:, :1], axis=-1).min(axis=1) > 0.07]
    np.testing.assert_allclose(tips(neutral, here), here, atol=1e-12)
    moved = here.copy()
    moved[:, 1] += step

    def response(**how):
        made, _ = distorted(**how)
        return tips(made, moved) - tips(made, here)

    turned = response(rotation=0.5)[:, 1]
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 0.004, rtol=1e-6)
    assert 0.004 * np.cos(0.5) - 1e-9 <= turned[0] @ step / 0.004 < 0.0039
    np.testing.assert_allclose(
        response(cross_talk=0.15)[:, 2], np.tile(0.15 * step, (len(here), 1)), atol=1e-9
    )
    np.testing.assert_allclose(response(reach=0.3)[:, 1], np.tile(0.7 * step, (len(here), 1)), atol=1e-9)
    gains = response(gain=4.0)[:, 1, 2] / 0.004
    assert 3.0 < gains.max() / gains.min() <= 4.0
    made, _ = distorted(ripple=0.001)
    assert 0.0008 < np.abs(tips(made, here) - here).max() <= 0.001
    pinched = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.1, 0.1, 0], [0.1, 0.2, 0]])
    for how in ({"rotation": 0.5}, {"gain": 4.0}, {"reach": 0.3}, {"cross_talk": 0.15}):
        made, _ = distorted(**how)
        np.testing.assert_allclose(tips(made, pinched)[:2], pinched[:2], atol=1e-12)
    apart = tips(distorted(gap=0.012)[0], pinched)
    assert np.linalg.norm(apart[1] - apart[0]) == pytest.approx(0.022, abs=1e-4)

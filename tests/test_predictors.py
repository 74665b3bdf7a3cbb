"""The study of open-loop figures finds known answers in synthetic trials."""

from types import SimpleNamespace

import numpy as np
import pytest

from geort_drake.benchmark.folder import Benchmark
from geort_drake.benchmark.records import TrialKey, TrialLog
from studies.distorted_map import FACTORS, DistortedMap, Distortion, design, distortion_of, half
from studies.predictor_analysis import CRITERIA, analyse, main_effects, map_means, threshold, verdict
from studies.predictors import Place, order

FINGERS = ("thumb", "index", "middle", "ring")
RUNS = design()
LEVELS = np.array(list(RUNS.values()), float)


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


def synthetic(rng, effects, levels=LEVELS, seeds=4, maps=2.0, noise=4.0, base=70.0):
    """Scores (maps, seeds) with known effects and random maps and seeds."""
    mean = base + levels @ np.asarray(effects) / 2 + maps * rng.normal(size=len(levels))
    return mean[:, None] + 5 * rng.normal(size=seeds) + noise * rng.normal(size=(len(levels), seeds))


def test_effects_have_intervals_that_cover_them(rng):
    """Also where a run was stopped within its last seed."""
    truth = np.array([-12.0, 0, -5, 0, 3, 0, -8])
    covered = []
    for _ in range(150):
        table = synthetic(rng, truth)
        table[rng.permutation(len(table))[:15], -1] = np.nan
        found = main_effects(LEVELS, map_means(table).means)
        covered += [each["low"] <= t <= each["high"] for each, t in zip(found, truth, strict=True)]
    assert 0.92 < np.mean(covered) < 0.98


def test_a_threshold_is_found_where_the_curve_flattens(rng):
    X = rng.uniform(0, 1, (60, 3))
    y = 10 * np.minimum(X[:, 1], 0.6) + X[:, 0] + 0.2 * rng.normal(size=60)
    found = threshold(X, y, 1, True)
    assert found["low"] <= 0.6 <= found["high"] and found["high"] - found["low"] < 0.2
    assert threshold(X, 10 * X[:, 1] + 0.2 * rng.normal(size=60), 1, True) is None


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        ([{"a": "worse", "b": "worse", "c": "worse"}] * 2, "matters"),
        ([{"a": "worse", "b": "worse", "c": "worse"}], "open"),
        ([{"a": "worse"}] * 3, "open"),
        ([{"a": "worse", "b": "no", "c": "worse"}, {"a": "open"}], "operator-dependent"),
        ([{"a": "worse", "b": "better", "c": "open"}], "operator-dependent"),
        ([{"a": "no", "b": "no", "c": "no"}] * 2, "unsupported"),
        ([{"a": "no", "b": "no", "c": "no"}], "open"),
        ([{"a": "no", "b": "open", "c": "no"}] * 2, "open"),
    ],
)
def test_a_verdict_needs_three_kinds_and_two_tasks(kinds, expected):
    assert verdict({str(task): each for task, each in enumerate(kinds)}) == expected


def test_the_analysis_of_synthetic_trials_finds_what_was_put_in(rng):
    """Rotation harms everywhere, cross-talk only the servo, gain nobody."""
    others = rng.uniform(-1, 1, (28, 7))
    levels = np.vstack([LEVELS, others])
    maps = {}
    for row, values in enumerate(levels):
        spoilt = dict(zip(FACTORS, values, strict=True))
        figures = {
            "motion_preservation": 0.9 - 0.05 * spoilt["rotation"],
            "gain_p95_p5": np.exp(1 + spoilt["gain"]),
            "cross_talk": 0.1 + 0.05 * spoilt["cross_talk"],
            "pinch": {"closed": 0.9 - 0.1 * spoilt["gap"]},
            "coverage": {"10mm": 0.7 - 0.05 * spoilt["reach"]},
            "flatness": np.exp(spoilt["ripple"] - 4),
        }
        maps[str(row)] = {
            "levels": values.tolist() if row < len(LEVELS) else None,
            "figures": figures,
            "latency": 0.016 + 0.014 * spoilt["latency"],
        }
    maps[str(len(levels) - 1)]["figures"] = None  # not measured yet
    cells = {}
    for task in ("keys", "grasp"):
        for kind in ("servo", "mimicry", "adaptive"):
            truth = [-20.0, 0, -20 * (kind == "servo"), 0, 0, 0, 0]
            scores = synthetic(rng, truth, levels, seeds=8, maps=1.0)
            scores[rng.permutation(len(levels))[:20], -1] = np.nan
            cells[task, kind] = scores, np.log(10.0) - scores / 500
    result = analyse(cells, maps)
    found = {c.factor: result["verdicts"][c.label] for c in CRITERIA}
    assert found["rotation"] == "matters" and found["cross_talk"] == "operator-dependent"
    assert found["gain"] == found["latency"] == "unsupported"
    assert result["largest_correlation"] < 0.1
    cell = result["cells"]["keys servo"]
    assert cell["trials"] == len(levels) * 8 - 20 and cell["maps"] == len(levels) - 1
    assert cell["reliability"]["score"] > 0.9 and cell["halves"] > 0.8 and cell["others"] > 0.8
    share = {label: each["dominance"] for label, each in cell["criteria"].items()}
    assert sorted(share, key=share.get)[-2:] != ["coverage at 10 mm", "latency, s"]
    assert sum(share[c.label] for c in CRITERIA if c.factor in ("rotation", "cross_talk")) > 0.85


def test_reliability_is_the_share_that_repeats(rng):
    """Maps of variance 9 and noise of variance 36 in 4 seeds: 9 / (9 + 9)."""
    found = [map_means(synthetic(rng, np.zeros(7), maps=3.0, noise=6.0)).reliability for _ in range(200)]
    assert np.median(found) == pytest.approx(0.5, abs=0.07)
    assert np.isnan(map_means(synthetic(rng, np.zeros(7), seeds=1)).reliability)


def test_every_prefix_of_the_trials_is_balanced_and_finished_ones_are_left_out(tmp_path):
    """Seed by seed, a half of the maps first; a map has all its tasks before the next one begins."""
    places, maps, half_of_them = [], ["a", "b", "c", "d"], ["b", "c"]
    for name in ("servo", "mimicry"):
        config = {"settings": {"scenario": {"random_seed": 0}}}
        benchmark = Benchmark(tmp_path, config, "", None, {}, {})
        places.append(Place(TrialLog(tmp_path / f"{name}.jsonl"), benchmark, {"x": [], "y": []}))
    queue = order(places, maps, half_of_them, 3)
    assert len(queue) == len({(place.log.path, key) for place, key in queue}) == 3 * 2 * 2 * 4
    assert [key.seed for _, key in queue] == sorted(key.seed for _, key in queue)
    blocks = [key.method for _, key in queue if key.seed == 1]
    assert blocks == sorted(blocks, key=blocks.index) and set(blocks) == set(maps)
    assert set(blocks[: len(blocks) // 2]) == set(half_of_them)
    for place, key in queue[:7]:
        place.log.append(
            {"method": key.method, "object": key.object, "seed": key.seed, "error": "", "traceback": ""}
        )
    for place in places:
        place.log.close()
    places = [place._replace(log=TrialLog(place.log.path)) for place in places]
    assert len(order(places, maps, half_of_them, 3)) == 48  # errors are repeated
    finished = [place._replace(log=SimpleNamespace(unfinished=lambda keys: keys[1:])) for place in places]
    left = order(finished, maps, half_of_them, 3)
    assert len(left) == 46 and TrialKey("a", "x", 0) not in {key for _, key in left}
    for place in places:
        place.log.close()

"""Sampled robot data, its labels and its cache."""

import numpy as np
import pytest

from geort_drake.hands.model import HandModel
from geort_drake.hands.samples import robot_data


def test_samples_depend_on_nothing_but_hand_count_and_seed(allegro, tmp_path):
    """The same for a seed, others for another seed, and all within the limits."""
    first = robot_data(allegro, 500, seed=3, cache=tmp_path / "a")
    again = robot_data(allegro, 500, seed=3, cache=tmp_path / "b")
    other = robot_data(allegro, 500, seed=4, cache=tmp_path / "a")
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.p_BF, again.p_BF)
    assert not np.isin(first.q, other.q).any()
    assert ((allegro.lower <= first.q) & (first.q <= allegro.upper)).all()


def test_samples_are_the_same_however_many_processes_label_them(allegro, tmp_path):
    """One or two; progress is reported in order."""
    done = []
    alone = robot_data(allegro, 3200, cache=tmp_path / "a", processes=1)
    shared = robot_data(
        allegro, 3200, cache=tmp_path / "b", processes=2, progress=lambda *step: done.append(step)
    )
    for name, value in vars(alone).items():
        np.testing.assert_array_equal(value, getattr(shared, name))
    assert 0.05 < alone.collides_beyond_tips.mean() < 0.95
    assert done[-1] == (3200, 3200) and done == sorted(done)


def test_without_labels_nothing_is_computed(allegro, tmp_path, monkeypatch):
    """The positions are the same as with labels; nothing is stored."""
    labelled = robot_data(allegro, 300, cache=tmp_path / "a")
    monkeypatch.setattr(HandModel, "collides_beyond_tips", lambda *_: pytest.fail("labelled"))
    data = robot_data(allegro, 300, cache=tmp_path / "b", labels=False)
    np.testing.assert_array_equal(data.q, labelled.q)
    assert data.p_BF is None and data.collides_beyond_tips is None
    assert not (tmp_path / "b").exists()


def test_cached_samples_are_returned_as_they_were(allegro, tmp_path, monkeypatch):
    """The second call computes nothing and returns identical arrays."""
    calls = []
    first = robot_data(allegro, 300, cache=tmp_path, progress=lambda *step: calls.append(step))
    assert calls[-1] == (300, 300)
    monkeypatch.setattr(HandModel, "fingertips", lambda *_: pytest.fail("sampled again"))
    second = robot_data(allegro, 300, cache=tmp_path)
    for name, value in vars(first).items():
        np.testing.assert_array_equal(value, getattr(second, name))


@pytest.mark.parametrize("damage", ["truncated", "not a number"])
def test_a_damaged_cache_is_replaced(allegro, tmp_path, damage):
    """A damaged cache file is never used, and replaced."""
    good = robot_data(allegro, 200, cache=tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    match damage:
        case "truncated":
            path.write_bytes(whole[: len(whole) // 2])
        case "not a number":
            np.savez(path, **(vars(good) | {"p_BF": good.p_BF * np.nan}))
    mended = robot_data(allegro, 200, cache=tmp_path)
    np.testing.assert_array_equal(mended.p_BF, good.p_BF)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    with np.load(path) as file:
        np.testing.assert_array_equal(file["q"], good.q)

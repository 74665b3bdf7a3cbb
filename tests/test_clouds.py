"""Voxels of point clouds."""

import numpy as np
import pytest

from geort_drake.retargeting import clouds
from geort_drake.retargeting.clouds import first_in_voxels, rarity, voxel_centres, voxel_index


@pytest.mark.parametrize("count", [0, 1, 2, 5000])
def test_voxels_are_those_that_numpy_finds(count, rng):
    """Centres in order, each voxel once, and of each the first point; also on both sides of zero."""
    points = rng.normal(0.0, 0.02, (count, 3))
    cells, first = np.unique(voxel_index(points, 0.005), axis=0, return_index=True)
    np.testing.assert_array_equal(voxel_centres(points, 0.005), (cells + 0.5) * 0.005)
    np.testing.assert_array_equal(first_in_voxels(points, 0.005), np.sort(first))
    assert count < 5000 or len(cells) < count


@pytest.mark.parametrize("counted", [5000, 300])
def test_rare_points_weigh_more_so_that_places_weigh_alike(rng, monkeypatch, counted):
    """In any number of dimensions, and nearly so where not all are counted."""
    monkeypatch.setattr(clouds, "COUNTED", counted)
    points = np.concatenate([n + rng.uniform(0.0, 0.1, (count, 6)) for n, count in enumerate((900, 100, 1))])
    odds = rarity(rng.permutation(points), 0.5)
    order = np.sort(odds)
    assert order[:900] == pytest.approx(np.full(900, 1001 / 900), rel=0.1)
    assert order[900:1000] == pytest.approx(np.full(100, 1001 / 100), rel=0.4)
    assert order[1000] > 5 * order[999]

"""Voxels of point clouds."""

import numpy as np
import pytest

from geort_drake.retargeting.clouds import first_in_voxels, voxel_centres, voxel_index


@pytest.mark.parametrize("count", [0, 1, 2, 5000])
def test_voxels_are_those_that_numpy_finds(count, rng):
    """Centres in order, each voxel once, and of each the first point; also on both sides of zero."""
    points = rng.normal(0.0, 0.02, (count, 3))
    cells, first = np.unique(voxel_index(points, 0.005), axis=0, return_index=True)
    np.testing.assert_array_equal(voxel_centres(points, 0.005), (cells + 0.5) * 0.005)
    np.testing.assert_array_equal(first_in_voxels(points, 0.005), np.sort(first))
    assert count < 5000 or len(cells) < count

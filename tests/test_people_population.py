"""The population of people: reproducible, within joint limits, of the stated kinds, and wide enough."""

import numpy as np
import pytest

from geort_drake.people.population import sample_population


def test_the_seed_and_the_number_decide_a_person():
    """Neither the count nor the number of processes matters; other seeds and numbers differ."""
    people = sample_population(3, 5, duration_s=2.0)
    assert (people.shape, people.dtype) == ((3, 60, 21, 3), np.float32)
    np.testing.assert_array_equal(sample_population(2, 5, duration_s=2.0, processes=2), people[:2])
    assert not np.allclose(people[0], people[1])
    assert not np.allclose(sample_population(1, 6, duration_s=2.0), people[:1])
    with pytest.raises(ValueError, match="must be positive"):
        sample_population(0, 5)

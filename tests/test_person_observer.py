"""A person observed frame by frame."""

import numpy as np
import pytest
from universal_map import FINGERS, PLAY

from geort_drake.people.population import sample_person
from geort_drake.retargeting.person_code import observe
from geort_drake.retargeting.person_observer import RECENT, WINDOW, PersonObserver


def observer_of(frames, observer=None):
    observer = observer or PersonObserver.of_nobody(FINGERS)
    for p_HK in frames:
        observer = observer.seeing(p_HK)
    return observer


@pytest.mark.parametrize("count", [1, 300])
def test_frame_by_frame_is_as_all_at_once(count):
    """As long as the window holds all frames; an observer is not changed by those made of it."""
    start = observer_of(PLAY[:1])
    observer = observer_of(PLAY[1:count], start)
    for part, given in vars(observer.observation()).items():
        np.testing.assert_allclose(given, getattr(observe(PLAY[:count], FINGERS), part), atol=1e-12)
    np.testing.assert_array_equal(start.places, 1)


def test_memory_is_bounded_and_a_still_hand_shows_nothing_new():
    """Shapes are those of the last frames; a place counts once."""
    observer = observer_of([PLAY[0]] * (WINDOW + 5))
    assert len(observer.shapes) == WINDOW
    np.testing.assert_array_equal(observer.places, 1)


def test_points_that_are_no_hand_do_not_count():
    """Bones without length."""
    assert len(observer_of(np.zeros((3, 21, 3))).shapes) == 0


def test_another_person_is_noticed_and_the_same_one_is_not():
    """A hand 7 % larger is; a camera's noise is not."""
    camera = next(person for person in (sample_person(5, n) for n in range(40)) if person.device.is_camera)
    for frames in (PLAY[::2], camera.record(8.0, 30.0).p_HK.astype(float)):
        observer = observer_of(frames[: 3 * RECENT])
        for p_HK in frames[3 * RECENT :]:
            observer = observer.seeing(p_HK)
            assert not observer.has_changed()
    observer = observer_of(PLAY[: 2 * RECENT])
    assert observer_of(1.07 * PLAY[:RECENT], observer).has_changed()

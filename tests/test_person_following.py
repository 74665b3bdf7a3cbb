"""A retargeting system with the universal map follows the person who plays."""

import dataclasses

import numpy as np
import pytest
from faults.bench import Bench, Watch
from universal_map import FINGERS, PLAY, random_retargeter

from geort_drake.retargeting.person_observer import RECENT
from geort_drake.systems.glove_checks import FROZEN, HELD_LOST, HELD_NOT_FINITE, GloveChecks
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.person_following import FADE_TIME, LEARNED_AFTER, PersonFollowing
from geort_drake.systems.retargeting_status import (
    FOLLOWED,
    HELD_OTHER_PERSON,
    LEARNING,
    SETTLING,
    TRACKING,
    UNUSUAL,
)

RETARGET = random_retargeter()
PERIOD, F = 0.01, len(FINGERS)
OTHER = 1.12 * PLAY


class Session(Bench):
    """A system that is shown hand after hand."""

    def __init__(self, retarget=RETARGET):
        limits, start = JointLimits(RETARGET.lower, RETARGET.upper), retarget(PLAY[0])
        checks = GloveChecks(ease_at_start=False)
        super().__init__(retarget, PERIOD, start=start, limits=limits, checks=checks)
        self.watch = Watch(limits, PERIOD, start)

    def show(self, frames, valid=1.0):
        """Joint targets (T, n), and the last status; every command keeps the limits."""
        positions = []
        for p_HK in frames:
            q, v, status = self.tick(p_HK, valid)
            assert not self.watch.broken(q, v)
            positions.append(q)
        return np.array(positions), status


def test_the_first_frame_is_followed_and_the_person_gets_known():
    """At first by the shape of one frame; at the end by what was seen until the last change of the map."""
    session = Session()
    q, status = session.show(PLAY[:1])
    np.testing.assert_allclose(q[0], RETARGET(PLAY[0]))
    assert status.state == LEARNING
    _, status = session.show(PLAY[1 : 4 * LEARNED_AFTER])
    assert status.state in FOLLOWED and status.state != LEARNING
    known = session.context.get_abstract_state(0).get_value()
    np.testing.assert_allclose(
        known.code[: 7 * F], RETARGET.code(PLAY[: 4 * LEARNED_AFTER])[: 7 * F], atol=0.1
    )


def test_a_new_map_takes_over_evenly():
    """For a still hand, targets move from the old map's to the new one's at one rate over the fade."""
    old = PersonFollowing.start(RETARGET).seeing(PLAY[0], 0.0)
    new = dataclasses.replace(old, now=RETARGET.folded(RETARGET.code(OTHER)), before=old.now, since=1.0)
    q = np.array([new.retarget(PLAY[9], t) for t in 1.0 + np.linspace(0.0, FADE_TIME + 0.1, 61)])
    np.testing.assert_allclose(q[0], old.now(PLAY[9]))
    np.testing.assert_array_equal(q[-1], new.now(PLAY[9]))
    most = np.abs(q[-1] - q[0]) * 0.01 / FADE_TIME
    assert (np.abs(np.diff(q, axis=0)) <= most + 1e-12).all()


def test_a_fitted_map_takes_over_without_a_jump_and_stays():
    """Also in the middle of a fade; it is followed until another person is seen."""
    session = Session()
    session.show(PLAY[:60])
    fitted = RETARGET.folded(RETARGET.code(OTHER))
    before = session.context.get_abstract_state(0).get_value()
    assert session.system.change_map(session.context, fitted)
    known, now = session.context.get_abstract_state(0).get_value(), session.context.get_time()
    np.testing.assert_allclose(known.retarget(PLAY[9], now), before.retarget(PLAY[9], now))
    q, _ = session.show(PLAY[60 : 4 * LEARNED_AFTER])
    np.testing.assert_allclose(q[-1], fitted(PLAY[4 * LEARNED_AFTER - 1]), atol=1e-6)
    session.show(OTHER[:400])
    assert not session.context.get_abstract_state(0).get_value().own
    assert not Session(fitted).system.change_map(session.context, fitted)


def test_another_person_is_held_named_and_followed():
    """By a map of their own, to which the earlier person does not contribute."""
    session = Session()
    session.show(PLAY[: 6 * RECENT])
    states, held = [], []
    for p_HK in OTHER[6 * RECENT : 6 * RECENT + 450]:
        q, status = session.show([p_HK])
        states.append(status.state)
        held += [q[0]] if status.state == HELD_OTHER_PERSON else []
    first = states.index(HELD_OTHER_PERSON)
    assert first < 4 * RECENT
    np.testing.assert_array_equal(held[-1], held[20])
    after = states[first + len(held) :]
    assert len(held) < 110 and HELD_OTHER_PERSON not in after and set(after) <= set(FOLLOWED)
    known = session.context.get_abstract_state(0).get_value()
    lengths = RETARGET.code(OTHER)[3 * F : 4 * F]
    np.testing.assert_allclose(known.observer.observation().lengths, lengths, rtol=1e-6)


@pytest.mark.parametrize(
    ("frames", "valid", "state"),
    [
        ([PLAY[300]] * 80, 1.0, FROZEN),
        (PLAY[300:360], 0.0, HELD_LOST),
        (np.full((5, 21, 3), np.nan), 1.0, HELD_NOT_FINITE),
    ],
)
def test_bad_input_teaches_nothing(frames, valid, state):
    """Frozen, lost and broken hands are reported as ever."""
    session = Session()
    session.show(PLAY[:300])
    before = session.context.get_abstract_state(0).get_value().observer
    _, status = session.show(frames, valid)
    assert status.state == state
    assert len(session.context.get_abstract_state(0).get_value().observer.shapes) <= len(before.shapes) + 2


def test_what_is_no_hand_from_the_first_frame_on_is_held():
    """Points without a hand's length stop nothing."""
    _, status = Session().show(np.zeros((30, 21, 3)))
    assert status.state in (HELD_NOT_FINITE, SETTLING)


def test_an_unusual_hand_is_followed_and_named():
    """The status says what is unusual."""
    session = Session()
    _, status = session.show(1.35 * PLAY[: 4 * LEARNED_AFTER])
    assert status.state == UNUSUAL and "deviations" in status.unusual


def test_a_map_of_one_person_has_no_state_for_the_person():
    """And its system works as ever."""
    session = Session(RETARGET.for_person(PLAY))
    assert session.context.num_abstract_states() == 0
    q, status = session.show(PLAY[:9])
    assert status.state == TRACKING
    np.testing.assert_array_equal(q[-1], session.system._retarget(PLAY[8]))

"""The universal map: calls, the person it follows, and who is refused."""

import numpy as np
import pytest

from geort_drake import HandModel, load_retargeter, synthesize_play
from geort_drake.errors import GeortError
from geort_drake.metrics.metrics import evaluate_frames
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting.person_code import observe
from geort_drake.retargeting.person_observer import RECENT, WINDOW, PersonObserver
from geort_drake.retargeting.store import shipped_maps

MAP = shipped_maps()["allegro_right"]
RETARGET = load_retargeter(MAP)
FINGERS = RETARGET.finger_names
PLAY = synthesize_play(seed=1, duration_s=12.0, rate_hz=100.0).p_HK.astype(float)


def test_it_works_at_once_and_as_one_persons_map():
    """A call takes the shape from its frames; a person's map also takes fingertips and has a Jacobian."""
    own = RETARGET.for_person(PLAY)
    np.testing.assert_allclose(RETARGET(PLAY), own(PLAY))
    np.testing.assert_allclose(RETARGET(PLAY[0]), RETARGET(PLAY[:1])[0])
    np.testing.assert_allclose(RETARGET.for_person(PLAY[0])(PLAY), RETARGET.for_person(PLAY[:1])(PLAY))
    tips = PLAY[0, list(RETARGET.human_keypoints)]
    np.testing.assert_allclose(own(tips), own(PLAY[0]))
    assert own.jacobian(tips).shape == (16, 4, 3)
    assert own.trained_space.distances(PLAY[7]).max() < 0.01


def test_it_refuses_what_shows_no_person():
    """Fingertips alone, no frames, NaN, and points without a hand."""
    with pytest.raises(ValueError, match="for_person"):
        RETARGET(PLAY[0, :4])
    for call, frames in ((RETARGET, PLAY[:0]), (RETARGET.for_person, PLAY[0, :4])):
        with pytest.raises(ValueError, match="whole hands"):
            call(frames)
    for frame, message in ((np.full((21, 3), np.nan), "finite"), (np.zeros((21, 3)), "hardly any length")):
        with pytest.raises(GeortError, match=message):
            RETARGET(frame)


def test_a_person_unlike_all_others_is_clamped_and_named():
    """The part farthest out is said, and how far."""
    code = RETARGET.code(PLAY)
    assert RETARGET.unusual(code) == ""
    odd = code.copy()
    odd[len(FINGERS) * 3 + 1] *= 10.0  # the index finger's length
    assert RETARGET.unusual(odd).startswith("length of the index: ")
    assert np.isfinite(RETARGET.folded(odd)(PLAY)).all()


@pytest.mark.parametrize("name", ["allegro_right", "allegro_left", "leap_right"])
def test_the_shipped_map_serves_an_unseen_person_from_the_first_second(name):
    """A person whom the training has not seen: fingertips move as theirs do, and most pinches close."""
    hand = HandModel(name)
    retarget = load_retargeter(name, hand)
    recording = sample_person(0, 803).record(20.0, rate_hz=30.0)
    own = retarget.for_person(recording.p_HK[:30].astype(float))
    p_HF = recording.fingertips(hand.description.human_keypoints)
    metrics, _ = evaluate_frames(own, hand, p_HF, recording.rate_hz)
    assert metrics["motion_preservation"] > 0.94
    assert metrics["pinch"]["closed"] > 0.9


def observer_of(frames, observer=None):
    observer = observer or PersonObserver.empty(FINGERS)
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
    # Memory is bounded, as shapes are those of the last frames; a still hand shows no new place.
    observer = observer_of([PLAY[0]] * (WINDOW + 5))
    assert len(observer.shapes) == WINDOW
    np.testing.assert_array_equal(observer.places, 1)


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

"""The capture protocol: five minutes of motion for a person to record, demonstrated by a synthetic hand.

Training needs each fingertip throughout its workspace, and pinches with every finger in many places. Free
play lacks some of these motions. `coverage` measures how many of them a recording contains.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import (
    FLAT,
    Timeline,
    fists,
    pinch,
    pinch_postures,
    record,
    spread,
    sweep,
    wave,
)

Gesture = Callable[[Timeline, np.random.Generator], None]


class Step(NamedTuple):
    """One step of the protocol: instruction, duration, and the synthetic hand's gesture.

    The synthetic hand repeats the gesture until the time is up.
    """

    name: str
    instruction: str
    seconds: float
    gesture: Gesture


def _flat(timeline: Timeline, rng: np.random.Generator) -> None:
    timeline.move(np.deg2rad(FLAT), 0.5)
    timeline.hold(1.0)


def _sweep_of(finger: int) -> Gesture:
    return lambda timeline, rng: sweep(timeline, finger, rng)


def _pinch_with(finger: int) -> Gesture:
    def gesture(timeline: Timeline, rng: np.random.Generator) -> None:
        pinch(timeline, finger, pinch_postures(timeline.hand, finger, rng), rng)
        timeline.hold(0.2)  # also if the pinch is out of reach

    return gesture


_FINGERS = tuple(enumerate(FINGER_NAMES))[1:]
_SWEEP = "Move the {} finger sideways when stretched, half bent and bent; then move it anywhere."
_PINCH = "Pinch thumb and {} finger, slide the tips along each other, let go. Vary the place."
_FISTS = "Make a fist, then stretch all fingers fully. Repeat."
_SPREAD = "Spread and close the fingers, first with a flat hand, then with knuckles half bent."
_THUMB = "Sweep the thumb to the little finger's base, lift it off the palm, bend it, draw circles."
_TASK = "Do what your robot will do: reach, hold, turn things between the fingers."
STEPS = (
    Step("flat hand", "Hold the hand flat and still, fingers together.", 5, _flat),
    Step("fists", _FISTS, 20, fists),
    Step("spread", _SPREAD, 20, spread),
    Step("wave", "Bend the fingers in a wave from little finger to thumb and back.", 15, wave),
    Step("thumb alone", _THUMB, 30, _sweep_of(0)),
    *(Step(f"{name} alone", _SWEEP.format(name), 20, _sweep_of(i)) for i, name in _FINGERS),
    *(Step(f"thumb to {name}", _PINCH.format(name), 30, _pinch_with(i)) for i, name in _FINGERS),
    Step("your task", _TASK, 10, wave),
)
DURATION_S = sum(step.seconds for step in STEPS)


def demonstrate(
    seed: int | np.random.Generator = 0,
    rate_hz: float = 120.0,
    hand: HumanHand | None = None,
    jitter: float = 1.0,
) -> tuple[Recording, list[str]]:
    """Makes a recording of a synthetic hand that follows the protocol; arguments as in `synthesize_play`.

    Returns:
        The recording, and the name of the step in each of its frames.
    """
    rng = np.random.default_rng(seed)
    timeline = Timeline(hand or HumanHand.anatomical(), np.deg2rad(FLAT))
    starts, end = [], 0.0
    for step in STEPS:
        starts.append(timeline.times[-1])
        end += step.seconds
        # A gesture that takes longer shortens the next step, so that the total duration stays the same.
        while timeline.times[-1] < end:
            step.gesture(timeline, rng)
    recording = record(timeline, DURATION_S, rate_hz, jitter, rng, {"source": __name__, "seed": seed})
    rows = np.searchsorted(starts, recording.t, side="right") - 1
    return recording, [STEPS[row].name for row in rows]

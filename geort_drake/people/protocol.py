"""The capture protocol: five minutes of motion that a new user records, demonstrated by a synthetic hand.

Training needs each fingertip everywhere it can go, and the thumb against every finger in many places. Free
play misses some of these motions. `coverage` measures how many of them a recording shows.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.play import (
    FLAT,
    Timeline,
    described,
    fists,
    pinch,
    pinch_postures,
    record,
    spread,
    sweep,
    wave,
)
from geort_drake.people.recording import Recording

# What the hand does in a step, repeated until its time is up.
Gesture = Callable[[Timeline, HumanHand, np.random.Generator], None]


@dataclasses.dataclass(frozen=True)
class Step:
    """One step of the protocol.

    Attributes:
        name: short, as shown in a demonstration.
        instruction: what the person should do.
        seconds: its duration.
        gesture: how the synthetic hand performs it.
    """

    name: str
    instruction: str
    seconds: float
    gesture: Gesture


def _flat(timeline: Timeline, hand: HumanHand, rng: np.random.Generator) -> None:
    timeline.move(np.deg2rad(FLAT), 0.5)
    timeline.hold(1.0)


def _free(gesture: Callable[[Timeline, np.random.Generator], None]) -> Gesture:
    return lambda timeline, hand, rng: gesture(timeline, rng)


def _alone(finger: int) -> Gesture:
    return lambda timeline, hand, rng: sweep(timeline, finger, rng)


def _pinch_with(finger: int) -> Gesture:
    def gesture(timeline: Timeline, hand: HumanHand, rng: np.random.Generator) -> None:
        pinch(timeline, finger, pinch_postures(hand, finger, rng), rng)
        timeline.hold(0.2)  # a hand that cannot reach waits for its next try

    return gesture


def _steps() -> list[Step]:
    steps = [
        Step("flat hand", "Hold the hand flat and still, fingers together.", 5, _flat),
        Step("fists", "Make a fist, then stretch all fingers fully. Repeat.", 20, _free(fists)),
        Step(
            "spread",
            "Spread and close the fingers, first with a flat hand, then with knuckles half bent.",
            20,
            _free(spread),
        ),
        Step("wave", "Bend the fingers in a wave from little finger to thumb and back.", 15, _free(wave)),
        Step(
            "thumb alone",
            "Sweep the thumb to the little finger's base, lift it off the palm, bend it, draw circles.",
            30,
            _alone(0),
        ),
    ]
    fingers = list(enumerate(FINGER_NAMES))[1:]
    for i, name in fingers:
        text = f"Move the {name} finger sideways when stretched, half bent and bent; then move it anywhere."
        steps.append(Step(f"{name} alone", text, 20, _alone(i)))
    for i, name in fingers:
        text = f"Pinch thumb and {name} finger, slide the tips along each other, let go. Vary the place."
        steps.append(Step(f"thumb to {name}", text, 30, _pinch_with(i)))
    text = "Do what your robot will do: reach, hold, turn things between the fingers."
    return [*steps, Step("your task", text, 10, _free(wave))]


STEPS = tuple(_steps())
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
    hand = hand or HumanHand.anatomical()
    rng = np.random.default_rng(seed)
    timeline = Timeline(hand, np.deg2rad(FLAT))
    begins, end = [], 0.0
    for step in STEPS:
        begins.append(timeline.times[-1])
        end += step.seconds
        # A gesture that runs over shortens the next step, so that the whole keeps its length.
        while timeline.times[-1] < end:
            step.gesture(timeline, hand, rng)
    recording = record(timeline, hand, DURATION_S, rate_hz, jitter, rng)
    rows = np.searchsorted(begins, recording.t, side="right") - 1
    return described(recording, "geort_drake.people.protocol", seed), [STEPS[row].name for row in rows]

"""The five minutes that a new user records: what to do, in which order, and our synthetic hand doing it.

Training needs each fingertip everywhere it can go, and the thumb against every finger at many places. Free
play forgets some of it; these steps ask for one thing after the other. `coverage` says what was seen.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.play import FLAT, Timeline, fists, pinch, pinch_postures, record, spread, sweep, wave
from geort_drake.people.recording import Recording

# What the hand does in a step, over and over until its time is up.
Gesture = Callable[[Timeline, HumanHand, np.random.Generator], None]


@dataclasses.dataclass(frozen=True)
class Step:
    """One thing to do.

    Attributes:
        name: short, what the time line of a demonstration shows.
        instruction: what the person is told.
        seconds: for how long.
        gesture: how the synthetic hand does it.
    """

    name: str
    instruction: str
    seconds: float
    gesture: Gesture


def _flat(timeline: Timeline, hand: HumanHand, rng: np.random.Generator) -> None:
    timeline.move(np.deg2rad(FLAT), 0.5)
    timeline.hold(1.0)


def _alone(finger: int) -> Gesture:
    return lambda timeline, hand, rng: sweep(timeline, finger, rng)


def _pinch_with(finger: int) -> Gesture:
    def gesture(timeline: Timeline, hand: HumanHand, rng: np.random.Generator) -> None:
        pinch(timeline, finger, pinch_postures(hand, finger, rng), rng)
        timeline.hold(0.2)  # a hand that cannot reach waits for its next try

    return gesture


STEPS = (
    Step("flat hand", "Hold the hand flat and still, the fingers together.", 5, _flat),
    Step(
        "fists",
        "Close all fingers to a fist and stretch them as far as they go, again and again.",
        20,
        lambda timeline, hand, rng: fists(timeline, rng),
    ),
    Step(
        "spread",
        "Spread the fingers and bring them together: with the hand flat, and with the knuckles half bent.",
        20,
        lambda timeline, hand, rng: spread(timeline, rng),
    ),
    Step(
        "wave",
        "Let a wave of bending run from the little finger to the thumb and back.",
        15,
        lambda timeline, hand, rng: wave(timeline, rng),
    ),
    Step(
        "thumb alone",
        "Sweep the thumb to the little finger's base and back, lift it off the palm, bend it, draw circles.",
        30,
        _alone(0),
    ),
    *(
        Step(
            f"{name} alone",
            f"Move the {name} finger alone: sideways while stretched, half bent and bent; then anywhere.",
            20,
            _alone(finger),
        )
        for finger, name in enumerate(FINGER_NAMES)
        if finger > 0
    ),
    *(
        Step(
            f"thumb to {name}",
            f"Pinch thumb and {name} finger, slide them along each other and let go; each time elsewhere, "
            "near the palm and far from it.",
            30,
            _pinch_with(finger),
        )
        for finger, name in enumerate(FINGER_NAMES)
        if finger > 0
    ),
    Step(
        "like a tool",
        "Do what your robot shall do: reach for things, hold them, turn them between the fingers.",
        10,
        lambda timeline, hand, rng: wave(timeline, rng),
    ),
)
DURATION_S = sum(step.seconds for step in STEPS)


def demonstrate(
    seed: int | np.random.Generator = 0,
    rate_hz: float = 120.0,
    hand: HumanHand | None = None,
    jitter: float = 1.0,
) -> tuple[Recording, list[str]]:
    """The synthetic hand follows the protocol.

    Args:
        seed, rate_hz, hand, jitter: as in `synthesize_play`.

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
        # A gesture that runs over takes its time from the next step, so that the whole keeps its length.
        while timeline.times[-1] < end:
            step.gesture(timeline, hand, rng)
    recording = record(timeline, hand, DURATION_S, rate_hz, jitter, rng)
    metadata = {
        "side": "right",
        "subject": "synthetic",
        "source": "geort_drake.people.protocol",
        "rate_known": True,
        "seed": seed if isinstance(seed, int) else None,
        "warnings": [],
    }
    rows = np.searchsorted(begins, recording.t, side="right") - 1
    return dataclasses.replace(recording, metadata=metadata), [STEPS[row].name for row in rows]

"""Answers of retargeting methods to an excerpt of a recording, frame by frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import PINCH_M, Recording

WINDOW = 0.1  # s; a motion extends this far before and after a frame
SHORTEST = 0.003  # m; the direction of shorter motions of a human fingertip is not compared


@dataclass(frozen=True)
class Excerpt:
    """Hands at a constant rate.

    Attributes:
        t: (T,) time from the excerpt's beginning, s.
        start: time of the beginning in the recording, s.
        p_HK: (T, 21, 3) keypoints of a canonical right hand, m.
        rate_hz: hands per second.
    """

    t: np.ndarray
    start: float
    p_HK: np.ndarray
    rate_hz: float


@dataclass(frozen=True)
class Answers:
    """Answers of one method to an excerpt with T hands, for F fingers.

    Attributes:
        q: (T, n) joint positions, rad.
        p_BF: (T, F, 3) robot fingertips, m.
        copy: (T, F, 3) the human fingertips scaled and shifted per finger to come nearest to `p_BF` in least
            squares, m. Such a copy preserves every direction, so the difference is the price of reach,
            pinches and freedom from collisions.
        error: (T, F) distance between the two, m.
        cosine: (T,) cosine of the angle between human and robot fingertip motion, averaged over the moving
            fingers; NaN if none moves.
    """

    q: np.ndarray
    p_BF: np.ndarray
    copy: np.ndarray
    error: np.ndarray
    cosine: np.ndarray


@dataclass(frozen=True)
class Pinches:
    """The thumb and the finger nearest to it, of T hands.

    Attributes:
        pair: (T, 2) numbers of the thumb and that finger.
        distance: (T,) of the two human tips, m.
        closed: (T,) whether they pinch: less than 15 mm, as in `metrics.pinch`.
    """

    pair: np.ndarray
    distance: np.ndarray
    closed: np.ndarray


def excerpt(
    recording: Recording, rate_hz: float = 30.0, duration_s: float = 20.0, start_s: float | None = None
) -> Excerpt:
    """An excerpt of a recording; while tracking is lost, the last hand stays.

    Args:
        start_s: its beginning, s; None: where the excerpt has most pinches.

    Raises:
        RecordingError: it begins after the recording's end, or holds fewer than two hands.
    """
    t = recording.t[recording.valid] - recording.t[0]
    p_HK = recording.p_HK[recording.valid].astype(float)
    if len(t) == 0 or (start_s is not None and not 0 <= start_s < t[-1]):
        raise RecordingError(f"an excerpt must begin within the recording's {recording.duration_s:.1f} s")
    if start_s is None:
        pinching = find_pinches(p_HK[:, 4::4], ("thumb", "index", "middle", "ring", "little")).closed
        before = np.concatenate([[0], np.cumsum(pinching)])
        ends = np.searchsorted(t, t + duration_s)
        fits = t + duration_s <= max(t[-1], duration_s)
        start_s = float(t[np.argmax(np.where(fits, before[ends] - before[:-1], -1))])
    times = np.arange(start_s, min(start_s + duration_s, t[-1]) + 1e-9, 1 / rate_hz)
    if len(times) < 2:
        raise RecordingError(
            f"an excerpt from {start_s:g} s on holds {len(times)} hands; at least 2 are needed"
        )
    rows = np.maximum(np.searchsorted(t, times + 1e-9) - 1, 0)
    return Excerpt(times - start_s, start_s, p_HK[rows], rate_hz)


def find_pinches(tips: np.ndarray, finger_names: Sequence[str]) -> Pinches:
    """The pinches of human fingertips (T, F, 3), m."""
    thumb = list(finger_names).index("thumb")
    others = np.array([i for i in range(len(finger_names)) if i != thumb])
    distances = np.linalg.norm(tips[:, others] - tips[:, [thumb]], axis=-1)
    nearest = distances.argmin(axis=1)
    distance = distances[np.arange(len(tips)), nearest]
    pair = np.stack([np.full(len(tips), thumb), others[nearest]], axis=1)
    return Pinches(pair, distance, distance < PINCH_M)


def answers(retarget: Callable, hand: HandModel, hands: Excerpt) -> Answers:
    """Answers of a method to the hands, in their order.

    Args:
        retarget: from human fingertips (T, F, 3) of a canonical right hand, m, to joint positions (T, n).
    """
    human = tips_of(hands.p_HK, hand)
    q = np.asarray(retarget(human))
    # For a left robot hand: recordings are mirrored to right hands.
    if hand.description.side == "left":
        human = mirrored(human)
    p_BF = hand.fingertips(q)
    copy = proportional_copy(human, p_BF)
    error = np.linalg.norm(copy - p_BF, axis=-1)
    return Answers(q, p_BF, copy, error, motion_cosines(human, p_BF, round(WINDOW * hands.rate_hz)))


def tips_of(p_HK: np.ndarray, hand: HandModel) -> np.ndarray:
    """(T, F, 3) human fingertips that the robot's fingers follow, m."""
    return p_HK[:, hand.description.human_keypoints]


def proportional_copy(human: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """(T, F, 3) human fingertips scaled and shifted, finger by finger, to come nearest to the robot's."""
    centred, target = human - human.mean(axis=0), robot - robot.mean(axis=0)
    spread = np.einsum("tfx,tfx->f", centred, centred)
    scale = np.einsum("tfx,tfx->f", centred, target) / np.maximum(spread, 1e-12)
    return robot.mean(axis=0) + scale[:, None] * centred


def motion_cosines(human: np.ndarray, robot: np.ndarray, window: int) -> np.ndarray:
    """(T,) cosines between motions of fingertips (T, F, 3), from `window` hands before to as many after."""
    window = max(window, 1)
    rows = np.arange(len(human))
    before, after = np.maximum(rows - window, 0), np.minimum(rows + window, len(human) - 1)
    d, answer = human[after] - human[before], robot[after] - robot[before]
    length, robot_length = np.linalg.norm(d, axis=-1), np.linalg.norm(answer, axis=-1)
    moves = length > SHORTEST
    cosine = np.einsum("tfx,tfx->tf", d, answer) / np.maximum(length * robot_length, 1e-12)
    count = moves.sum(axis=1)
    return np.where(count > 0, (cosine * moves).sum(axis=1) / np.maximum(count, 1), np.nan)

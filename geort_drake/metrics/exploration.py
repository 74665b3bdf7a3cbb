"""Computes outputs of methods for each frame of a recording's excerpt."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.hands.hand import Hand
from geort_drake.metrics.evaluation import complete_hands, distal_links, distal_phalanges
from geort_drake.metrics.metrics import PENETRATION, angles_between, find_pinches
from geort_drake.people.keypoints import FINGER_NAMES, mirrored
from geort_drake.people.recording import Recording

WINDOW = 0.1  # s; motions are measured from this long before a frame to this long after it
MIN_MOTION = 0.003  # m; directions of shorter motions of a human fingertip are ignored


@dataclass(frozen=True)
class Response:
    """Outputs of a method for an excerpt of T hands with F fingers.

    Attributes:
        q: (T, n) joint positions, rad.
        p_BF: (T, F, 3) robot fingertips in B, m.
        copy: (T, F, 3) human fingertips, scaled and shifted per finger to fit `p_BF` in least squares, m.
            Such a copy preserves every direction; the difference shows what the method gives up for reach,
            pinches and collision avoidance.
        error: (T, F) distances between `copy` and `p_BF`, m.
        cosine: (T,) cosine of the angle between human and robot fingertip motions, averaged over the moving
            fingers; NaN if none moves.
        gap: (T,) distance between the robot's fingertips that correspond to the person's nearest pair, m.
        closed: (T,) whether these fingertips touch.
        angle: (T, F) angles between the last links of person and robot, from the last joint to the tip, rad.
        collisions: T arrays (k, 3) of points in B where parts of the hand overlap by over 2 mm, m.
    """

    q: np.ndarray
    p_BF: np.ndarray
    copy: np.ndarray
    error: np.ndarray
    cosine: np.ndarray
    gap: np.ndarray
    closed: np.ndarray
    angle: np.ndarray
    collisions: list[np.ndarray]


def excerpt(
    recording: Recording, rate_hz: float = 30.0, duration_s: float = 20.0, start_s: float | None = None
) -> Recording:
    """Resamples a part of a recording to a constant rate; lost hands repeat the last tracked one.

    Times begin at 0; `start_s` in the metadata is the excerpt's start in the recording, s.

    Args:
        start_s: start of the excerpt, s; by default the one that includes most pinches.

    Raises:
        RecordingError: the excerpt begins outside the recording, or contains fewer than two hands.
    """
    tracked = recording.tracked()
    t = tracked.t - recording.t[0]
    if len(t) == 0 or (start_s is not None and not 0 <= start_s < t[-1]):
        raise RecordingError(f"an excerpt must begin within the recording's {recording.duration_s:.1f} s")
    if start_s is None:
        pinching = find_pinches(tracked.fingertips(), FINGER_NAMES).closed
        before = np.concatenate([[0], np.cumsum(pinching)])
        ends = np.searchsorted(t, t + duration_s)
        fits = t + duration_s <= max(t[-1], duration_s)
        start_s = float(t[np.argmax(np.where(fits, before[ends] - before[:-1], -1))])
    times = np.arange(start_s, min(start_s + duration_s, t[-1]) + 1e-9, 1 / rate_hz)
    if len(times) < 2:
        raise RecordingError(
            f"an excerpt from {start_s:g} s on contains {len(times)} hands; at least 2 are needed"
        )
    resampled = tracked.at(times + recording.t[0])
    metadata = {**recording.metadata, "start_s": start_s}
    return dataclasses.replace(resampled, t=times - start_s, metadata=metadata)


def response(retarget: Callable, hand: Hand, hands: Recording) -> Response:
    """Computes the outputs of a method for an excerpt.

    Args:
        retarget: maps human fingertips (T, F, 3) of a canonical right hand, m, to joint angles (T, n), rad.
    """
    keypoints = hand.description.human_keypoints
    human = hands.fingertips(keypoints)
    q = np.asarray(complete_hands(retarget, hand, hands)(human))
    # Both are those of right hands.
    angle = angles_between(distal_phalanges(hands, keypoints), distal_links(hand)(q))
    # Recordings are stored as right hands, so they are mirrored for a left robot hand.
    if hand.description.side == "left":
        human = mirrored(human)
    p_BF = hand.fingertips(q)
    copy = proportional_copy(human, p_BF)
    pinching = find_pinches(human, hand.finger_names).of(p_BF)
    gap = np.linalg.norm(pinching[:, 1] - pinching[:, 0], axis=-1)
    return Response(
        q,
        p_BF,
        copy,
        np.linalg.norm(copy - p_BF, axis=-1),
        windowed_cosines(human, p_BF, round(WINDOW * hands.rate_hz)),
        gap,
        gap <= 2 * hand.tip_radius,
        angle,
        _collisions(hand, q),
    )


def proportional_copy(human: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """Scales and shifts human fingertips (T, F, 3) per finger to fit the robot's in least squares."""
    centred, target = human - human.mean(axis=0), robot - robot.mean(axis=0)
    spread = np.einsum("tfx,tfx->f", centred, centred)
    scale = np.einsum("tfx,tfx->f", centred, target) / np.maximum(spread, 1e-12)
    return robot.mean(axis=0) + scale[:, None] * centred


def windowed_cosines(human: np.ndarray, robot: np.ndarray, window: int) -> np.ndarray:
    """Computes mean cosines (T,) between motions of fingertips (T, F, 3) over ± `window` frames."""
    rows, window = np.arange(len(human)), max(window, 1)
    before, after = np.maximum(rows - window, 0), np.minimum(rows + window, len(human) - 1)
    d, robot_step = human[after] - human[before], robot[after] - robot[before]
    length, robot_length = np.linalg.norm(d, axis=-1), np.linalg.norm(robot_step, axis=-1)
    moves = length > MIN_MOTION
    cosine = np.einsum("tfx,tfx->tf", d, robot_step) / np.maximum(length * robot_length, 1e-12)
    count = moves.sum(axis=1)
    return np.where(count > 0, (cosine * moves).sum(axis=1) / np.maximum(count, 1), np.nan)


def _collisions(hand: Hand, q: np.ndarray) -> list[np.ndarray]:
    """Computes `Response.collisions`; as in `metrics.self_collision`, two fingertips may touch."""
    context = hand.contact_context()
    points = []
    for row in q:
        pairs = hand.query(row, context).ComputePointPairPenetration()
        deep = [(pair.p_WCa + pair.p_WCb) / 2 for pair in pairs if pair.depth > PENETRATION]
        points.append(np.array(deep).reshape(-1, 3))
    return points

"""Synthesizes play from a seed: five minutes of the hand motion that training needs.

The hand sweeps each finger through its range, waves, makes fists, spreads, and pinches the thumb to each
finger in varied places; digits that meet stop or slide along each other. Movements have minimum jerk (Flash &
Hogan 1985, J. Neurosci. 5:1688), with a glove's jitter and slow drift. Workspace, speed and pinches of the
fingertips lie between those of two recordings of real gloves; `tests/test_people_play.py` has the figures.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.ndimage import gaussian_filter1d

from geort_drake.errors import UnknownNameError
from geort_drake.people.recording import SIDES, Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.solid import MAX_INTERPENETRATION, SolidHand

# Angles below are in degrees; each finger has abduction and three flexions, as in HumanHand.
_FIST = np.array(
    [[30, 15, 40, 45], [0, 76, 92, 56], [0, 78, 94, 56], [0, 74, 92, 56], [0, 66, 90, 54]], float
)
FLAT = np.array([[10, -15, 0, 0], [4, -10, 2, 1], [0, -8, 2, 1], [-3, -8, 2, 1], [-8, -8, 2, 1]], float)
# Ranges (lower, upper) of the posture from which inverse kinematics closes a pinch.
_PINCH_THUMB = ((10, -5, 5, 5), (40, 30, 45, 60))
_PINCH_FINGER = ((-10, 10, 20, 10), (5, 70, 80, 50))

_THUMB = 0
# Range of abduction of each straight finger in sweeps.
_ABDUCTION = ((-5, 40), (-18, 18), (-17, 13), (-17, 14), (-28, 12))
_DIP_OVER_PIP = (0.4, 0.85)  # ratio of flexions; the textbook says 2/3, gloves show this range
_TIP_GAP_M = (0.001, 0.010)  # between the tips while pinching: glove tips lie under the skin
_JITTER_DEG = 0.03  # per frame: about 0.05 mm at a fingertip
_TREMOR_DEG = 0.05  # 8–12 Hz, about 0.1 mm at a fingertip (Riviere 1997: 0.05–0.13 mm)
_DRIFT_DEG = 0.7
_DRIFT_TIME_S = 8.0
_MAX_NOISE = 0.02  # rad per frame


def synthesize_play(
    seed: int | np.random.Generator,
    duration_s: float = 300.0,
    rate_hz: float = 120.0,
    hand: HumanHand | None = None,
    jitter: float = 1.0,
    side: str = "right",
) -> Recording:
    """Makes a synthetic recording of hand motion; the same arguments give the same recording.

    Args:
        seed: seed or generator.
        duration_s: length of the recording, s.
        rate_hz: frames per second; the default is that of common gloves.
        hand: model of the hand, by default an average adult's. Pinches that it cannot reach are left out.
        jitter: scale of jitter, tremor and drift.
        side: side of the hand; a left hand is stored as its mirror image, so the keypoints are the same.

    Raises:
        UnknownNameError: there is no such side.
        ValueError: a duration or rate that is not positive, or a negative jitter.
    """
    rng = np.random.default_rng(seed)
    timeline = _play(hand or HumanHand.anatomical(), duration_s, rng)
    metadata = {"source": __name__, "seed": seed, "side": side}
    return record(timeline, duration_s, rate_hz, jitter, rng, metadata)


def record(
    timeline: "Timeline",
    duration_s: float,
    rate_hz: float,
    jitter: float,
    rng: np.random.Generator,
    metadata: dict,
) -> Recording:
    """Records at least two frames of a hand that follows a timeline, with a glove's noise.

    The metadata must have source and seed.

    Raises:
        UnknownNameError, ValueError: as `synthesize_play` does.
    """
    if (side := metadata.get("side", "right")) not in SIDES:
        raise UnknownNameError("side", side, SIDES)
    if duration_s <= 0 or rate_hz <= 0 or jitter < 0:
        raise ValueError("duration_s and rate_hz must be positive and jitter not negative")
    hand = timeline.hand
    t = np.arange(max(2, round(duration_s * rate_hz))) / rate_hz
    theta = timeline.motion(t, jitter * _glove_noise(len(t), rate_hz, rng))
    common = {"side": "right", "rate_known": True, "warnings": []}
    seed = metadata["seed"] if isinstance(metadata["seed"], int) else None
    metadata = {**common, **metadata, "seed": seed}
    return Recording(t, hand.keypoints(theta), np.ones(len(t), bool), None, metadata)


class Timeline:
    """A sequence of postures and the times at which the hand reaches them.

    Attributes:
        hand: the moving hand.
        solid: its digits, which do not pass through one another.
        times: time of each posture, s.
        postures: joint angles (20,) of each, rad, within the hand's limits.
    """

    def __init__(self, hand: HumanHand, start: np.ndarray):
        self.hand = hand
        self.solid = SolidHand(hand)
        self.times = [0.0]
        self.postures = [self._within(start)]

    def move(self, theta: np.ndarray, duration_s: float) -> None:
        """Appends a movement of `duration_s` to theta, (20,) or (5, 4), rad, or beside it if digits meet."""
        self.times.append(self.times[-1] + duration_s)
        self.postures.append(self._within(theta))

    def hold(self, duration_s: float) -> None:
        """Appends a rest of `duration_s` in the last posture."""
        self.times.append(self.times[-1] + duration_s)
        self.postures.append(self.postures[-1])

    def motion(self, t: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Returns joint angles (T, 20), rad, at times t (T,), s; noise (T, 20), rad, is added to them.

        Movements have minimum jerk. Digits that meet stop, or slide along each other, and the hand's next
        movement starts from there.
        """
        times, postures = np.array(self.times), np.stack(self.postures)
        movement = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        duration = (times[movement + 1] - times[movement]).clip(1e-9)
        s = ((t - times[movement]) / duration).clip(0.0, 1.0)
        share = (s**3 * (10 - 15 * s + 6 * s**2))[:, None]
        lower, upper, solid = self.hand.lower, self.hand.upper, self.solid
        theta = postures[movement] + share * (postures[movement + 1] - postures[movement])
        theta = np.clip(theta + noise, lower, upper)
        theta[0] = solid.separate(theta[0])
        chunks = np.array_split(theta, max(1, len(theta) // 1000))
        meets = np.concatenate([solid.depths(chunk).max(axis=1) for chunk in chunks]) > MAX_INTERPENETRATION
        # The hand leaves its planned path where digits meet, until it is back there as a movement starts.
        start, on_path, is_stopped = postures[movement[0]], True, False
        for i in range(1, len(t)):
            if movement[i] != movement[i - 1]:
                on_path = not is_stopped
                start = postures[movement[i]] if on_path else theta[i - 1] - noise[i - 1]
            if on_path and not is_stopped and not meets[i]:
                continue
            stroke = postures[movement[i] + 1] - start
            target = np.clip(start + share[i] * stroke + noise[i], lower, upper)
            change = target - theta[i - 1]
            # Once the way is free again, the hand is at most as fast as the whole movement.
            fastest = 1.875 * np.abs(stroke).max() / duration[i] * (t[i] - t[i - 1]) + _MAX_NOISE
            aim = theta[i - 1] + change / max(1.0, np.abs(change).max() / fastest)
            theta[i], _ = solid.move(theta[i - 1], aim)
            is_stopped = bool(np.abs(theta[i] - target).max() > 1e-12)
        return theta

    def _within(self, theta: np.ndarray) -> np.ndarray:
        theta = np.clip(np.reshape(theta, 20), self.hand.lower, self.hand.upper)
        return self.solid.separate(theta)


def _play(hand: HumanHand, duration_s: float, rng: np.random.Generator) -> Timeline:
    timeline = Timeline(hand, np.deg2rad(resting(rng)))
    gestures: list[Callable] = [fists, spread, wave]
    while timeline.times[-1] < duration_s:
        pinches = {finger: pinch_postures(hand, finger, rng) for finger in range(1, 5)}
        gesture_order = [gestures[i] for i in rng.permutation(3)]
        for place, finger in enumerate(rng.permutation(5)):
            if finger != _THUMB:
                pinch(timeline, finger, pinches[finger], rng)
            sweep(timeline, finger, rng)
            if place < len(gesture_order):
                gesture_order[place](timeline, rng)
    return timeline


def sweep(timeline: Timeline, finger: int, rng: np.random.Generator) -> None:
    """Moves one finger through its range: abduction at several flexions, then random postures."""
    rest = resting(rng)
    targets = [*_abduction_sweeps(finger, rng), *(_random_posture(finger, rng) for _ in range(5))]
    for target in targets:
        theta = _perturb(rest, 9.0, rng)  # resting fingers move slightly
        theta[finger] = target
        if finger != _THUMB:
            # Neighbours follow by a fifth (Zatsiorsky et al. 2000, Exp. Brain Res. 131:187).
            for neighbour in {max(finger - 1, 1), min(finger + 1, 4)} - {finger}:
                theta[neighbour, 1:] += 0.2 * (target[1:] - rest[finger, 1:])
        timeline.move(np.deg2rad(theta), rng.uniform(0.18, 0.36))
        if rng.random() < 0.15:
            timeline.hold(rng.uniform(0.1, 0.3))


def _abduction_sweeps(finger: int, rng: np.random.Generator) -> Iterable[np.ndarray]:
    for level in rng.permutation(3):
        target = _random_posture(finger, rng)
        if finger == _THUMB:
            target[1] = (-14, 3, 20)[level] + rng.uniform(-5, 5)
            share = 1.0
        else:
            target[1] = (-20, 20, 60)[level] + rng.uniform(-12, 12)
            share = _abduction_fraction(target[1])
        for abduction in rng.permutation(_ABDUCTION[finger]):
            yield np.array([share * abduction * rng.uniform(0.6, 1.0), *target[1:]])


def _random_posture(finger: int, rng: np.random.Generator) -> np.ndarray:
    if finger == _THUMB:
        return rng.uniform((-5, -18, -5, -10), (40, 22, 38, 60))
    proximal = rng.uniform(-28, 82)
    # Hooks, with bent outer joints and the knuckle far back, are rare.
    middle = 98 * rng.beta(0.55, 0.65)
    low, high = _ABDUCTION[finger]
    abduction = _abduction_fraction(proximal) * rng.uniform(low, high)
    return np.array([abduction, proximal, middle, rng.uniform(*_DIP_OVER_PIP) * middle])


def _abduction_fraction(flexion_deg: float) -> float:
    """Returns the fraction of a knuckle's abduction that is left; flexion tightens its ligaments."""
    return 1.0 - 0.8 * np.clip(flexion_deg / 90, 0.0, 1.0)


def fists(timeline: Timeline, rng: np.random.Generator) -> None:
    """Closes and stretches all fingers twice."""
    for _ in range(2):
        timeline.move(np.deg2rad(_perturb(_FIST, 4.0, rng)), rng.uniform(0.25, 0.5))
        timeline.hold(rng.uniform(0.1, 0.3))
        timeline.move(np.deg2rad(_perturb(FLAT, 5.0, rng)), rng.uniform(0.25, 0.5))


def spread(timeline: Timeline, rng: np.random.Generator) -> None:
    """Spreads and closes all fingers at several flexions."""
    for flexion in rng.permutation([-15.0, 10.0, 40.0]):
        for share in (1.0, -0.6):
            theta = FLAT + rng.uniform(0.0, 0.25) * (_FIST - FLAT)
            theta[1:, 1] = flexion + rng.uniform(-6, 6, 4)
            theta[1:, 0] = share * np.array([16, 4, -12, -28]) + rng.uniform(-3, 3, 4)
            theta[0, :2] = (rng.uniform(0, 45), -20 if share > 0 else 15)
            timeline.move(np.deg2rad(theta), rng.uniform(0.25, 0.5))


def wave(timeline: Timeline, rng: np.random.Generator) -> None:
    """Runs a wave of flexion from finger to finger, back and forth."""
    start = _perturb(FLAT, 4.0, rng)
    depth = rng.uniform(0.5, 1.0)
    for step in range(12):
        phase = 2 * np.pi * (step / 6 - np.arange(5) / 6)
        share = depth * 0.5 * (1 - np.cos(phase))
        timeline.move(np.deg2rad(start + share[:, None] * (_FIST - start)), rng.uniform(0.18, 0.26))


def pinch(timeline: Timeline, finger: int, postures: np.ndarray, rng: np.random.Generator) -> None:
    """Lets thumb and finger approach, touch, slide along each other and part, for each pair of postures."""
    for touch, slide in postures:
        opened = np.zeros((5, 4))
        opened[_THUMB, 1:] = np.deg2rad(rng.uniform(8, 25, 3))
        opened[finger, 1:] = np.deg2rad(rng.uniform(8, 30, 3))
        timeline.move(touch - opened.ravel(), rng.uniform(0.3, 0.5))
        timeline.move(touch, rng.uniform(0.25, 0.5))
        timeline.hold(rng.uniform(0.2, 0.7))
        timeline.move(slide, rng.uniform(0.4, 0.9))
        timeline.hold(rng.uniform(0.1, 0.4))
        timeline.move(slide - opened.ravel(), rng.uniform(0.25, 0.5))


def pinch_postures(hand: HumanHand, finger: int, rng: np.random.Generator) -> np.ndarray:
    """Finds up to two pairs (n, 2, 20), rad, of postures in which thumb and finger touch, then have slid."""
    tries = 8
    theta = np.deg2rad(np.stack([resting(rng) for _ in range(tries)]))
    for i, (low, high) in ((_THUMB, _PINCH_THUMB), (finger, _PINCH_FINGER)):
        theta[:, i] = np.deg2rad(rng.uniform(low, high, (tries, 4)))
    gap = rng.uniform(*_TIP_GAP_M, tries)
    touch, near = _close_pinch(hand, finger, theta.reshape(tries, 20), np.zeros(3), gap)
    # The other fingers keep moving.
    other_motion = rng.normal(0.0, np.deg2rad(10.0), (tries, 5, 4)) * np.array([0.4, 1.0, 1.0, 1.0])
    other_motion[:, [_THUMB, finger]] = 0.0
    slide, still_near = _close_pinch(
        hand, finger, touch + other_motion.reshape(tries, 20), rng.normal(0.0, 0.008, (tries, 3)), gap
    )
    successes = np.flatnonzero(near & still_near)[:2]
    return np.stack([touch[successes], slide[successes]], axis=1)


def _close_pinch(
    hand: HumanHand, finger: int, theta: np.ndarray, shift: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Closes the tips to `gap`, m, about their midpoint plus `shift`, m; returns theta and success (n,)."""
    theta = np.clip(theta, hand.lower, hand.upper)
    p_HF = hand.fingertips(theta)
    middle = 0.5 * (p_HF[:, _THUMB] + p_HF[:, finger]) + shift
    weights = np.isin(np.arange(5), (_THUMB, finger)).astype(float)
    for _ in range(6):
        p_HF = hand.fingertips(theta)
        half_gap = p_HF[:, finger] - p_HF[:, _THUMB]
        half_gap *= (0.5 * gap / np.maximum(np.linalg.norm(half_gap, axis=1), 1e-6))[:, None]
        p_HF[:, _THUMB], p_HF[:, finger] = middle - half_gap, middle + half_gap
        theta = hand.solve_fingertips(p_HF, theta, weights, iterations=3)
        # If one of the two cannot follow, the other moves to it.
        p_HF = hand.fingertips(theta)
        middle = 0.5 * (p_HF[:, _THUMB] + p_HF[:, finger])
    is_closed = np.linalg.norm(p_HF[:, finger] - p_HF[:, _THUMB], axis=1) < _TIP_GAP_M[1] + 0.001
    return theta, is_closed


def _glove_noise(frames: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """Draws jitter, tremor and drift of the joint angles (frames, 20), rad."""
    jitter = rng.normal(size=(frames, 20))
    # Band-limited to 8–12 Hz in the frequency domain; a recording whose rate is too low has none.
    frequency = np.fft.rfftfreq(frames, 1 / rate_hz)
    band = (frequency > 8) & (frequency < 12)
    tremor = np.fft.irfft(
        np.fft.rfft(rng.normal(size=(frames, 20)), axis=0) * band[:, None], n=frames, axis=0
    )
    # One value per second is enough for a drift that takes eight.
    seconds = np.arange(frames) / rate_hz
    knots = np.arange(0.0, seconds[-1] + 4 * _DRIFT_TIME_S)
    slow = gaussian_filter1d(rng.normal(size=(len(knots), 20)), _DRIFT_TIME_S, axis=0, mode="wrap")
    slow *= np.sqrt(2 * np.sqrt(np.pi) * _DRIFT_TIME_S)
    drift = np.stack([np.interp(seconds, knots, column) for column in slow.T], axis=1)
    deviation = tremor.std(axis=0)
    tremor = np.where(deviation > 0, tremor / np.where(deviation > 0, deviation, 1.0), 0.0)
    return np.deg2rad(_JITTER_DEG * jitter + _TREMOR_DEG * tremor + _DRIFT_DEG * drift)


def resting(rng: np.random.Generator) -> np.ndarray:
    """Draws a posture (5, 4), deg, of resting fingers, each somewhat open or closed."""
    knuckles, beyond = rng.uniform(0.0, 0.6, 5), rng.uniform(0.0, 0.8, 5) ** 1.5
    share = np.column_stack([knuckles, knuckles, beyond, beyond])
    return _perturb(FLAT + share * (_FIST - FLAT), 5.0, rng)


def _perturb(posture: np.ndarray, deviation_deg: float, rng: np.random.Generator) -> np.ndarray:
    # Fingers vary less sideways than they flex.
    return posture + rng.normal(0.0, deviation_deg, posture.shape) * np.array([0.4, 1.0, 1.0, 1.0])

"""Samples synthetic people: hands from published anthropometry, habits of motion, and measuring devices.

The population's seed and a number determine a person. The constants are distributions; comments give the
source of each, or call it an assumption. Those of gloves and cameras are in `device`. No spread is fitted to
a recording, but some figures of the average hand and its play come from two gloves (see `hand` and
`play`). The population contains no hand that the checks of recordings refuse at rest.
"""

import copy
import dataclasses
import os
from functools import partial

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError
from geort_drake.people.checks import check_bones, check_order, check_unit
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic import play
from geort_drake.people.synthetic.device import Device
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.processes import end_with, usable_cores

# Hands. Length, and breadth over length, for equal shares of men and women: ANSUR II (Gordon et al. 2014,
# NATICK/TR-15/007), rounded.
_LENGTH_M = ((0.193, 0.010), (0.180, 0.009))  # mean and deviation, as below
_BREADTH = (0.447, 0.025)
# Assumption: some are children from about six years on, or have larger hands than soldiers.
_UNUSUAL_SHARE, _UNUSUAL_LENGTH_M = 0.15, (0.125, 0.22)
# Relative deviations of a finger, each bone and the palm. Hand length explains half to nearly all of the
# variance of bones; length and breadth explain 30 to 96 % of that of the knuckles' positions (Buchholz,
# Armstrong & Goldstein 1992, Ergonomics 35:261).
_FINGER_SPREAD, _BONE_SPREAD, _PALM_SPREAD = 0.06, 0.05, 0.05
# Deviations of the joint limits: knuckles bend back by 0° to 45° (norms of the Electronic Textbook of Hand
# Surgery); all others are assumptions, as are the deviations of the joint axes.
_KNUCKLES_BACK_DEG, _RANGE_DEG, _AXIS_DEG = 11.0, 7.0, 5.0

# Motion. Assumption: most people use most of their range.
_AMPLITUDE, _AMPLITUDE_BOUNDS = (0.95, 0.12), (0.5, 1.1)
# "small": everyday tasks take 48 to 60 % of the active range (Bain et al. 2015, J. Hand Surg. Eur. 40:406).
# The shares of all kinds of people are assumptions.
_STYLES = {"full": 0.55, "small": 0.25, "uneven": 0.20}
_SMALL, _UNEVEN = (0.3, 0.9), (0.35, 1.0)
_FEW_FINGERS_SHARE = 0.12
_IDLE_AMPLITUDE = 0.3  # factor on the amplitude of idle fingers, which others pull along
_NO_PINCH_SHARE, _PINCHED_SHARE = 0.05, 0.93
_GESTURE_SHARE = 0.8
_STOPPING_SHARE, _STOP_AFTER = 0.08, (0.2, 0.8)
# Factor on the durations of `play`, whose sweeps take 0.27 s each: the fastest people tap down and up within
# 0.27 s (Hammerschmidt et al. 2021, Front. Psychol. 12:677201). Assumption: the slow end, and a log-uniform
# distribution.
_PACE = (0.5, 2.0)

_AVERAGE = HumanHand.anatomical()
_GESTURES = {gesture.__name__: gesture for gesture in (play.fists, play.spread, play.wave)}
_RATE_HZ = 30.0  # of `sample_population`
_MIN_PARALLEL = 32  # people; for fewer, starting processes does not pay off


@dataclasses.dataclass(frozen=True, eq=False)
class Person:
    """A person of the population.

    Attributes:
        seed, number: seed of the population, and the person's number in it.
        device: device that measures the person.
        hand: the hand as the device shows it. Pinches close in this hand, not in the true one.
        rest: (20,) posture about which the person moves, rad.
        amplitude: (5,) amplitude of each finger's free movements, as a fraction of the hand's range.
        pace: factor on the durations of movements in `synthesize_play`.
        fingers: fingers that are moved on purpose, 0 to 4 from the thumb.
        pinch_fingers: fingers that pinch with the thumb.
        gestures: names of the whole-hand gestures that the person makes.
        mix: (3,) probabilities of pinches, sweeps of a finger, and gestures.
        stops_after: fraction of a recording after which the hand rests; 1 for most people.
    """

    seed: int
    number: int
    device: Device
    hand: HumanHand
    rest: np.ndarray
    amplitude: np.ndarray
    pace: float
    fingers: tuple[int, ...]
    pinch_fingers: tuple[int, ...]
    gestures: tuple[str, ...]
    mix: np.ndarray
    stops_after: float

    def record(self, duration_s: float, rate_hz: float | None = None, side: str = "right") -> Recording:
        """Makes a recording of the person's play; the same arguments give the same recording.

        Args:
            duration_s: length of the recording, s.
            rate_hz: frames per second, by default the device's.
            side: side of the hand; a left hand is stored as its mirror image, so the keypoints are the same.

        Raises:
            UnknownNameError: there is no such side.
            ValueError: a duration or rate that is not positive.
        """
        rate = self.device.rate_hz if rate_hz is None else rate_hz
        rng = np.random.default_rng([self.seed, self.number, 1])
        timeline = self._play(duration_s, rng)
        metadata = {"source": __name__, "seed": self.seed, "person": self.number, "side": side}
        true = play.record(timeline, duration_s, rate, self.device.jitter, rng, metadata)
        return dataclasses.replace(true, p_HK=self.device.measure(true.p_HK.astype(float), rate, rng))

    def _play(self, duration_s: float, rng: np.random.Generator) -> play.Timeline:
        timeline = _PersonalTimeline(self)
        while timeline.times[-1] < self.stops_after * duration_s:
            start = timeline.times[-1]
            activity = rng.choice(("pinch", "sweep", "gesture"), p=self.mix)
            if activity == "pinch":
                finger = rng.choice(self.pinch_fingers)
                postures = play.pinch_postures(self.hand, finger, rng)
                play.pinch(timeline.touching(finger), finger, postures, rng)
            elif activity == "gesture":
                _GESTURES[rng.choice(self.gestures)](timeline, rng)
            if activity == "sweep" or timeline.times[-1] == start:  # the pinch is out of reach
                play.sweep(timeline, rng.choice(self.fingers), rng)
        timeline.hold(duration_s)
        return timeline


class _PersonalTimeline(play.Timeline):
    """The movements of `play`, adapted to a person's range, amplitude and pace."""

    def __init__(self, person: Person):
        super().__init__(person.hand, person.rest)
        self.person = person
        self.exact = np.zeros((5, 1), bool)

    def touching(self, finger: int) -> "_PersonalTimeline":
        """Returns a view of the timeline in which thumb and finger make full movements."""
        view = copy.copy(self)
        view.exact = np.isin(np.arange(5), (0, finger))[:, None]
        return view

    def move(self, theta: np.ndarray, duration_s: float) -> None:
        theta, rest = np.reshape(theta, (5, 4)), self.person.rest.reshape(5, 4)
        angles = _scaled_to_range(self.person.hand, theta.ravel()).reshape(5, 4)
        free = rest + self.person.amplitude[:, None] * (angles - rest)
        super().move(np.where(self.exact, theta, free), self.person.pace * duration_s)


def sample_person(seed: int, number: int = 0) -> Person:
    """Returns person `number` of the population with this seed."""
    rng = np.random.default_rng([seed, number])
    device, hand, rest = _sample_measured_hand(rng)
    while not _readable(device, hand, rest, rng):
        device, hand, rest = _sample_measured_hand(rng)
    style = str(rng.choice(list(_STYLES), p=list(_STYLES.values())))
    amplitude = np.full(5, np.clip(rng.normal(*_AMPLITUDE), *_AMPLITUDE_BOUNDS))
    if style == "small":
        amplitude *= rng.uniform(*_SMALL)
    elif style == "uneven":
        amplitude *= rng.uniform(*_UNEVEN, 5)
    fingers = tuple(range(5))
    if rng.random() < _FEW_FINGERS_SHARE:
        others = rng.choice(np.arange(1, 5), rng.integers(1, 4), replace=False)
        fingers = (0, *sorted(int(finger) for finger in others))
        amplitude[~np.isin(np.arange(5), fingers)] *= _IDLE_AMPLITUDE
    pinches = rng.random() >= _NO_PINCH_SHARE
    gestures = tuple(name for name in _GESTURES if rng.random() < _GESTURE_SHARE)
    pinch_fingers = tuple(f for f in fingers if f and pinches and rng.random() < _PINCHED_SHARE)
    # Assumption: any mixture is as likely as any other.
    mix = rng.dirichlet(np.ones(3)) * (bool(pinch_fingers), True, bool(gestures))
    return Person(
        seed=seed,
        number=number,
        device=device,
        hand=hand,
        rest=rest,
        amplitude=amplitude,
        pace=np.exp(rng.uniform(*np.log(_PACE))),
        fingers=fingers,
        pinch_fingers=pinch_fingers,
        gestures=gestures,
        mix=mix / mix.sum(),
        stops_after=rng.uniform(*_STOP_AFTER) if rng.random() < _STOPPING_SHARE else 1.0,
    )


def sample_population(count: int, seed: int, duration_s: float = 60.0) -> np.ndarray:
    """Draws people and synthesises the play of each, at 30 Hz.

    Args:
        count: number of people.
        seed: seed of the population. A larger one begins with the same people.
        duration_s: duration of each person's play, s.

    Returns:
        Keypoints p_HK (count, frames, 21, 3) float32, m, in each frame's wrist frame H.

    Raises:
        ValueError: a count below 1, or a duration that is not positive.
    """
    if count < 1 or duration_s <= 0:
        raise ValueError("count and duration_s must be positive")
    processes = usable_cores() if count >= _MIN_PARALLEL else 1
    keypoints = partial(_keypoints, seed, duration_s)
    if processes == 1:
        return np.stack([keypoints(number) for number in range(count)])
    start = {"initializer": end_with, "initargs": (os.getpid(),), "env": {"OMP_NUM_THREADS": "1"}}
    with ProcessPoolExecutor(processes, **start) as pool:
        return np.stack(list(pool.map(keypoints, range(count), chunksize=4)))


def _keypoints(seed: int, duration_s: float, number: int) -> np.ndarray:
    return sample_person(seed, number).record(duration_s, _RATE_HZ).p_HK


def _sample_measured_hand(rng: np.random.Generator) -> tuple[Device, HumanHand, np.ndarray]:
    """Draws a device, the hand that it shows, and the rest posture (20,) of that hand, rad."""
    device = Device.sample(rng)
    hand = device.measured_hand(_sample_hand(rng))
    return device, hand, _scaled_to_range(hand, np.deg2rad(play.resting(rng)).ravel())


def _readable(device: Device, hand: HumanHand, rest: np.ndarray, rng: np.random.Generator) -> bool:
    """Whether two seconds of the resting hand pass the checks of recordings."""
    p_HK = device.measure(np.repeat(hand.keypoints(rest)[None], 60, axis=0), 30.0, rng)
    p_HK = p_HK.astype(np.float32).astype(float)  # as in a recording
    try:
        for check in (check_order, check_unit, check_bones):
            check(p_HK)
    except RecordingError:
        return False
    return True


def _sample_hand(rng: np.random.Generator) -> HumanHand:
    length = rng.normal(*_LENGTH_M[rng.integers(2)])
    if rng.random() < _UNUSUAL_SHARE:
        length = rng.uniform(*_UNUSUAL_LENGTH_M)
    hand = HumanHand.anatomical(length, length * rng.normal(*_BREADTH))
    proportions = rng.normal(0.0, _FINGER_SPREAD, (5, 1)) + rng.normal(0.0, _BONE_SPREAD, (5, 3))
    axes = Rotation.from_rotvec(rng.normal(0.0, np.deg2rad(_AXIS_DEG), (5, 3))).as_matrix()
    deviation = np.full((5, 4), _RANGE_DEG)
    deviation[1:, 1] = _KNUCKLES_BACK_DEG
    lower = hand.lower + rng.normal(0.0, np.deg2rad(deviation.ravel()))
    upper = hand.upper + rng.normal(0.0, np.deg2rad(_RANGE_DEG), 20)
    return HumanHand(
        p_HB=hand.p_HB * np.exp(rng.normal(0.0, _PALM_SPREAD)),
        R_HB=hand.R_HB @ axes,
        twist=hand.twist + rng.normal(0.0, np.deg2rad(_AXIS_DEG), 5),
        lengths=hand.lengths * np.exp(proportions),
        lower=lower,
        upper=np.maximum(upper, lower),
    )


def _scaled_to_range(hand: HumanHand, theta: np.ndarray) -> np.ndarray:
    """Maps joint angles (20,), rad, of the average hand to the same fractions of this hand's ranges."""
    share = (theta - _AVERAGE.lower) / (_AVERAGE.upper - _AVERAGE.lower)
    return hand.lower + share * (hand.upper - hand.lower)

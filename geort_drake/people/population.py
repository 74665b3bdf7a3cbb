"""A population of people: hands drawn from published anthropometry, who play as people do before a device.

Every person has a hand, a way to move, and a device that measures them. A person is decided by the seed of
the population and their number in it. The constants below hold each distribution with its source, or say
that it is an assumption. None is fitted to a recording.
"""

import copy
import dataclasses
import os
from functools import partial

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from geort_drake.errors import UnknownNameError
from geort_drake.people import play
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import WRIST, to_wrist_frame
from geort_drake.people.recording import SIDES, Recording
from geort_drake.processes import end_with, usable_cores

# Hands. Length and breadth: ANSUR II (Gordon et al. 2014, NATICK/TR-15/007), men and women in equal shares.
_LENGTH_M = ((0.193, 0.0098), (0.179, 0.0092))  # (mean, deviation)
_BREADTH_PER_LENGTH = (0.447, 0.025)
# Assumption: some are children from eight years on, or larger than the army's tallest.
_UNUSUAL_SHARE, _UNUSUAL_LENGTH_M = 0.10, (0.14, 0.22)
# Of what hand length leaves open of the bones (up to half of their variance) and breadth of the knuckles'
# places (up to 70 %): Buchholz, Armstrong & Goldstein 1992, Ergonomics 35:261.
_FINGER_SPREAD, _BONE_SPREAD, _PALM_SPREAD = 0.06, 0.05, 0.05
# Deviations of the joints' ranges among healthy adults are 5° to 10° (Mallon et al. 1991, J. Hand Surg.
# 16A:882).
_RANGE_DEG = 7.0
# Assumption: axes of the joints as far apart as clinicians' placements of them.
_AXIS_DEG, _TWIST_DEG = 5.0, 5.0

# Devices. Assumption: gloves show a skeleton of their own, scaled to the person by one measure or not at all,
# and estimates from a camera take the hand's size from an average.
_SKELETON_SPREAD = 0.12
_KNUCKLE_M, _THUMB_BASE_M, _WRIST_M = 0.004, 0.009, 0.005  # misplaced joints
# Where on the last bone the tip is measured: of the person's device, and of each finger. Assumption: tips lie
# under the skin, as sensors sit on nails.
_TIP_M, _TIP_DEVIATION_M, _FINGER_TIP_M = -0.003, 0.005, 0.002
_SHORTEST_BONE_M = 0.010
_JITTER = (0.3, 1.5)  # times that of `play`
_GLOVE_RATES_HZ, _CAMERA_RATES_HZ = (60.0, 72.0, 90.0, 120.0), (30.0, 60.0)
# Cameras. In a MediaPipe recording (dex-retargeting's), bones deviate by 2 to 4 mm and the hand's scale by
# 5 % from frame to frame; their share and the correlation in time are assumptions.
_CAMERA_SHARE = 0.25
_CAMERA_NOISE_M, _CAMERA_SCALE, _CAMERA_TIME_S = (0.0005, 0.003), (0.0, 0.05), 0.1

# Motion. Shares are assumptions.
_AMPLITUDE, _AMPLITUDE_BOUNDS = (0.95, 0.12), (0.5, 1.1)  # of one's range
# Small movers: everyday tasks take 48 to 60 % of the active range (Bain et al. 2015, J. Hand Surg. Eur.
# 40:406), some less.
_STYLE_SHARES = {"small": 0.25, "uneven": 0.20, "full": 0.55}
_SMALL, _UNEVEN = (0.3, 0.9), (0.35, 1.0)
_FEW_FINGERS_SHARE = 0.12
_FOLLOWING = 0.3  # unused fingers are drawn along (Zatsiorsky et al. 2000, Exp. Brain Res. 131:187)
_NO_PINCH_SHARE, _FINGER_PINCHED_SHARE = 0.05, 0.93
_GESTURE_SHARE = 0.8
_STOPPING_SHARE, _STOP_AFTER = 0.08, (0.2, 0.8)
_PACE = (0.7, 1.4)  # durations of movements, times those of `play`

_AVERAGE = HumanHand.anatomical()
_GESTURES = (play.fists, play.spread, play.wave)
_MIN_SHARED = 32  # people; fewer are not worth the start of processes


@dataclasses.dataclass(frozen=True)
class Device:
    """What a glove or camera does to the keypoints, besides the skeleton that it shows.

    Attributes:
        rate_hz: frames per second.
        p_HD: (3,) from the wrist to where the device has it, m.
        jitter: scale of a glove's jitter, tremor and drift, as in `synthesize_play`.
        noise_m: deviation of a keypoint's coordinates by a camera; 0 for a glove.
        scale_noise: deviation of the hand's scale by a camera; 0 for a glove.
    """

    rate_hz: float
    p_HD: np.ndarray
    jitter: float
    noise_m: float = 0.0
    scale_noise: float = 0.0

    @property
    def is_camera(self) -> bool:
        """Whether the person is seen by a camera rather than wearing a glove."""
        return self.noise_m > 0

    def measured(self, p_HK: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """The keypoints (T, 21, 3), m, as the device gives them, in the wrist frame that it sees."""
        p_HK = p_HK - self.p_HD
        p_HK[:, WRIST] += self.p_HD
        if self.is_camera:
            stay = np.exp(-1 / (rate_hz * _CAMERA_TIME_S))

            def correlated(shape: tuple[int, ...]) -> np.ndarray:
                return lfilter([np.sqrt(1 - stay**2)], [1, -stay], rng.normal(size=shape), axis=0)

            scale = np.exp(self.scale_noise * correlated((len(p_HK), 1, 1)))
            p_HK = scale * (p_HK + self.noise_m * correlated(p_HK.shape))
        return to_wrist_frame(p_HK)


@dataclasses.dataclass(frozen=True, eq=False)
class Person:
    """A person of the population.

    Attributes:
        seed, number: of the population, and of the person in it.
        hand: as the device shows it, with the device's bones: what touches there, touches.
        device: that measures the person.
        style: "full", "small" (all movements are small) or "uneven" (those of some fingers are).
        rest: (20,) rad, posture about which the person moves.
        amplitude: (5,) how large each finger's free movements are, as share of the hand's range.
        pace: durations of movements, times those of `synthesize_play`.
        fingers: that are moved on purpose, 0 to 4 from the thumb.
        pinched: fingers that meet the thumb.
        gestures: of the whole hand, by name.
        stops_after: share of a recording after which the hand rests, 1 for most.
    """

    seed: int
    number: int
    hand: HumanHand
    device: Device
    style: str
    rest: np.ndarray
    amplitude: np.ndarray
    pace: float
    fingers: tuple[int, ...]
    pinched: tuple[int, ...]
    gestures: tuple[str, ...]
    stops_after: float

    def record(self, duration_s: float, rate_hz: float | None = None, side: str = "right") -> Recording:
        """Makes a recording of the person at play; the same arguments give the same recording.

        Args:
            duration_s: length, s.
            rate_hz: frames per second, by default the device's.
            side: of the hand; a left one is described by its mirror image, so the keypoints are the same.

        Raises:
            UnknownNameError: there is no such side.
            ValueError: a duration or rate that is not positive.
        """
        if side not in SIDES:
            raise UnknownNameError("side", side, SIDES)
        rate = self.device.rate_hz if rate_hz is None else rate_hz
        if duration_s <= 0 or rate <= 0:
            raise ValueError("duration_s and rate_hz must be positive")
        rng = np.random.default_rng([self.seed, self.number, 1])
        timeline = self._play(duration_s, rng)
        metadata = {"source": __name__, "seed": self.seed, "person": self.number, "side": side}
        true = play.record(timeline, duration_s, rate, self.device.jitter, rng, metadata)
        return dataclasses.replace(true, p_HK=self.device.measured(true.p_HK.astype(float), rate, rng))

    def _play(self, duration_s: float, rng: np.random.Generator) -> play.Timeline:
        timeline = _PersonalTimeline(self)
        gestures = [gesture for gesture in _GESTURES if gesture.__name__ in self.gestures]
        while timeline.times[-1] < self.stops_after * duration_s:
            for finger in rng.permutation(self.fingers):
                if finger in self.pinched:
                    postures = play.pinch_postures(self.hand, finger, rng)
                    play.pinch(timeline.touching(finger), finger, postures, rng)
                play.sweep(timeline, finger, rng)
                if gestures and rng.random() < 0.6:
                    gestures[rng.integers(len(gestures))](timeline, rng)
        timeline.hold(duration_s)
        return timeline


class _PersonalTimeline(play.Timeline):
    """The movements of `play`, carried over to a person's range, amplitude and pace."""

    def __init__(self, person: Person):
        super().__init__(person.hand, person.rest)
        self.person = person
        self.exact = np.zeros((5, 1), bool)

    def touching(self, finger: int) -> "_PersonalTimeline":
        """The same timeline, but thumb and finger move as they are told."""
        view = copy.copy(self)
        view.exact = np.isin(np.arange(5), (0, finger))[:, None]
        return view

    def move(self, theta: np.ndarray, duration_s: float) -> None:
        theta, rest = np.reshape(theta, (5, 4)), self.person.rest.reshape(5, 4)
        own = _in_range_of(self.person.hand, theta.ravel()).reshape(5, 4)
        free = rest + self.person.amplitude[:, None] * (own - rest)
        super().move(np.where(self.exact, theta, free), self.person.pace * duration_s)


def sample_person(seed: int, number: int = 0) -> Person:
    """Draws a person: the one of this number in the population of this seed."""
    rng = np.random.default_rng([seed, number])
    hand = _sample_hand(rng)
    style = str(rng.choice(list(_STYLE_SHARES), p=list(_STYLE_SHARES.values())))
    amplitude = np.full(5, np.clip(rng.normal(*_AMPLITUDE), *_AMPLITUDE_BOUNDS))
    if style == "small":
        amplitude *= rng.uniform(*_SMALL)
    elif style == "uneven":
        amplitude *= rng.uniform(*_UNEVEN, 5)
    fingers = tuple(range(5))
    if rng.random() < _FEW_FINGERS_SHARE:
        others = rng.choice(np.arange(1, 5), rng.integers(1, 4), replace=False)
        fingers = (0, *sorted(int(finger) for finger in others))
        amplitude[~np.isin(np.arange(5), fingers)] *= _FOLLOWING
    pinches = rng.random() >= _NO_PINCH_SHARE
    pinched = tuple(f for f in fingers if f and pinches and rng.random() < _FINGER_PINCHED_SHARE)
    return Person(
        seed=seed,
        number=number,
        hand=hand,
        device=_sample_device(rng),
        style=style,
        rest=_in_range_of(hand, np.deg2rad(play.resting(rng)).ravel()),
        amplitude=amplitude,
        pace=rng.uniform(*_PACE),
        fingers=fingers,
        pinched=pinched,
        gestures=tuple(g.__name__ for g in _GESTURES if rng.random() < _GESTURE_SHARE),
        stops_after=rng.uniform(*_STOP_AFTER) if rng.random() < _STOPPING_SHARE else 1.0,
    )


def sample_population(
    count: int,
    seed: int,
    duration_s: float = 60.0,
    rate_hz: float = 30.0,
    processes: int | None = None,
) -> np.ndarray:
    """Draws people and lets each play.

    Args:
        count: number of people.
        seed: of the population. The first people of a larger one are the same.
        duration_s: of play by each, s.
        rate_hz: frames per second of all.
        processes: how many share the work, without effect on the result; by default one per core, or only
            this one for few people.

    Returns:
        Keypoints p_HK (count, frames, 21, 3) float32, m, in each frame's wrist frame H.

    Raises:
        ValueError: a count below 1, or a duration or rate that is not positive.
    """
    if count < 1 or duration_s <= 0 or rate_hz <= 0:
        raise ValueError("count, duration_s and rate_hz must be positive")
    if processes is None:
        processes = usable_cores() if count >= _MIN_SHARED else 1
    keypoints = partial(_keypoints, seed, duration_s, rate_hz)
    if processes == 1:
        return np.stack([keypoints(number) for number in range(count)])
    start = {"initializer": end_with, "initargs": (os.getpid(),), "env": {"OMP_NUM_THREADS": "1"}}
    with ProcessPoolExecutor(processes, **start) as pool:
        return np.stack(list(pool.map(keypoints, range(count), chunksize=4)))


def _keypoints(seed: int, duration_s: float, rate_hz: float, number: int) -> np.ndarray:
    return sample_person(seed, number).record(duration_s, rate_hz).p_HK


def _sample_hand(rng: np.random.Generator) -> HumanHand:
    length = rng.normal(*_LENGTH_M[rng.integers(2)])
    if rng.random() < _UNUSUAL_SHARE:
        length = rng.uniform(*_UNUSUAL_LENGTH_M)
    average = HumanHand.anatomical(length, length * rng.normal(*_BREADTH_PER_LENGTH))
    spreads = ((_SKELETON_SPREAD, (1, 1)), (_FINGER_SPREAD, (5, 1)), (_BONE_SPREAD, (5, 3)))
    lengths = average.lengths * np.exp(sum(rng.normal(0.0, spread, shape) for spread, shape in spreads))
    lengths[:, 2] += rng.normal(_TIP_M, _TIP_DEVIATION_M) + rng.normal(0.0, _FINGER_TIP_M, 5)
    p_HB = average.p_HB * np.exp(rng.normal(0.0, _PALM_SPREAD)) + rng.normal(0.0, _KNUCKLE_M, (5, 3))
    p_HB[0] += rng.normal(0.0, _THUMB_BASE_M, 3)
    turn = Rotation.from_rotvec(rng.normal(0.0, np.deg2rad(_AXIS_DEG), (5, 3))).as_matrix()
    lower = average.lower + rng.normal(0.0, np.deg2rad(_RANGE_DEG), 20)
    upper = average.upper + rng.normal(0.0, np.deg2rad(_RANGE_DEG), 20)
    return HumanHand(
        p_HB=p_HB,
        R_HB=average.R_HB @ turn,
        twist=average.twist + rng.normal(0.0, np.deg2rad(_TWIST_DEG), 5),
        lengths=np.maximum(lengths, _SHORTEST_BONE_M),
        lower=lower,
        upper=np.maximum(upper, lower),
    )


def _sample_device(rng: np.random.Generator) -> Device:
    p_HD, jitter = rng.normal(0.0, _WRIST_M, 3), rng.uniform(*_JITTER)
    if rng.random() >= _CAMERA_SHARE:
        return Device(float(rng.choice(_GLOVE_RATES_HZ)), p_HD, jitter)
    noise_m, scale_noise = rng.uniform(*_CAMERA_NOISE_M), rng.uniform(*_CAMERA_SCALE)
    return Device(float(rng.choice(_CAMERA_RATES_HZ)), p_HD, jitter, noise_m, scale_noise)


def _in_range_of(hand: HumanHand, theta: np.ndarray) -> np.ndarray:
    """Joint angles (20,), rad, of the average hand, carried over to the same share of this hand's ranges."""
    share = (theta - _AVERAGE.lower) / (_AVERAGE.upper - _AVERAGE.lower)
    return hand.lower + share * (hand.upper - hand.lower)

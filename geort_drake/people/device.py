"""Measurement errors of gloves and cameras in the keypoints of a hand.

The constants are distributions; comments give the source of each, or call it an assumption.
"""

import dataclasses

import numpy as np
from scipy.signal import lfilter

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import WRIST, to_wrist_frame

# The skeleton. A glove's bone lengths come from one measurement of the hand or from none; a headset's tips
# are off by 11 mm on average (Abdlkarim et al. 2024, Behav. Res. Methods 56:1052), an eighth of a finger.
_SCALE_SPREAD = 0.12
# Assumption: joints are off by millimetres, the thumb's base most, because it is inside the palm.
_KNUCKLE_M, _THUMB_BASE_M, _WRIST_M = 0.004, 0.009, 0.005
# Position of the measured tip along the last bone, for the device and each finger. Assumption: under the
# skin, because sensors sit on nails.
_TIP_M, _TIP_DEVIATION_M, _FINGER_TIP_M = -0.003, 0.005, 0.002
_SHORTEST_BONE_M = 0.012

# Assumption: a quarter of all people are seen by a camera.
_CAMERA_SHARE = 0.25
_CAMERA_RATES_HZ, _GLOVE_RATES_HZ = (30.0, 60.0), (60.0, 72.0, 90.0, 120.0)
# From frame to frame, the bones of MediaPipe deviate by 2 to 4 mm and the hand's scale by 5 % (measured on
# the recording in dex-retargeting). Assumption: errors last a tenth of a second.
_NOISE_M, _SCALE_NOISE, _NOISE_TIME_S = (0.0005, 0.0025), (0.0, 0.05), 0.1
_JITTER = (0.3, 1.5)  # assumption


@dataclasses.dataclass(frozen=True, eq=False)
class Device:
    """A glove or camera and its errors.

    Attributes:
        rate_hz: frames per second.
        scale: of the fingers it shows, relative to the person's.
        tip_m: (5,) how far along the last bone it measures the tip beyond the true one, m.
        misplaced: (5, 3) base points of the fingers relative to the true ones, m.
        p_HD: (3,) its wrist, measured from the true one, m.
        jitter: scale of a glove's jitter, tremor and drift, as in `synthesize_play`.
        noise_m: deviation of each coordinate of a camera's keypoints, m; 0 for a glove.
        scale_noise: relative deviation of the size of the hand that a camera sees; 0 for a glove.
    """

    rate_hz: float
    scale: float
    tip_m: np.ndarray
    misplaced: np.ndarray
    p_HD: np.ndarray
    jitter: float
    noise_m: float = 0.0
    scale_noise: float = 0.0

    @property
    def is_camera(self) -> bool:
        """Whether it sees the hand rather than being worn."""
        return self.noise_m > 0

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "Device":
        """Draws a device."""
        misplaced = rng.normal(0.0, _KNUCKLE_M, (5, 3))
        misplaced[0] += rng.normal(0.0, _THUMB_BASE_M, 3)
        camera = rng.random() < _CAMERA_SHARE
        return cls(
            rate_hz=float(rng.choice(_CAMERA_RATES_HZ if camera else _GLOVE_RATES_HZ)),
            scale=np.exp(rng.normal(0.0, _SCALE_SPREAD)),
            tip_m=rng.normal(_TIP_M, _TIP_DEVIATION_M) + rng.normal(0.0, _FINGER_TIP_M, 5),
            misplaced=misplaced,
            p_HD=rng.normal(0.0, _WRIST_M, 3),
            jitter=rng.uniform(*_JITTER),
            noise_m=rng.uniform(*_NOISE_M) if camera else 0.0,
            scale_noise=rng.uniform(*_SCALE_NOISE) if camera else 0.0,
        )

    def shown(self, hand: HumanHand) -> HumanHand:
        """The hand as the device shows it."""
        lengths = self.scale * hand.lengths
        lengths[:, 2] += self.tip_m
        return dataclasses.replace(
            hand, lengths=np.maximum(lengths, _SHORTEST_BONE_M), p_HB=hand.p_HB + self.misplaced
        )

    def measure(self, p_HK: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """Keypoints (T, 21, 3), m, of the hand that it shows, with its noise.

        They are in the frame H of the noisy keypoints, so the device's orientation makes no difference.
        """
        p_DK = p_HK - self.p_HD
        p_DK[:, WRIST] = 0.0
        if self.is_camera:
            kept = np.exp(-1.0 / (rate_hz * _NOISE_TIME_S))
            noise = self.noise_m * _autoregressive(p_DK.shape, kept, rng)
            scale = np.exp(self.scale_noise * _autoregressive((len(p_DK), 1, 1), kept, rng))
            p_DK = scale * (p_DK + noise)
        return to_wrist_frame(p_DK)


def _autoregressive(shape: tuple[int, ...], kept: float, rng: np.random.Generator) -> np.ndarray:
    """First-order autoregressive noise along the first axis, of deviation 1 and coefficient `kept`."""
    return lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.normal(size=shape), axis=0)

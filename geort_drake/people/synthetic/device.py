"""Models the measurement errors of gloves and cameras in the keypoints of a hand.

The constants are distributions; comments give the source of each, or call it an assumption.
"""

import dataclasses

import numpy as np

from geort_drake.people.keypoints import WRIST, to_wrist_frame
from geort_drake.people.synthetic.hand import HumanHand

# Skeleton. A glove's bone lengths come from one measurement of the hand or none; a headset's fingertips
# are off by 11 mm on average (Abdlkarim et al. 2024, Behav. Res. Methods 56:1052), an eighth of a finger.
_SCALE_SPREAD = 0.12
# Assumption: joints are off by millimetres, the thumb's base most, because it lies inside the palm.
_KNUCKLE_M, _THUMB_BASE_M, _WRIST_M = 0.004, 0.009, 0.005
# Offset of the measured tip along the last bone: mean and deviation of a device, deviation of each finger.
# Assumption: tips lie under the skin, because sensors sit on nails.
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
        scale: ratio of measured to true finger lengths.
        tip_m: (5,) offset of the measured tips along the last bones, m; positive beyond the true tip.
        knuckle_offset: (5, 3) errors of the fingers' base points in H, m.
        p_HD: (3,) position of the measured wrist D in the true H, m.
        jitter: scale of a glove's jitter, tremor and drift, as in `synthesize_play`.
        noise_m: standard deviation of each coordinate of a camera's keypoints, m; 0 for a glove.
        scale_noise: relative standard deviation of the hand's size in a camera's frames; 0 for a glove.
    """

    rate_hz: float
    scale: float
    tip_m: np.ndarray
    knuckle_offset: np.ndarray
    p_HD: np.ndarray
    jitter: float
    noise_m: float = 0.0
    scale_noise: float = 0.0

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "Device":
        """Draws a device from the distributions above."""
        knuckle_offset = rng.normal(0.0, _KNUCKLE_M, (5, 3))
        knuckle_offset[0] += rng.normal(0.0, _THUMB_BASE_M, 3)
        camera = rng.random() < _CAMERA_SHARE
        return cls(
            rate_hz=float(rng.choice(_CAMERA_RATES_HZ if camera else _GLOVE_RATES_HZ)),
            scale=np.exp(rng.normal(0.0, _SCALE_SPREAD)),
            tip_m=rng.normal(_TIP_M, _TIP_DEVIATION_M) + rng.normal(0.0, _FINGER_TIP_M, 5),
            knuckle_offset=knuckle_offset,
            p_HD=rng.normal(0.0, _WRIST_M, 3),
            jitter=rng.uniform(*_JITTER),
            noise_m=rng.uniform(*_NOISE_M) if camera else 0.0,
            scale_noise=rng.uniform(*_SCALE_NOISE) if camera else 0.0,
        )

    def measured_hand(self, hand: HumanHand) -> HumanHand:
        """Returns the hand as the device shows it, before noise and the error of the wrist."""
        lengths = self.scale * hand.lengths
        lengths[:, 2] += self.tip_m
        return dataclasses.replace(
            hand, lengths=np.maximum(lengths, _SHORTEST_BONE_M), p_HB=hand.p_HB + self.knuckle_offset
        )

    def measure(self, p_HK: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """Returns the keypoints (T, 21, 3), m, that the device measures; p_HK are those of the hand it shows.

        The result is in the frame H of the noisy keypoints, so the device's orientation makes no difference.
        """
        p_DK = p_HK - self.p_HD
        p_DK[:, WRIST] = 0.0
        if self.noise_m > 0:  # a camera
            coefficient = np.exp(-1.0 / (rate_hz * _NOISE_TIME_S))
            noise = self.noise_m * _autoregressive(p_DK.shape, coefficient, rng)
            scale = np.exp(self.scale_noise * _autoregressive((len(p_DK), 1, 1), coefficient, rng))
            p_DK = scale * (p_DK + noise)
        return to_wrist_frame(p_DK)


def _autoregressive(shape: tuple[int, ...], coefficient: float, rng: np.random.Generator) -> np.ndarray:
    """Draws first-order autoregressive noise of unit deviation and given coefficient along the first axis."""
    from scipy.signal import lfilter  # takes half a second

    return lfilter([np.sqrt(1.0 - coefficient**2)], [1.0, -coefficient], rng.normal(size=shape), axis=0)

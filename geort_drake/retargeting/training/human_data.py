"""Human fingertips as training data: recorded frames, and the cloud of each fingertip."""

import itertools
import warnings
from collections.abc import Sequence

import numpy as np

from geort_drake.errors import TrainingError
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import voxel_thinned, without_repeats

HUMAN_VOXEL = 0.001  # m; thinning of the clouds
MIN_CLOUD = 50


class HumanData:
    """Human fingertips, checked and thinned.

    Attributes:
        finger_names: names of the F fingers.
        frames: (T, F, 3) recorded frames in H without exact repeats, m.
        clouds: F arrays (M, 3) of each fingertip's positions, one per voxel, m.
        mean, scale: (F, 3) mean and standard deviation of the clouds, m.
        points: size of each finger's cloud, by name.
        pairs: pairs of fingers from `pinch_pairs`.
    """

    def __init__(self, p_HF: np.ndarray, finger_names: Sequence[str]):
        """Takes the fingertips (T, F, 3) of a recording, in H, m.

        Raises:
            TrainingError: the shape is wrong, a value is not finite, or a finger hardly moves.
        """
        p_HF = np.asarray(p_HF, dtype=float)
        self.finger_names = tuple(finger_names)
        fingers = len(self.finger_names)
        if p_HF.ndim != 3 or p_HF.shape[1:] != (fingers, 3) or not np.isfinite(p_HF).all():
            raise TrainingError(
                f"human fingertips must be finite and of shape (T, {fingers}, 3) for "
                f"{', '.join(finger_names)}; they have shape {p_HF.shape}"
            )
        self.frames = without_repeats(p_HF)
        self.clouds = [voxel_thinned(self.frames[:, i], HUMAN_VOXEL) for i in range(fingers)]
        self.points = dict(zip(finger_names, map(len, self.clouds), strict=True))
        for name, count in self.points.items():
            if count < MIN_CLOUD:
                raise TrainingError(
                    f"the recording's {name} tip visits only {count} places {1000 * HUMAN_VOXEL:g} mm apart; "
                    f"at least {MIN_CLOUD} are needed, preferably thousands"
                )
        self.mean = np.stack([cloud.mean(axis=0) for cloud in self.clouds])
        self.scale = np.maximum(np.stack([cloud.std(axis=0) for cloud in self.clouds]), 1e-3)
        self.pairs = pinch_pairs(finger_names)

    def check_pinches(self) -> None:
        """Warns of fingers that never pinch: as the nearest to the thumb, with tips within `PINCH_M`.

        Raises:
            TrainingError: no pair of fingertips ever pinches.
        """
        if not self.pairs:
            return
        first, second = zip(*self.pairs, strict=True)
        distance = np.linalg.norm(self.frames[:, list(first)] - self.frames[:, list(second)], axis=-1)
        if distance.min() >= PINCH_M:
            raise TrainingError(
                "the recording contains no pinch: the thumb's tip should come nearer than "
                f"{1000 * PINCH_M:.0f} mm to another fingertip, the nearest is "
                f"{1000 * distance.min():.0f} mm; record pinches"
            )
        nearest = distance.argmin(axis=1)[distance.min(axis=1) < PINCH_M]
        missing = [
            f"{self.finger_names[j]} (nearest {1000 * distance[:, k].min():.0f} mm)"
            for k, (_, j) in enumerate(self.pairs)
            if k not in nearest
        ]
        if missing and "thumb" in self.finger_names:
            warnings.warn(
                f"the recording contains no pinch of the thumb with: {', '.join(missing)}; "
                "such pinches of the robot may not close",
                RuntimeWarning,
                stacklevel=2,
            )


def pinch_pairs(finger_names: Sequence[str]) -> list[tuple[int, int]]:
    """Returns the pairs of finger numbers that pinch: thumb and each other finger, or all without a thumb."""
    if "thumb" in finger_names:
        thumb = list(finger_names).index("thumb")
        return [(thumb, i) for i in range(len(finger_names)) if i != thumb]
    return list(itertools.combinations(range(len(finger_names)), 2))

"""Extracts human fingertips from the input of a retargeter."""

import math
from collections.abc import Sequence

import numpy as np

from geort_drake.errors import GeortError, UnknownNameError
from geort_drake.people.keypoints import KEYPOINT_COUNT, TIP_KEYPOINT


class HumanPoints:
    """Selects and checks the fingertips of hands; the first step of every retargeter.

    Attributes:
        keypoints: (F,) numbers of the keypoints that are the fingertips.
    """

    def __init__(self, finger_names: Sequence[str], human_keypoints: Sequence[int] | None = None):
        """Takes the keypoints of the fingertips; without them, the fingers' names determine them.

        Raises:
            UnknownNameError: a finger's name has no keypoint.
        """
        if human_keypoints is None:
            for name in finger_names:
                if name not in TIP_KEYPOINT:
                    raise UnknownNameError("finger", name, TIP_KEYPOINT)
            human_keypoints = [TIP_KEYPOINT[name] for name in finger_names]
        self._finger_names = tuple(finger_names)
        self.keypoints = np.array(human_keypoints, dtype=int)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Returns fingertips (F, 3) or (N, F, 3), m, of fingertips or of whole hands (21, 3) or (N, 21, 3).

        Raises:
            ValueError: points have another shape.
            GeortError: a coordinate is not finite.
        """
        points = np.asarray(points, dtype=float)
        fingers = len(self.keypoints)
        if (
            points.ndim not in (2, 3)
            or points.shape[-1] != 3
            or points.shape[-2] not in (fingers, KEYPOINT_COUNT)
        ):
            raise ValueError(
                f"human points must be fingertips ({fingers}, 3) or (N, {fingers}, 3) for "
                f"{', '.join(self._finger_names)}, or whole hands ({KEYPOINT_COUNT}, 3) or "
                f"(N, {KEYPOINT_COUNT}, 3); they have shape {points.shape}"
            )
        if points.shape[-2] != fingers:
            points = points.take(self.keypoints, axis=-2)
        # The sum of squares is the fastest test: lengths in metres do not overflow.
        if not math.isfinite(np.vdot(points, points)):
            raise GeortError("human points must be finite; at least one coordinate is NaN or infinite")
        return points

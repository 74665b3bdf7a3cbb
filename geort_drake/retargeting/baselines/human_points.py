"""Human fingertips out of what a retargeter is called with."""

from collections.abc import Sequence

import numpy as np

from geort_drake.errors import GeortError, UnknownNameError
from geort_drake.gloves.keypoints import TIP_KEYPOINT

KEYPOINT_COUNT = 21


class HumanPoints:
    """Checks points as `Retargeter` does, and takes the fingertips of whole hands."""

    def __init__(self, finger_names: Sequence[str], human_keypoints: Sequence[int] | None = None):
        """`human_keypoints` are the fingers' tips; None goes by the names.

        Raises:
            UnknownNameError: a finger's name has no keypoint.
        """
        if human_keypoints is None:
            for name in finger_names:
                if name not in TIP_KEYPOINT:
                    raise UnknownNameError("finger", name, TIP_KEYPOINT)
            human_keypoints = [TIP_KEYPOINT[name] for name in finger_names]
        self._fingers = len(finger_names)
        self._keypoints = np.array(human_keypoints, dtype=int)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Fingertips (F, 3) or (N, F, 3) of fingertips or whole hands (21, 3) or (N, 21, 3), m.

        Raises:
            ValueError: points have another shape.
            GeortError: a coordinate is not finite.
        """
        points = np.asarray(points, dtype=float)
        counts = (self._fingers, KEYPOINT_COUNT)
        if points.ndim not in (2, 3) or points.shape[-1] != 3 or points.shape[-2] not in counts:
            raise ValueError(
                f"human points must be ({self._fingers}, 3) fingertips or ({KEYPOINT_COUNT}, 3) keypoints, "
                f"or N of them; they have shape {points.shape}"
            )
        if not np.isfinite(points).all():
            raise GeortError("human points must be finite; at least one coordinate is NaN or infinite")
        return points if points.shape[-2] == self._fingers else points[..., self._keypoints, :]

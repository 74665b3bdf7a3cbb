"""The baselines by name."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geort_drake.errors import GeortError, UnknownNameError
from geort_drake.retargeting.methods.numpy_kinematics import NumpyKinematics
from geort_drake.retargeting.methods.online import DexPilotOnline, VectorOnline
from geort_drake.retargeting.methods.trivial import Hold, NearestNeighbour

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics

ONLINE: dict[str, type[VectorOnline]] = {"vector_online": VectorOnline, "dexpilot_online": DexPilotOnline}
# Those that need no training. `linear_offline` is trained and saved like GeoRT is.
BASELINES = ("hold", "nearest_neighbour", *ONLINE)


def make_baseline(
    name: str,
    kinematics: "HandKinematics | NumpyKinematics",
    human_keypoints: Sequence[int] | None = None,
    frames: np.ndarray | None = None,
    seed: int = 0,
    **settings: Any,
) -> Callable[[np.ndarray], np.ndarray]:
    """A retargeter that needs no training, called as `Retargeter` is.

    Args:
        name: one of `BASELINES`.
        kinematics: `HandKinematics` or `NumpyKinematics` of the robot hand, mirrored for a left one.
        human_keypoints: keypoint of each finger's tip; None goes by the fingers' names.
        frames: recorded fingertips (T, F, 3), m, which nearest_neighbour draws from by `seed`.
        seed: of that draw.
        settings: fields of the online methods' configuration.

    Raises:
        UnknownNameError: no such baseline.
        GeortError: a setting makes no sense, or frames are missing.
    """
    if name not in BASELINES:
        raise UnknownNameError("baseline", name, BASELINES)
    if name in ONLINE:
        method = ONLINE[name]
        known = method.config_type.__dataclass_fields__
        for setting in settings:
            if setting not in known:
                raise UnknownNameError(f"setting of {name}", setting, known)
        return method(kinematics, method.config_type(**settings), human_keypoints)
    if settings:
        raise GeortError(f"baseline '{name}' has no settings, given were {', '.join(settings)}")
    if name == "hold":
        return Hold(kinematics, human_keypoints)
    if frames is None:
        raise GeortError("baseline 'nearest_neighbour' needs recorded frames (T, F, 3) to store")
    return NearestNeighbour(kinematics, frames, seed=seed, human_keypoints=human_keypoints)

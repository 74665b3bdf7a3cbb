"""What a person makes of a scene: every look is noisy, and what is to be judged is looked at for a while."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.state import Seen


def perceive(scene: Seen, config: OperatorConfig, rng: np.random.Generator) -> Seen:
    """One look at a scene: fingertips, both poses and forces with noise, independent from look to look."""
    num_fingers = len(scene.p_WF)
    noise = rng.normal(0, config.visual_noise, (num_fingers + 2, 3))
    turns = Rotation.from_rotvec(rng.normal(0, config.visual_turn_noise, (2, 3))).as_matrix()
    share = 1 + rng.normal(0, config.contact_noise, num_fingers)
    X_WO, X_WB = (
        RigidTransform(RotationMatrix(turn) @ X.rotation(), X.translation() + shift)
        for X, turn, shift in zip((scene.X_WO, scene.X_WB), turns, noise[-2:], strict=True)
    )
    # However uncertain the force, a finger is not felt to pull.
    return Seen(scene.p_WF + noise[:-2], X_WB, X_WO, scene.contact * np.maximum(share, 0))


def judged(before: np.ndarray | None, now: np.ndarray, config: OperatorConfig) -> np.ndarray:
    """A quantity as it is judged: what is seen `now`, averaged over the last `judging_time` or so.

    Single looks are too noisy for the person's tolerances.

    Args:
        before: as it was judged one period ago; None at the first look.
    """
    if before is None:
        return now
    return before + config.period / (config.period + config.judging_time) * (now - before)

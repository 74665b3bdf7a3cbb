"""The fingertips of a hand that is part of a larger plant."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.hands.couplings import JointCouplings
from geort_drake.hands.description import HandDescription


class PlantFingertips:
    """Forward kinematics of a hand in a plant, as `HandModel.fingertips` without a plant of its own.

    Not thread-safe: the object owns the context it computes in.

    Args:
        plant: finalized.
        hand: the hand's model in it.
        joint_names: the description's n joints in the order of q.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        description: HandDescription,
        hand: ModelInstanceIndex,
        joint_names: Sequence[str],
    ):
        names = list(joint_names)
        self._columns = [names.index(name) for name in description.joint_names]
        self._couplings = JointCouplings.of(description)
        moving = [*description.joint_names, *self._couplings.names]
        self._order = [plant.GetJointByName(name, hand).position_start() for name in moving]
        self._plant, self._context = plant, plant.CreateDefaultContext()
        self._positions = plant.GetPositions(self._context).copy()
        self._base = plant.GetFrameByName(description.base_frame, hand)
        self._tips = [
            (plant.GetFrameByName(finger.tip_link, hand), np.array(finger.tip_point, float))
            for finger in description.fingers
        ]

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """p_BF (N, F, 3), m, at joint positions q (N, n), rad."""
        rows = self._couplings.followed_by(q[:, self._columns])
        p_BF = np.empty((len(rows), len(self._tips), 3))
        for row, tips in zip(rows, p_BF, strict=True):
            self._positions[self._order] = row
            self._plant.SetPositions(self._context, self._positions)
            for tip, (frame, point) in zip(tips, self._tips, strict=True):
                tip[:] = self._plant.CalcPointsPositions(self._context, frame, point, self._base)[:, 0]
        return p_BF

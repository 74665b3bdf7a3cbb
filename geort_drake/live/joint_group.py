"""The actuated joints of one model of a robot: names, limits and where they start."""

import dataclasses as dc

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.simulation.world import actuated_joints


@dc.dataclass(frozen=True, eq=False)
class JointGroup:
    """n joints in actuator order.

    Attributes:
        name: of the model.
        joints: by name.
        start, lower, upper: (n,) default positions and position limits, rad.
    """

    name: str
    joints: list[str]
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of_plant(cls, plant: MultibodyPlant, model: ModelInstanceIndex) -> "JointGroup":
        """Those of a model in a finalized plant."""
        joints = actuated_joints(plant, model)
        return cls(
            plant.GetModelInstanceName(model),
            [joint.name() for joint in joints],
            np.array([joint.default_positions()[0] for joint in joints]),
            np.array([joint.position_lower_limit() for joint in joints]),
            np.array([joint.position_upper_limit() for joint in joints]),
        )

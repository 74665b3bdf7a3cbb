"""Peg in hole: lift a dowel and insert it in a hole."""

from pathlib import Path
from typing import ClassVar

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.transfer_task import CarriedState, Steps, TransferTask

# Bottom of the left hole in W, whose mirror image is the right one, and depth of both, m: see scenario.yaml
# and models/sdf/peg_block.sdf.
_HOLE, _DEPTH = (0.45, 0.15, 0.030), 0.030
_TIP_HEIGHT = 0.105  # m above the lower end, so that the dowel hangs from its contacts


def _is_in(dowel: CarriedState, depth: float) -> bool:
    """Whether the dowel is in the hole, at least `depth` (m) deep, and did not fall beside the block."""
    return dowel.height < _DEPTH - depth and dowel.offset < 0.005


class PegTask(TransferTask):
    """Lift a dowel and insert it in a hole."""

    name = "peg"
    summary = "lift a dowel and insert it in a hole"
    scenario = Path(__file__).with_name("scenario.yaml"), "Peg"
    steps: ClassVar[Steps] = {
        "grasped": lambda dowel: dowel.touching >= 2,
        "lifted": lambda dowel: dowel.touching >= 2 and dowel.height > _DEPTH + 0.02,
        "carried": lambda dowel: dowel.touching >= 2 and dowel.height > _DEPTH and dowel.offset < 0.02,
        "entered": lambda dowel: _is_in(dowel, 0.005),
        "inserted": lambda dowel: _is_in(dowel, 0.020),
        "released": lambda dowel: _is_in(dowel, 0.020) and dowel.touching == 0,
    }
    hover = _DEPTH + 0.02
    upright = True

    def cases(self) -> list[str]:
        return ["dowel"]

    def place(self, scenario: Scenario, side: str, rng: np.random.Generator) -> RigidTransform:
        """Returns X_WP in the left hole for a left hand, in the right one for a right hand."""
        x, y, z = _HOLE
        return RigidTransform([x, y if side == "left" else -y, z])

    def plans(self, scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
        return GraspPlanner(scenario, description, "power", _TIP_HEIGHT).plans()


TASK = PegTask()

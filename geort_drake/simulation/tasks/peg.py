"""Peg in hole: lift a dowel and insert it in a hole."""

from pydrake.math import RigidTransform

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.transfer import ARM_POSTURE, CarriedState, Transfer

# Bottom of the left hole in W, whose mirror image is the right one, and depth of both, m: see SCENARIO and
# models/sdf/peg_block.sdf.
_HOLE, _DEPTH = (0.45, 0.15, 0.030), 0.030
_TIP_HEIGHT = 0.105  # m above the lower end, so that the dowel hangs from its contacts

SCENARIO = (
    ARM_POSTURE
    + """
kind: servo
timeout: 40.0
directives:
- add_directives:
    file: package://geort_drake/diagrams/bare_table.dmd.yaml
- add_model:
    name: peg_block
    file: package://geort_drake/models/sdf/peg_block.sdf
- add_weld:
    parent: world
    child: peg_block::peg_block
    X_PC:
      translation: [0.45, 0.0, 0.0]
object: {name: dowel, position: [0.45, 0.0], support_height: 0.06}
"""
)


def _is_in(dowel: CarriedState, depth: float) -> bool:
    """Whether the dowel is in the hole, at least `depth` (m) deep, and did not fall beside the block."""
    return dowel.height < _DEPTH - depth and dowel.offset < 0.005


def _hole(side: str) -> RigidTransform:
    """Returns X_WP in the left hole for a left hand, in the right one for a right hand."""
    x, y, z = _HOLE
    return RigidTransform([x, y if side == "left" else -y, z])


def _plans(scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
    X_WP = _hole(description.side)
    return GraspPlanner(scenario, description, "power", _TIP_HEIGHT, X_WP).plans()


TRANSFER = Transfer(
    steps={
        "grasped": lambda dowel: dowel.touching >= 2,
        "lifted": lambda dowel: dowel.touching >= 2 and dowel.height > _DEPTH + 0.02,
        "carried": lambda dowel: dowel.touching >= 2 and dowel.height > _DEPTH and dowel.offset < 0.02,
        "entered": lambda dowel: _is_in(dowel, 0.005),
        "inserted": lambda dowel: _is_in(dowel, 0.020),
        "released": lambda dowel: _is_in(dowel, 0.020) and dowel.touching == 0,
    },
    place=lambda scenario, side, rng: _hole(side),
    hover=_DEPTH + 0.02,
    upright=True,
)
TASK = TRANSFER.task(
    name="peg",
    summary="lift a dowel and insert it in a hole",
    scenario=SCENARIO,
    plans=_plans,
    objects=["dowel"],
)

"""Pick and place: lift a low block off the table and put it down at another place."""

import math

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.transfer import ARM_POSTURE, CarriedState, Transfer

HEIGHTS = {"block_20": 0.020, "block_25": 0.025, "block_30": 0.030}  # m
_MAX_ANGLE = math.radians(15)
# Distance of the place from the middle of the object's initial position, m; and ranges within which the place
# is drawn, m and rad.
_CARRY_DISTANCE, _POSITION_RANGE, _YAW_RANGE = 0.15, 0.02, 0.2
_MARK = np.array([0.20, 0.62, 0.35, 1.0])

SCENARIO = (
    ARM_POSTURE
    + """
kind: servo
timeout: 30.0
directives: [{add_directives: {file: package://geort_drake/diagrams/bare_table.dmd.yaml}}]
object: {name: block_20, position: [0.45, 0.0], support_height: 0.0, yaw_range: 0.2}
"""
)


def _is_placed(block: CarriedState) -> bool:
    return block.height < 0.003 and block.offset < 0.010 and max(abs(block.turn), block.tilt) < _MAX_ANGLE


def _middle_place(scenario: Scenario, side: str) -> RigidTransform:
    """Returns X_WP in the middle of its range."""
    x, y = scenario.object.position
    z = scenario.object.support_height + HEIGHTS[scenario.object.name] / 2
    return RigidTransform([x, y + (_CARRY_DISTANCE if side == "left" else -_CARRY_DISTANCE), z])


def _place(scenario: Scenario, side: str, rng: np.random.Generator) -> RigidTransform:
    dx, dy = rng.uniform(-_POSITION_RANGE, _POSITION_RANGE, 2)
    yaw = rng.uniform(-_YAW_RANGE, _YAW_RANGE)
    X_PmP = RigidTransform(RotationMatrix.MakeZRotation(yaw), [dx, dy, 0.0])
    return _middle_place(scenario, side) @ X_PmP


def _draw_place(plant: MultibodyPlant, X_WP: RigidTransform) -> None:
    """Draws a mark at the place; it has no collision geometry."""
    X_WMark = RigidTransform(X_WP.rotation(), X_WP.translation() * [1, 1, 0])
    plant.RegisterVisualGeometry(plant.world_body(), X_WMark, Box(0.03, 0.03, 0.0008), "place", _MARK)


def _plans(scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
    # Above the middle, so that the block hangs, and with at least 4 mm between tips and table.
    radius = max(finger.tip_radius for finger in description.fingers)
    tip_height = max(0.75 * HEIGHTS[scenario.object.name], radius + 0.004)
    X_WP = _middle_place(scenario, description.side)
    return GraspPlanner(scenario, description, "pinch", tip_height, X_WP).plans()


TRANSFER = Transfer(
    steps={
        "grasped": lambda block: block.touching >= 2,
        "lifted": lambda block: block.touching >= 2 and block.height > 0.08,
        "carried": lambda block: block.touching >= 2 and block.height > 0.003 and block.offset < 0.03,
        "placed": _is_placed,
        "released": lambda block: _is_placed(block) and block.touching == 0,
    },
    place=_place,
    hover=0.02,
    upright=False,
    add_fixtures=_draw_place,
)
TASK = TRANSFER.task(
    name="pick_place",
    summary="lift a low block off the table and put it down at another place",
    scenario=SCENARIO,
    plans=_plans,
    objects=list(HEIGHTS),
)

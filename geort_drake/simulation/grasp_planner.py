"""Finds where the robot hand should be and touch to grasp an object.

The planner knows the object's shape, the robot and the surroundings, and nothing of retargeting. It
places contacts by the object's shape, then solves inverse kinematics for arm and hand together
(Drake's `InverseKinematics`) from several yaws and keeps the most comfortable solution.
"""

import dataclasses as dc
import itertools
import math

import numpy as np
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    Ellipsoid,
    GeometrySet,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.solvers import SnoptSolver, SolverOptions
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.operators.grasp_goal import GraspGoal
from geort_drake.simulation.object_shape import ObjectShape, object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_object, add_robot, standing_pose

# A tripod: the thumb opposes index and middle, which stand this far to either side of the axis.
_SPREAD = math.radians(28)
# Starting points for the solver at each yaw: first the nominal posture, then disturbed ones.
_STARTS = 3
# Objects taller than this are first tried above their middle, m.
_TALL = 0.07
# Clearance of everything but the touching fingertips, m.
_CLEARANCE = 0.004
# How far the hand stays back before the approach, and how far the fingers open, m.
_RETREAT = 0.08
_OPENING = 0.025


@dc.dataclass(frozen=True)
class Contact:
    """Where a finger shall touch: a surface point and the inward normal, in O, m."""

    finger: str
    p_OC: np.ndarray
    n_O: np.ndarray


def tripod_contacts(shape: ObjectShape, yaw: float, height: float = 0.5) -> list[Contact]:
    """Thumb against index and middle around the vertical at `yaw`, on the object's main part.

    Args:
        yaw: direction of the grasp's axis from the thumb to the fingers, rad.
        height: of the contacts, as a share of the object's height.
    """
    main, X_OG = shape.main
    bottom, top = vertical_extent(shape)
    z = bottom + height * (top - bottom)
    contacts = []
    for finger, angle in (("thumb", math.pi), ("index", _SPREAD), ("middle", -_SPREAD)):
        direction = np.array([math.cos(yaw + angle), math.sin(yaw + angle), 0.0])
        if isinstance(main, Box):
            p, outward = _on_box(main.size() / 2, X_OG, direction, yaw, z)
        else:
            p, outward = direction * _radius_at(main, z - X_OG.translation()[2]), direction
            p = p + X_OG.translation() * [1, 1, 0]
        contacts.append(Contact(finger, np.array([p[0], p[1], z]), -outward))
    return contacts


def vertical_extent(shape: ObjectShape) -> tuple[float, float]:
    """Lowest and highest z of the upright object in O, m."""
    upside_down = RigidTransform(RotationMatrix.MakeXRotation(math.pi), np.zeros(3))
    return shape.lowest_point(RigidTransform()), -shape.lowest_point(upside_down)


def _radius_at(shape, z: float) -> float:
    """Radius of a round shape at the height z over its centre."""
    if hasattr(shape, "length"):
        return shape.radius()
    return math.sqrt(max(shape.radius() ** 2 - z**2, 0.0))


def _on_box(half: np.ndarray, X_OG: RigidTransform, direction: np.ndarray, yaw: float, z: float):
    """The side of a box that faces along the grasp's axis, and the point on it under `direction`."""
    axis = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    side = axis if direction @ axis > 0 else -axis
    lateral = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    depth = float(np.abs(side) @ half)
    width = float(np.abs(lateral) @ half)
    # Neighbouring fingertips need room beside each other even on a narrow side.
    offset = float(np.clip(depth * (direction @ lateral) / abs(direction @ axis), -width, width))
    offset = 0.0 if abs(direction @ lateral) < 1e-9 else math.copysign(max(abs(offset), 0.014), offset)
    return X_OG.translation() + depth * side + offset * lateral, side


def contact_heights(shape: ObjectShape) -> tuple[float, ...]:
    """Heights to try for the contacts, best first, as shares of the object's height."""
    if isinstance(shape.main[0], Sphere | Ellipsoid):
        return (0.5,)  # elsewhere the surface is not upright
    bottom, top = vertical_extent(shape)
    return (0.6, 0.5, 0.7) if top - bottom > _TALL else (0.5, 0.6, 0.7)


def yaw_candidates(shape: ObjectShape) -> tuple[list[float], float]:
    """Yaws to try for the grasp's axis, and the object's own yaw symmetry (0: full)."""
    main, _ = shape.main
    if isinstance(main, Box):
        square = math.isclose(main.width(), main.depth(), rel_tol=0.02)
        yaws = [0.0, math.pi / 2, math.pi, -math.pi / 2] if square else [0.0, math.pi]
        if not square and main.width() > main.depth():
            yaws = [math.pi / 2, -math.pi / 2]
        return yaws, math.pi / 2 if square else math.pi
    return [math.radians(a) for a in range(-180, 180, 30)], 0.0


def _options() -> SolverOptions:
    # A solution takes some 50 iterations; a start that needs many more rarely leads to one.
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major iterations limit", 150)
    return options


class GraspPlanner:
    """Plans grasps of one object with the scenario's robot.

    Raises:
        ScenarioError: the hand lacks a thumb, index or middle finger.
    """

    def __init__(self, scenario: Scenario, description: HandDescription):
        names = [finger.name for finger in description.fingers]
        for needed in ("thumb", "index", "middle"):
            if needed not in names:
                raise ScenarioError(
                    f"a tripod grasp needs a {needed}; hand '{description.name}' has: {', '.join(names)}"
                )
        self._description = description
        self._scenario = scenario
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_robot(plant, scenario, description)
        self._object = add_object(plant, scenario.object.name)
        # The object's frame is placed once its geometry is known, through a fixed joint's offset frame.
        self._shape = object_shape(plant, scene_graph.model_inspector(), self._object)
        self._X_WO = standing_pose(scenario, self._shape.lowest_point(RigidTransform()), 0, 0, 0)
        plant.WeldFrames(plant.world_frame(), self._object.body_frame(), self._X_WO)
        plant.Finalize()
        self._plant = plant
        self._allow_tips_to_touch(plant, scene_graph)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = plant.GetMyMutableContextFromRoot(self._context)
        # Solving leaves its last iterate in the context, so the default posture is kept apart.
        self._q_default = plant.GetPositions(self._plant_context).copy()

    @property
    def shape(self) -> ObjectShape:
        """The object's shape."""
        return self._shape

    def plan(self) -> GraspGoal:
        """The most comfortable tripod grasp.

        Raises:
            ScenarioError: no yaw has a solution.
        """
        yaws, symmetry = yaw_candidates(self._shape)
        best: tuple[float, list[Contact], np.ndarray] | None = None
        # Other heights and starts are only tried where the first ones lead nowhere.
        for height, start in itertools.product(contact_heights(self._shape), range(_STARTS)):
            for yaw in yaws:
                contacts = tripod_contacts(self._shape, yaw, height)
                solution = self._solve(contacts, start)
                if solution is not None and (best is None or solution[0] < best[0]):
                    best = (solution[0], contacts, solution[1])
            if best is not None:
                break
        if best is None:
            raise ScenarioError(
                f"the robot cannot grasp object '{self._scenario.object.name}' at "
                f"{self._scenario.object.position}: no collision-free tripod grasp was found"
            )
        return self._goal(best[1], best[2], symmetry)

    def _allow_tips_to_touch(self, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        inspector = scene_graph.model_inspector()
        hand = plant.GetModelInstanceByName(HAND)
        tips = []
        for finger in self._description.fingers:
            frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName(finger.tip_link, hand).index())
            for geometry in inspector.GetGeometries(frame, Role.kProximity):
                gap = np.linalg.norm(inspector.GetPoseInFrame(geometry).translation() - finger.tip_point)
                if gap <= finger.tip_radius:
                    tips.append(geometry)
        thing = plant.GetBodyFrameIdOrThrow(self._object.index())
        declaration = CollisionFilterDeclaration()
        declaration.ExcludeBetween(
            GeometrySet(tips), GeometrySet(inspector.GetGeometries(thing, Role.kProximity))
        )
        scene_graph.collision_filter_manager().Apply(declaration)

    def _solve(self, contacts: list[Contact], start: int) -> tuple[float, np.ndarray] | None:
        plant, description = self._plant, self._description
        hand = plant.GetModelInstanceByName(HAND)
        arm = plant.GetModelInstanceByName(ARM)
        ik = InverseKinematics(plant, self._plant_context)
        program, q = ik.get_mutable_prog(), ik.q()
        for contact in contacts:
            finger = next(f for f in description.fingers if f.name == contact.finger)
            p_OF = contact.p_OC - contact.n_O * finger.tip_radius
            ik.AddPositionConstraint(
                plant.GetBodyByName(finger.tip_link, hand).body_frame(),
                np.asarray(finger.tip_point, float),
                self._object.body_frame(),
                p_OF - 0.001,
                p_OF + 0.001,
            )
        ik.AddMinimumDistanceLowerBoundConstraint(_CLEARANCE, 0.02)
        q_nominal = self._q_default.copy()
        low, high = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        weight = np.ones(len(q_nominal))
        touching = {contact.finger for contact in contacts}
        for finger in description.fingers:
            for name in finger.joints:
                index = plant.GetJointByName(name, hand).position_start()
                # A grasping joint is most useful in its middle range, with room left to squeeze.
                if finger.name in touching:
                    q_nominal[index] = 0.5 * (low[index] + high[index])
                    margin = 0.1 * (high[index] - low[index])
                    program.AddBoundingBoxConstraint(low[index] + margin, high[index] - margin, q[index])
                else:
                    weight[index] = 10.0
        for index in plant.GetJointIndices(arm):
            joint = plant.get_joint(index)
            if joint.num_positions():
                weight[joint.position_start()] = 0.5
        program.AddQuadraticErrorCost(np.diag(weight), q_nominal, q)
        disturbance = np.random.default_rng(start).normal(0, 0.3, len(q_nominal)) if start else 0.0
        guess = np.clip(q_nominal + disturbance, low, high)
        result = SnoptSolver().Solve(program, guess, _options())
        return (result.get_optimal_cost(), result.GetSolution(q)) if result.is_success() else None

    def _goal(self, contacts: list[Contact], q: np.ndarray, symmetry: float) -> GraspGoal:
        plant, description = self._plant, self._description
        hand = plant.GetModelInstanceByName(HAND)
        plant.SetPositions(self._plant_context, q)
        X_WB = plant.GetFrameByName(description.base_frame, hand).CalcPoseInWorld(self._plant_context)
        X_OB = self._X_WO.inverse() @ X_WB
        by_finger = {contact.finger: contact for contact in contacts}
        touches, p_OF, n_O = [], [], []
        for finger in description.fingers:
            body = plant.GetBodyByName(finger.tip_link, hand)
            p_WF = body.EvalPoseInWorld(self._plant_context) @ np.asarray(finger.tip_point, float)
            contact = by_finger.get(finger.name)
            touches.append(contact is not None)
            p_OF.append(self._X_WO.inverse() @ p_WF)
            n_O.append(contact.n_O if contact else np.zeros(3))
        p_OF_touch, n_OF = np.array(p_OF), np.array(n_O)
        p_BF_open = X_OB.inverse().multiply((p_OF_touch - _OPENING * n_OF).T).T
        before = X_OB @ RigidTransform([-_RETREAT, 0, 0])
        return GraspGoal(
            finger_names=tuple(finger.name for finger in description.fingers),
            touches=np.array(touches),
            X_OB=X_OB,
            X_OB_before=before,
            p_BF_open=p_BF_open,
            p_OF_touch=p_OF_touch,
            n_OF=n_OF,
            yaw_symmetry=symmetry,
        )

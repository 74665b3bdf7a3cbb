"""Finds where the robot hand should be and touch to grasp an object.

The planner knows the object's shape, the robot and the surroundings, and nothing of retargeting. It
places contacts by the object's shape, then solves inverse kinematics for arm and hand together
(Drake's `InverseKinematics`) from several yaws and keeps the most comfortable solution.
"""

import itertools

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.solvers import SnoptSolver, SolverOptions
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import FingerDescription, HandDescription
from geort_drake.operators.grasp_goal import GraspGoal
from geort_drake.simulation.grasp_contacts import (
    GRIPS,
    Contact,
    contact_heights,
    grip_contacts,
    yaw_candidates,
)
from geort_drake.simulation.object_shape import ObjectShape, object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_object, add_robot, standing_pose

# Starting points for the solver at each yaw: first the nominal posture, then disturbed ones.
_STARTS = 3
# Clearance of everything but the fingertips from each other and from the object, m. The hand's own links
# come nearer to each other than a few millimetres by design.
_CLEARANCE = 0.004
_OPEN_CLEARANCE = 0.003
# Least gap between two fingertips on the object, m.
_TIP_GAP = 0.002
# Further room between the hand and what the object stands on, m: a hand that is not quite where or how it
# should be must not meet it.
_GROUND_CLEARANCE = 0.006
# Part of its range that a grasping joint keeps from either limit, to have room to squeeze.
_LIMIT_MARGIN = 0.1
# Weight of the arm's joints in the comfort of a posture; a grasping finger's joints weigh 1.
_ARM_WEIGHT = 0.5
# How far the hand stays back before the approach, and how far the fingers open, m.
_RETREAT = 0.08
_OPENING = 0.025


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
        # The object is sunk into its support, which keeps the hand that much further above it.
        bottom = self._shape.lowest_point(RigidTransform())
        self._X_WO = standing_pose(scenario, bottom + _GROUND_CLEARANCE, 0, 0, 0)
        plant.WeldFrames(plant.world_frame(), self._object.body_frame(), self._X_WO)
        plant.Finalize()
        self._plant = plant
        self._arm, self._hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
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
        """The most comfortable grasp: a tripod or, where there is none, a pinch of thumb and index.

        Raises:
            ScenarioError: no yaw has a solution.
        """
        yaws, symmetry = yaw_candidates(self._shape)
        best: tuple[float, list[Contact], np.ndarray] | None = None
        # Other grips, heights and starts are only tried where the first ones lead nowhere.
        heights = contact_heights(self._shape)
        for grip, start, height in itertools.product(GRIPS, range(_STARTS), heights):
            for yaw in yaws:
                contacts = grip_contacts(self._shape, yaw, height, grip)
                if not self._room_for_tips(contacts):
                    continue
                solution = self._solve(contacts, start)
                if solution is not None and (best is None or solution[0] < best[0]):
                    best = (solution[0], contacts, solution[1])
            if best is not None:
                break
        if best is None:
            raise ScenarioError(
                f"the robot cannot grasp object '{self._scenario.object.name}' at "
                f"{self._scenario.object.position}: no collision-free {' or '.join(GRIPS)} was found"
            )
        return self._goal(best[1], best[2], symmetry)

    def _allow_tips_to_touch(self, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        inspector = scene_graph.model_inspector()
        tips = []
        for finger in self._description.fingers:
            frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName(finger.tip_link, self._hand).index())
            for geometry in inspector.GetGeometries(frame, Role.kProximity):
                gap = np.linalg.norm(inspector.GetPoseInFrame(geometry).translation() - finger.tip_point)
                if gap <= finger.tip_radius:
                    tips.append(geometry)
        thing = plant.GetBodyFrameIdOrThrow(self._object.index())
        declaration = CollisionFilterDeclaration()
        declaration.ExcludeWithin(GeometrySet(tips))
        declaration.ExcludeBetween(
            GeometrySet(tips), GeometrySet(inspector.GetGeometries(thing, Role.kProximity))
        )
        scene_graph.collision_filter_manager().Apply(declaration)

    def _solve(self, contacts: list[Contact], start: int) -> tuple[float, np.ndarray] | None:
        """Cost and positions of a comfortable grasp from which the hand can also open; None if none."""
        plant = self._plant
        ik, q_nominal, low, high = self._inverse_kinematics(contacts, _CLEARANCE, 0.0, 0.001)
        program, q = ik.get_mutable_prog(), ik.q()
        for finger in self._fingers(contacts):
            for name in finger.joints:
                index = plant.GetJointByName(name, self._hand).position_start()
                margin = _LIMIT_MARGIN * (high[index] - low[index])
                program.AddBoundingBoxConstraint(low[index] + margin, high[index] - margin, q[index])
        disturbance = np.random.default_rng(start).normal(0, 0.3, len(q_nominal)) if start else 0.0
        guess = np.clip(q_nominal + disturbance, low, high)
        result = SnoptSolver().Solve(program, guess, _options())
        if not result.is_success():
            return None
        q_touch = result.GetSolution(q)
        return None if self._open(contacts, q_touch) is None else (result.get_optimal_cost(), q_touch)

    def _open(self, contacts: list[Contact], q_touch: np.ndarray) -> np.ndarray | None:
        """Positions with the fingers opened around the object, the arm as at q_touch; None if none."""
        ik, *_ = self._inverse_kinematics(contacts, _OPEN_CLEARANCE, _OPENING, 0.005)
        program, q = ik.get_mutable_prog(), ik.q()
        arm = [
            self._plant.get_joint(index).position_start()
            for index in self._plant.GetJointIndices(self._arm)
            if self._plant.get_joint(index).num_positions()
        ]
        program.AddBoundingBoxConstraint(q_touch[arm], q_touch[arm], q[arm])
        result = SnoptSolver().Solve(program, q_touch, _options())
        return result.GetSolution(q) if result.is_success() else None

    def _inverse_kinematics(
        self, contacts: list[Contact], clearance: float, opening: float, tolerance: float
    ) -> tuple[InverseKinematics, np.ndarray, np.ndarray, np.ndarray]:
        """Fingertips `opening` off their contacts, all else clear, near a comfortable posture.

        Returns:
            The program, the comfortable posture, and the position limits.
        """
        plant = self._plant
        ik = InverseKinematics(plant, self._plant_context)
        for contact, finger in zip(contacts, self._fingers(contacts), strict=True):
            p_OF = contact.p_OC - contact.n_O * (finger.tip_radius + opening)
            ik.AddPositionConstraint(
                plant.GetBodyByName(finger.tip_link, self._hand).body_frame(),
                np.asarray(finger.tip_point, float),
                self._object.body_frame(),
                p_OF - tolerance,
                p_OF + tolerance,
            )
        ik.AddMinimumDistanceLowerBoundConstraint(clearance, 0.02)
        q_nominal = self._q_default.copy()
        low, high = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        weight = np.full(len(q_nominal), _ARM_WEIGHT)
        touching = {contact.finger for contact in contacts}
        for finger in self._description.fingers:
            for name in finger.joints:
                index = plant.GetJointByName(name, self._hand).position_start()
                # A grasping joint is most useful in its middle range; the others stay out of the way.
                weight[index] = 1.0 if finger.name in touching else 10.0
                if finger.name in touching:
                    q_nominal[index] = 0.5 * (low[index] + high[index])
        ik.get_mutable_prog().AddQuadraticErrorCost(np.diag(weight), q_nominal, ik.q())
        return ik, q_nominal, low, high

    def _room_for_tips(self, contacts: list[Contact]) -> bool:
        """Whether the fingertips at these contacts would be clear of each other."""
        tips = [
            (contact.p_OC - contact.n_O * finger.tip_radius, finger.tip_radius)
            for contact, finger in zip(contacts, self._fingers(contacts), strict=True)
        ]
        return all(
            np.linalg.norm(p - other_p) > r + other_r + _TIP_GAP
            for (p, r), (other_p, other_r) in itertools.combinations(tips, 2)
        )

    def _fingers(self, contacts: list[Contact]) -> list[FingerDescription]:
        by_name = {finger.name: finger for finger in self._description.fingers}
        return [by_name[contact.finger] for contact in contacts]

    def _goal(self, contacts: list[Contact], q: np.ndarray, symmetry: float) -> GraspGoal:
        plant, description = self._plant, self._description
        plant.SetPositions(self._plant_context, q)
        X_WB = plant.GetFrameByName(description.base_frame, self._hand).CalcPoseInWorld(self._plant_context)
        X_OB = self._X_WO.inverse() @ X_WB
        by_finger = {contact.finger: contact for contact in contacts}
        touches, p_OF, n_O = [], [], []
        for finger in description.fingers:
            body = plant.GetBodyByName(finger.tip_link, self._hand)
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

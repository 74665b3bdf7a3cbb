"""Inverse kinematics of a grasp, for arm and hand in a plant with a fixed object."""

import functools

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Role, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import UniformGravityFieldElement
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.hands.assembly import HandInPlant
from geort_drake.hands.description import HandDescription
from geort_drake.hands.geometry import parts_of
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.plan.contacts import Contact
from geort_drake.simulation.plan.inverse_kinematics import TipKinematics, solve
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_object, add_robot, standing_pose

# Clearance between all bodies except the grasping fingertips, m. Some of the hand's own links are never
# further apart than a few millimetres.
_CLEARANCE = 0.002
# Additional clearance between the hand and the object's support, m, for a hand that misses its pose. The
# choice of contacts keeps fingertips above the support.
_GROUND_CLEARANCE = 0.006
# Tolerances of the fingertips' positions, m: touching, and open.
_TOLERANCE, _OPEN_TOLERANCE = 0.001, 0.008
# Tolerance of the hand's orientation where it brings the object, rad.
_TURN_TOLERANCE = 0.01
# Range of the object's contact on the palm before the fingers close, in B, m: gap, sideways, and along the
# fingers, relative to the knuckles; and the palm's largest tilt, rad.
_PALM_GAP = (0.002, 0.006)
_PALM_Y = (-0.015, 0.015)
_PALM_Z = (-0.06, 0.0)
_PALM_TILT = 0.25
# Weights in the discomfort of a posture: for the arm's joints, and for joints of idle fingers. Joints of
# grasping fingers have weight 1.
_ARM_WEIGHT = 0.5
_IDLE_WEIGHT = 10.0


class GraspKinematics:
    """Finds postures of the scenario's robot in which fingertips are at given contacts on the object.

    Frames: W the world, O the object, B the hand base, F a fingertip point. The object stands at the
    scenario's position with zero yaw.

    Args:
        fingers: names of the grasping fingers; only their tips may touch the object.
    """

    def __init__(self, scenario: Scenario, description: HandDescription, fingers: list[str]):
        self._description = description
        self._grasping = [finger for finger in description.fingers if finger.name in fingers]
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_robot(plant, scenario, description)
        self._object = add_object(plant, scenario.object.name)
        self.shape = ObjectShape(plant, scene_graph.model_inspector(), self._object)
        # Of the object, N.
        self.weight = self._object.default_mass() * UniformGravityFieldElement.kDefaultStrength
        # The object is sunk into its support by the ground clearance.
        bottom = self.shape.lowest_point(RigidTransform())
        self._X_WO = standing_pose(scenario, bottom + _GROUND_CLEARANCE)
        plant.WeldFrames(plant.world_frame(), self._object.body_frame(), self._X_WO)
        plant.Finalize()
        self._plant = plant
        self._hand = plant.GetModelInstanceByName(HAND)
        self._base = plant.GetFrameByName(description.base_frame, self._hand)
        arm = map(plant.get_joint, plant.GetJointIndices(plant.GetModelInstanceByName(ARM)))
        self._arm = [joint.position_start() for joint in arm if joint.num_positions()]
        self._knuckles = self._find_knuckles()
        self._palm_front = self._find_palm_front(scene_graph)
        self._allow_tip_contacts(scene_graph)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = plant.GetMyMutableContextFromRoot(self._context)
        self._tips = TipKinematics(plant, self._plant_context, description, self._hand)
        # Solving leaves its last iterate in the context.
        self.q_default = plant.GetPositions(self._plant_context).copy()
        self.q_middle = self._centred_positions()
        self._ignore_links_close_at_rest()

    def touch(
        self, contacts: list[Contact], guess: np.ndarray, collisions: bool = True
    ) -> tuple[float, np.ndarray] | None:
        """Finds the most comfortable posture near `guess` in which the fingertips touch.

        Args:
            contacts: one for each grasping finger, and perhaps the palm's.
            guess: initial positions of the plant.
            collisions: whether to avoid collisions, which takes a hundred times as long.

        Returns:
            The posture's discomfort and the positions of the plant, or None.
        """
        ik = self._program(contacts, 0.0, _TOLERANCE)
        for palm in contacts[len(self._grasping) :]:
            self._constrain_palm(ik, palm)
        if collisions:
            ik.AddMinimumDistanceLowerBoundConstraint(_CLEARANCE, 0.02)
        self._tips.keep_from_limits(ik, [name for finger in self._grasping for name in finger.joints])
        return solve(ik, np.clip(guess, self._tips.low, self._tips.high))

    def open(self, contacts: list[Contact], opening: float, q_touch: np.ndarray) -> np.ndarray | None:
        """Returns positions with tips `opening` (m) off the contacts and the arm as in q_touch, or None."""
        ik = self._program(contacts, opening, _OPEN_TOLERANCE)
        ik.AddMinimumDistanceLowerBoundConstraint(_CLEARANCE, 0.02)
        q_arm = q_touch[self._arm]
        ik.get_mutable_prog().AddBoundingBoxConstraint(q_arm, q_arm, ik.q()[self._arm])
        solution = solve(ik, q_touch)
        return None if solution is None else solution[1]

    def open_wide(self, q_touch: np.ndarray) -> np.ndarray | None:
        """Returns positions with the hand at its default, the arm as in q_touch; None in collision."""
        q = self.q_default.copy()
        q[self._arm] = q_touch[self._arm]
        return None if self._collides(q) else q

    def open_thumbs(self, q_touch: np.ndarray, number: int) -> list[np.ndarray]:
        """Returns positions as `open_wide`, but with the thumb at different places; none in collision.

        Of the `number` places, the first is the default one, and the others are random. Those nearest to the
        touching thumb come first.
        """
        thumb = self._description.finger_names.index("thumb")
        joints = [self._tips.index[name] for name in self._description.fingers[thumb].joints]
        low, high = self._tips.low[joints], self._tips.high[joints]
        q = np.tile(self.q_default, (number, 1))
        q[:, self._arm] = q_touch[self._arm]
        q[1:, joints] = np.random.default_rng(0).uniform(low, high, (number - 1, len(joints)))
        self._let_follow(q)
        p_OT = self.fingertips(q_touch)[thumb]
        nearest = np.argsort([np.linalg.norm(self.fingertips(one)[thumb] - p_OT) for one in q])
        return [one for one in q[nearest] if not self._collides(one)]

    def reaches(self, X_WB: RigidTransform, q_touch: np.ndarray) -> bool:
        """Whether the arm can bring the hand to X_WB with the fingers as in q_touch, clear of all else.

        The hand has taken the object along, so its place here does not matter.
        """
        context = self._plant.GetMyMutableContextFromRoot(self._root_without_object)
        ik = InverseKinematics(self._plant, context)
        world, R = self._plant.world_frame(), X_WB.rotation()
        near = np.full(3, _TOLERANCE)
        p_WB = X_WB.translation()
        ik.AddPositionConstraint(self._base, np.zeros(3), world, p_WB - near, p_WB + near)
        ik.AddOrientationConstraint(world, R, self._base, RotationMatrix(), _TURN_TOLERANCE)
        ik.AddMinimumDistanceLowerBoundConstraint(_CLEARANCE, 0.02)
        others = np.setdiff1d(np.arange(len(q_touch)), self._arm)
        ik.get_mutable_prog().AddBoundingBoxConstraint(q_touch[others], q_touch[others], ik.q()[others])
        ik.get_mutable_prog().AddQuadraticErrorCost(np.eye(len(q_touch)), q_touch, ik.q())
        return solve(ik, q_touch) is not None

    def _collides(self, q: np.ndarray) -> bool:
        """Whether anything collides at the plant's positions q."""
        self._plant.SetPositions(self._plant_context, q)
        query = self._plant.get_geometry_query_input_port().Eval(self._plant_context)
        return query.HasCollisions()

    def hand_pose(self, q: np.ndarray) -> RigidTransform:
        """Returns X_OB at the plant's positions q."""
        self._plant.SetPositions(self._plant_context, q)
        return self._X_WO.inverse() @ self._base.CalcPoseInWorld(self._plant_context)

    def fingertips(self, q: np.ndarray) -> np.ndarray:
        """Returns p_OF (F, 3) of all fingertips at the plant's positions q, m."""
        self._plant.SetPositions(self._plant_context, q)
        p_WF = [
            self._plant.GetBodyByName(finger.tip_link, self._hand).EvalPoseInWorld(self._plant_context)
            @ np.asarray(finger.tip_point, float)
            for finger in self._description.fingers
        ]
        return self._X_WO.inverse().multiply(np.array(p_WF).T).T

    def joint_positions(self, q: np.ndarray) -> dict[str, float]:
        """Returns the plant's positions q by joint name, rad."""
        joints = map(self._plant.get_joint, self._plant.GetJointIndices())
        return {joint.name(): q[joint.position_start()] for joint in joints if joint.num_positions()}

    def _program(self, contacts: list[Contact], opening: float, tolerance: float) -> InverseKinematics:
        """Returns a program with fingertips `opening` (m) off their contacts and discomfort as cost."""
        by_finger = {contact.part: contact for contact in contacts}
        places = {}
        for finger in self._grasping:
            contact = by_finger[finger.name]
            p_OF = contact.p_OC - contact.n_O * (finger.tip_radius + opening)
            # No tolerance downwards, where the support is.
            places[finger.name] = p_OF - np.array([tolerance, tolerance, 0.0]), p_OF + tolerance
        weight = np.full(len(self.q_default), _ARM_WEIGHT)
        for finger in self._description.fingers:
            for name in finger.joints:
                weight[self._tips.index[name]] = 1.0 if finger in self._grasping else _IDLE_WEIGHT
        # A grasping joint is most comfortable in the middle of its range.
        return self._tips.program(self._object.body_frame(), places, weight, self.q_middle)

    def _centred_positions(self) -> np.ndarray:
        """Returns the default positions with grasping joints in the middle of their ranges."""
        q, tips = self.q_default.copy(), self._tips
        joints = [tips.index[name] for finger in self._grasping for name in finger.joints]
        q[joints] = 0.5 * (tips.low[joints] + tips.high[joints])
        self._let_follow(q)
        return q

    def _let_follow(self, q: np.ndarray) -> None:
        """Sets the followers in positions (..., q) from their leaders."""
        for c in self._description.followers:
            q[..., self._tips.index[c.joint]] = c.ratio * q[..., self._tips.index[c.follows]] + c.offset

    def _constrain_palm(self, ik: InverseKinematics, palm: Contact) -> None:
        """Constrains the palm to face the object at the contact, index finger up."""
        low, high = zip(_PALM_GAP, _PALM_Y, _PALM_Z, strict=True)
        front = np.array([self._palm_front, 0.0, self._knuckles[:, 2].mean()])
        ik.AddPositionConstraint(
            self._object.body_frame(), palm.p_OC, self._base, front + np.array(low), front + np.array(high)
        )
        to_index = [0, -1.0 if self._description.side == "left" else 1.0, 0]
        for v_O, v_B in ((palm.n_O, [1.0, 0, 0]), ([0, 0, 1.0], to_index)):
            ik.AddAngleBetweenVectorsConstraint(
                self._object.body_frame(), np.asarray(v_O), self._base, np.asarray(v_B), 0.0, _PALM_TILT
            )

    @property
    def finger_spacing(self) -> float:
        """Distance of the knuckles of adjacent grasping fingers, without the thumb, m; 0 for one finger."""
        first, last = self._knuckles[[0, -1]]
        return float(np.linalg.norm(last - first)) / max(len(self._knuckles) - 1, 1)

    def _find_knuckles(self) -> np.ndarray:
        """Returns the first joints' positions in B of the grasping fingers except the thumb, (N, 3) m."""
        context = self._plant.CreateDefaultContext()
        first = [finger.joints[0] for finger in self._grasping if finger.name != "thumb"]
        frames = [self._plant.GetJointByName(name, self._hand).frame_on_parent() for name in first]
        return np.array([frame.CalcPose(context, self._base).translation() for frame in frames])

    def _find_palm_front(self, scene_graph: SceneGraph) -> float:
        """Returns the largest x in B of the palm's collision geometry within the contact range, m.

        The range excludes a forearm behind the palm.
        """
        low, high = np.array(_PALM_Z) + self._knuckles[:, 2].mean()
        fronts = []
        palm = HandInPlant(self._plant, self._description, self._hand).palm_links()
        for *_, p_BP in parts_of(self._plant, scene_graph, palm, Role.kProximity, self._base):
            if p_BP[:, 2].min() < high and p_BP[:, 2].max() > low:
                fronts.append(p_BP[:, 0].max())
        return max(fronts, default=0.0)

    def _allow_tip_contacts(self, scene_graph: SceneGraph) -> None:
        """Filters collisions of grasping fingertips with each other, the object and its support."""
        hand = HandInPlant(self._plant, self._description, self._hand)
        tips = hand.tip_geometries(scene_graph.model_inspector(), self._grasping)
        # The object and its support are welded to the world.
        fixed = [
            geometry
            for body in self._plant.GetBodiesWeldedTo(self._plant.world_body())
            for geometry in self._plant.GetCollisionGeometriesForBody(body)
        ]
        declaration = CollisionFilterDeclaration()
        declaration.ExcludeWithin(GeometrySet(tips))
        declaration.ExcludeBetween(GeometrySet(tips), GeometrySet(fixed))
        scene_graph.collision_filter_manager().Apply(declaration)

    def _ignore_links_close_at_rest(self) -> None:
        """Filters pairs of the hand's own shapes that are closer than the clearance in its default posture.

        Convex hulls of some hands overlap; no posture would be clear of such pairs.
        """
        links = map(self._plant.get_body, self._plant.GetBodyIndices(self._hand))
        shapes = {geometry for link in links for geometry in self._plant.GetCollisionGeometriesForBody(link)}
        query = self._plant.get_geometry_query_input_port().Eval(self._plant_context)
        scene_graph = self._diagram.GetSubsystemByName("scene_graph")
        filters = scene_graph.collision_filter_manager(scene_graph.GetMyMutableContextFromRoot(self._context))
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(_CLEARANCE):
            if {pair.id_A, pair.id_B} <= shapes:
                a, b = GeometrySet([pair.id_A]), GeometrySet([pair.id_B])
                filters.Apply(CollisionFilterDeclaration().ExcludeBetween(a, b))

    @functools.cached_property
    def _root_without_object(self) -> Context:
        """The diagram's context in which nothing collides with the object."""
        root = self._context.Clone()
        scene_graph = self._diagram.GetSubsystemByName("scene_graph")
        filters = scene_graph.collision_filter_manager(scene_graph.GetMyMutableContextFromRoot(root))
        inspector = scene_graph.model_inspector()
        everything = GeometrySet(inspector.GetAllGeometryIds(Role.kProximity))
        object_shapes = GeometrySet(self._plant.GetCollisionGeometriesForBody(self._object))
        filters.Apply(CollisionFilterDeclaration().ExcludeBetween(object_shapes, everything))
        return root

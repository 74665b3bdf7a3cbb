"""Finds a way for the open hand to its grasp that does not knock the object over."""

import itertools

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Role
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.assembly import add_hand_model
from geort_drake.hands.couplings import followers
from geort_drake.hands.description import HandDescription
from geort_drake.hands.links import palm_links
from geort_drake.simulation.operators.wrist_motion import WristMovement
from geort_drake.simulation.world import add_object

# Where the hand may wait before the grasp: this far back along the palm's normal and this far up, m.
_RETREATS = (0.08, 0.11, 0.14, 0.17)
_RISES = (0.0, 0.05, 0.10)
# Distance that the hand keeps from the object on its way there, m: the object is not always where it was
# planned to be, and fingers move meanwhile.
_REACH_CLEARANCE = 0.03
# Distance that the fingers keep on the way from there to the grasp, m, unless the grasp itself leaves less:
# a hand that counts as open is so only within some tolerance.
_APPROACH_CLEARANCE = 0.012
# Each way is looked at in so many places.
_PLACES = 9


class GraspApproach:
    """A hand without its arm, and an object; the object's frame O is the world.

    Args:
        object_name: the object.
        X_OB_start: where the hand base starts.
        q_start: joint positions by name at the start, rad.
    """

    def __init__(
        self,
        description: HandDescription,
        object_name: str,
        X_OB_start: RigidTransform,
        q_start: dict[str, float],
    ):
        self._X_OB_start, self._q_start = X_OB_start, q_start
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        hand = add_hand_model(self._plant, description)
        thing = add_object(self._plant, object_name)
        self._plant.WeldFrames(self._plant.world_frame(), thing.body_frame())
        self._plant.Finalize()
        self._joints = {
            name: self._plant.GetJointByName(name, hand)
            for name in [*description.joint_names, *(name for name, *_ in followers(description))]
        }
        self._base = self._plant.GetFrameByName(description.base_frame, hand)
        (root,) = self._plant.GetFloatingBaseBodies()
        self._root = self._plant.get_body(root)
        inspector = scene_graph.model_inspector()
        parts = [
            geometry
            for index in self._plant.GetBodyIndices(hand)
            for geometry in inspector.GetGeometries(self._plant.GetBodyFrameIdOrThrow(index), Role.kProximity)
        ]
        self._palm = {
            geometry
            for body in palm_links(self._plant, description, hand)
            for geometry in inspector.GetGeometries(
                self._plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity
            )
        }
        scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeWithin(GeometrySet(parts))
        )
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self._plant.GetMyMutableContextFromRoot(self._context)

    def waiting_pose(self, X_OB: RigidTransform, q_open: dict[str, float]) -> RigidTransform | None:
        """Where the hand can wait with open fingers before the grasp at X_OB; None if nowhere.

        It is reached from the start, and the grasp from it, in straight minimum-jerk movements.

        Args:
            q_open: joint positions by name of the open hand, rad.
        """
        room = self._distance(X_OB, X_OB, q_open, fingers_only=True)
        if room <= 0:
            return None
        for rise, retreat in itertools.product(_RISES, _RETREATS):
            X_OB_before = RigidTransform([0, 0, rise]) @ X_OB @ RigidTransform([-retreat, 0, 0])
            approach = self._distance(X_OB_before, X_OB, q_open, fingers_only=True)
            if approach >= min(0.9 * room, _APPROACH_CLEARANCE) and all(
                self._distance(self._X_OB_start, X_OB_before, q) >= _REACH_CLEARANCE
                for q in (q_open, self._q_start)
            ):
                return X_OB_before
        return None

    def _distance(
        self,
        X_OB_from: RigidTransform,
        X_OB_to: RigidTransform,
        q: dict[str, float],
        fingers_only: bool = False,
    ) -> float:
        """Least distance between hand and object on the way, m, as far as that is below 50 mm."""
        movement = WristMovement(X_OB_from, X_OB_to, 0.0, 1.0)
        for name, joint in self._joints.items():
            joint.set_angle(self._plant_context, q[name])
        # The hand base need not lie on the link that the others hang on.
        X_RootB = self._plant.CalcRelativeTransform(self._plant_context, self._root.body_frame(), self._base)
        least = 0.05
        for t in np.linspace(0, 1, _PLACES):
            self._plant.SetFloatingBaseBodyPoseInWorldFrame(
                self._plant_context, self._root, movement.pose(t) @ X_RootB.inverse()
            )
            query = self._plant.get_geometry_query_input_port().Eval(self._plant_context)
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(least):
                if not (fingers_only and {pair.id_A, pair.id_B} & self._palm):
                    least = min(least, pair.distance)
        return least

"""Finds a collision-free path of the open hand to its grasp."""

import itertools

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.assembly import HandInPlant, add_hand_model
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.world import add_object
from geort_drake.simulation.wrist_motion import WristMovement

# Candidates for the waiting pose: distances back along the palm's normal and upwards, m.
_RETREATS = (0.08, 0.11, 0.14, 0.17)
_RISES = (0.0, 0.05, 0.10)
# Clearance between hand and object on the way to the waiting pose, m: the object's position varies, and the
# fingers move meanwhile.
_REACH_CLEARANCE = 0.03
# Clearance of the fingers from there to the grasp, m, unless the grasp itself leaves less: the hand is open
# only within a tolerance.
APPROACH_CLEARANCE = 0.012
_SAMPLES = 9  # poses per movement at which distances are measured
# Largest measured distance, m.
_MAX_DISTANCE = 0.05


class GraspApproach:
    """Checks approaches of a hand without its arm to an object, whose frame O is the world frame.

    Args:
        description: the hand.
        object_name: the object.
        X_OB_start: initial pose of the hand base.
        q_start: initial joint positions by name, rad.
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
        object_body = add_object(self._plant, object_name)
        self._plant.WeldFrames(self._plant.world_frame(), object_body.body_frame())
        self._plant.Finalize()
        self._joints = {
            name: self._plant.GetJointByName(name, hand)
            for name in [*description.joint_names, *(c.joint for c in description.followers)]
        }
        self._base = self._plant.GetFrameByName(description.base_frame, hand)
        (root,) = self._plant.GetFloatingBaseBodies()
        self._root = self._plant.get_body(root)
        shapes = self._plant.GetCollisionGeometriesForBody
        links = map(self._plant.get_body, self._plant.GetBodyIndices(hand))
        parts = [geometry for link in links for geometry in shapes(link)]
        palm = HandInPlant(self._plant, description, hand).palm_links()
        self._palm = {geometry for link in palm for geometry in shapes(link)}
        scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeWithin(GeometrySet(parts))
        )
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self._plant.GetMyMutableContextFromRoot(self._context)

    def waiting_pose(
        self, X_OB: RigidTransform, q_open: dict[str, float]
    ) -> tuple[RigidTransform, float] | None:
        """Finds a pose at which the open hand can wait before the grasp at X_OB.

        Straight movements from the start to it and from it to the grasp are free of collisions. `q_open` are
        the joint positions of the open hand by name, rad. Returns X_OB of the waiting hand, and the smallest
        distance between fingers and object from there to the grasp, m; or None.
        """
        clearance = self._distance(X_OB, X_OB, q_open, fingers_only=True)
        if clearance <= 0:
            return None
        for rise, retreat in itertools.product(_RISES, _RETREATS):
            X_OB_before = RigidTransform([0, 0, rise]) @ X_OB @ RigidTransform([-retreat, 0, 0])
            approach = self._distance(X_OB_before, X_OB, q_open, fingers_only=True)
            if approach >= min(0.9 * clearance, APPROACH_CLEARANCE) and all(
                self._distance(self._X_OB_start, X_OB_before, q) >= _REACH_CLEARANCE
                for q in (q_open, self._q_start)
            ):
                return X_OB_before, approach
        return None

    def _distance(
        self,
        X_OB_from: RigidTransform,
        X_OB_to: RigidTransform,
        q: dict[str, float],
        fingers_only: bool = False,
    ) -> float:
        """Returns the smallest distance between hand and object in a movement, m, at most `_MAX_DISTANCE`."""
        movement = WristMovement(X_OB_from, X_OB_to, 0.0, 1.0)
        for name, joint in self._joints.items():
            joint.set_angle(self._plant_context, q[name])
        # The hand base need not be on the root link.
        X_RootB = self._plant.CalcRelativeTransform(self._plant_context, self._root.body_frame(), self._base)
        smallest = _MAX_DISTANCE
        for t in np.linspace(0, 1, 1 if X_OB_from is X_OB_to else _SAMPLES):
            self._plant.SetFloatingBaseBodyPoseInWorldFrame(
                self._plant_context, self._root, movement.pose(t) @ X_RootB.inverse()
            )
            query = self._plant.get_geometry_query_input_port().Eval(self._plant_context)
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(smallest):
                if not (fingers_only and {pair.id_A, pair.id_B} & self._palm):
                    smallest = min(smallest, pair.distance)
        return smallest

"""What can be seen of a grasp: fingertips, hand, object, and which finger touches the object."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Context, LeafSystem

from geort_drake.hands.description import HandDescription
from geort_drake.hands.links import finger_links
from geort_drake.systems.poses import pose_to_vector


class SceneView(LeafSystem):
    """Reads the quantities an onlooker sees off the plant's outputs.

    Input ports:
        body_poses (abstract list of RigidTransform): the plant's port of that name.
        contact_results (abstract ContactResults): the plant's port of that name.
    Output ports (F fingers in the hand description's order):
        fingertips (3F): p_WF, m.
        hand_pose (7): X_WB of the hand base, qw qx qy qz x y z.
        object_pose (7): X_WO of the object, qw qx qy qz x y z.
        contact (F): magnitude of the largest contact force, normal and friction, between one of a
            finger's links and the object, N.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        description: HandDescription,
        hand: ModelInstanceIndex,
        object_body: BodyIndex,
    ):
        super().__init__()
        num_fingers = len(description.fingers)
        self._base = plant.GetFrameByName(description.base_frame, hand).body().index()
        self._X_BaseB = plant.GetFrameByName(description.base_frame, hand).GetFixedPoseInBodyFrame()
        self._object = object_body
        self._tips = [
            (plant.GetBodyByName(finger.tip_link, hand).index(), np.asarray(finger.tip_point, float))
            for finger in description.fingers
        ]
        self._finger_of_body = {
            body.index(): number
            for number, links in enumerate(finger_links(plant, description, hand))
            for body in links
        }
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._contacts = self.DeclareAbstractInputPort(
            "contact_results", AbstractValue.Make(ContactResults())
        )
        self.DeclareVectorOutputPort("fingertips", 3 * num_fingers, self._calc_fingertips)
        self.DeclareVectorOutputPort("hand_pose", 7, self._calc_hand_pose)
        self.DeclareVectorOutputPort("object_pose", 7, self._calc_object_pose)
        self.DeclareVectorOutputPort("contact", num_fingers, self._calc_contact)

    def _calc_fingertips(self, context: Context, output) -> None:
        poses = self._poses.Eval(context)
        output.SetFromVector(np.concatenate([poses[body] @ point for body, point in self._tips]))

    def _calc_hand_pose(self, context: Context, output) -> None:
        output.SetFromVector(pose_to_vector(self._poses.Eval(context)[self._base] @ self._X_BaseB))

    def _calc_object_pose(self, context: Context, output) -> None:
        output.SetFromVector(pose_to_vector(self._poses.Eval(context)[self._object]))

    def _calc_contact(self, context: Context, output) -> None:
        results = self._contacts.Eval(context)
        force = np.zeros(output.size())
        for number in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(number)
            pair = (info.bodyA_index(), info.bodyB_index())
            if self._object not in pair:
                continue
            finger = self._finger_of_body.get(pair[0] if pair[1] == self._object else pair[1])
            if finger is not None:
                force[finger] = max(force[finger], float(np.linalg.norm(info.contact_force())))
        output.SetFromVector(force)

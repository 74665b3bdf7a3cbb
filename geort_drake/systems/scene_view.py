"""Reads fingertips, hand, object and contacts from a plant."""

from collections.abc import Callable, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Context, InputPort, ValueProducer

from geort_drake.hands.assembly import HandInPlant
from geort_drake.hands.description import HandDescription
from geort_drake.systems.contacts import bodies_of_geometries, contact_geometries, contact_rows
from geort_drake.systems.port_values import pose_to_vector
from geort_drake.systems.python_system import PythonSystem, weak_callback


class SceneView(PythonSystem):
    """Observes a grasp from the plant's outputs.

    Input ports:
        body_poses (abstract list of RigidTransform): the plant's port of that name.
        contact_results (abstract ContactResults): the plant's port of that name.
    Output ports (F fingers in the hand description's order):
        fingertips (3F): p_WF, m.
        hand_pose (7): X_WB of the hand base, qw qx qy qz x y z.
        object_pose (7): X_WO of the object, qw qx qy qz x y z.
        link_contact (L): magnitude of the largest contact force, normal and friction, between each link of
            the hand and the object, N.
        contact (F): the largest of these over the links of each finger, N.
        self_contact (1): 1 while two links of the hand touch each other, else 0. Contacts between fingertips
            do not count (see `HandInPlant.tip_geometries`). Neighbours along a finger and the description's
            `ignored_collisions` are filtered out.

    Attributes:
        links: L names.

    Args:
        plant: finalized plant.
        hand: the model instance of the hand, as `add_hand_model` adds it.
        inspector: inspector of the plant's scene graph.
        parts: other bodies of the object, whose contacts count as its own.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        description: HandDescription,
        hand: ModelInstanceIndex,
        object_body: BodyIndex,
        inspector: SceneGraphInspector,
        parts: Sequence[BodyIndex] = (),
    ):
        super().__init__()
        num_fingers = len(description.fingers)
        self._base = int(plant.GetFrameByName(description.base_frame, hand).body().index())
        self._X_BaseB = plant.GetFrameByName(description.base_frame, hand).GetFixedPoseInBodyFrame()
        self._object = int(object_body)
        self._parts = {self._object, *map(int, parts)}
        self._tip_links = [
            int(plant.GetBodyByName(finger.tip_link, hand).index()) for finger in description.fingers
        ]
        # Homogeneous columns: one product for all fingers takes a third of the time of separate products.
        self._tip_points = np.array([[*finger.tip_point, 1.0] for finger in description.fingers])[:, :, None]
        hand_parts = HandInPlant(plant, description, hand)
        self.links = [link.name() for link in hand_parts.links]
        self._number_of_link = {int(link.index()): number for number, link in enumerate(hand_parts.links)}
        self._finger_links = [
            [self._number_of_link[int(link.index())] for link in of_finger]
            for of_finger in hand_parts.finger_links()
        ]
        self._body_of_geometry = bodies_of_geometries(plant, inspector)
        self._tip_geometries = {*hand_parts.tip_geometries(inspector)}
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._contacts = self.DeclareAbstractInputPort(
            "contact_results", AbstractValue.Make(ContactResults())
        )
        pose_sizes = {"fingertips": 3 * num_fingers, "hand_pose": 7, "object_pose": 7}
        self._declare_outputs(pose_sizes, self._calc_poses, self._poses)
        contact_sizes = {"link_contact": len(self.links), "contact": num_fingers, "self_contact": 1}
        self._declare_outputs(contact_sizes, self._calc_contacts, self._contacts)

    def _declare_outputs(self, sizes: dict[str, int], calculate: Callable, source: InputPort) -> None:
        """Declares ports with a common cache entry, because reading the input takes longer than the rest."""
        cache = self.DeclareCacheEntry(
            ", ".join(sizes),
            ValueProducer(lambda: AbstractValue.Make({}), weak_callback(self, calculate)),
            {self.input_port_ticket(source.get_index())},
        )
        index = cache.cache_index()
        for name, size in sizes.items():
            self.DeclareVectorOutputPort(
                name,
                size,
                lambda context, output, name=name: output.SetFromVector(
                    self.get_cache_entry(index).Eval(context)[name]
                ),
                {cache.ticket()},
            )

    def _calc_poses(self, context: Context, output: AbstractValue) -> None:
        poses = self._poses.Eval(context)
        X_WT = np.array([poses[link].GetAsMatrix34() for link in self._tip_links])
        output.set_value(
            {
                "fingertips": (X_WT @ self._tip_points).ravel(),
                "hand_pose": pose_to_vector(poses[self._base].multiply(self._X_BaseB)),
                "object_pose": pose_to_vector(poses[self._object]),
            }
        )

    def _calc_contacts(self, context: Context, output: AbstractValue) -> None:
        results = self._contacts.Eval(context)
        force, self_contact = [0.0] * len(self.links), 0.0
        rows = contact_rows(results, self._body_of_geometry)
        bodies, magnitudes = rows[:, :2].tolist(), np.linalg.norm(rows[:, 5:], axis=1).tolist()
        for row, ((A, B), magnitude) in enumerate(zip(bodies, magnitudes, strict=True)):
            if A in self._parts or B in self._parts:
                link = self._number_of_link.get(B if A in self._parts else A)
                if link is not None:
                    force[link] = max(force[link], magnitude)
            elif A in self._number_of_link and B in self._number_of_link and not self_contact:
                only_tips = self._tip_geometries.issuperset(contact_geometries(results, row))
                self_contact = float(not only_tips)
        output.set_value(
            {
                "link_contact": force,
                "contact": [max(force[link] for link in links) for links in self._finger_links],
                "self_contact": [self_contact],
            }
        )

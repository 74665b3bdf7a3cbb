"""What the person sees and feels of a scene, and the monitors judge."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.task import PerceivedPort
from geort_drake.simulation.world import Scene
from geort_drake.systems.port_values import POINT_MIRROR, POSE_MIRROR
from geort_drake.systems.scene_view import SceneView


def add_view(
    builder: DiagramBuilder,
    scene: Scene,
    description: HandDescription,
    body: RigidBody,
    parts: Sequence[RigidBody] = (),
) -> SceneView:
    """Adds the system that observes a body, and the contacts of the fingers with it and its parts."""
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    view = builder.AddNamedSystem(
        "scene_view",
        SceneView(plant, description, scene.hand, body.index(), inspector, [part.index() for part in parts]),
    )
    builder.Connect(plant.get_body_poses_output_port(), view.GetInputPort("body_poses"))
    builder.Connect(plant.get_contact_results_output_port(), view.GetInputPort("contact_results"))
    return view


def shown_by(view: SceneView, num_fingers: int, *names: str) -> dict[str, PerceivedPort]:
    """Output ports of a view, with their signs in a mirror."""
    mirrors = {
        "fingertips": np.tile(POINT_MIRROR, num_fingers),
        "hand_pose": POSE_MIRROR,
        "object_pose": POSE_MIRROR,
        "contact": None,
    }
    return {name: PerceivedPort(view.GetOutputPort(name), mirrors[name]) for name in names}

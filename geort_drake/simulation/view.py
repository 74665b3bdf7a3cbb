"""Adds the systems that observe and judge a scene, and selects what the person perceives."""

from collections.abc import Iterable, Sequence

import numpy as np
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.monitor import TaskMonitor
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
    """Adds the system that observes a body and the hand's contacts with it and its parts."""
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    view = builder.AddNamedSystem(
        "scene_view",
        SceneView(plant, description, scene.hand, body.index(), inspector, [part.index() for part in parts]),
    )
    builder.Connect(plant.get_body_poses_output_port(), view.GetInputPort("body_poses"))
    builder.Connect(plant.get_contact_results_output_port(), view.GetInputPort("contact_results"))
    return view


def add_monitor(builder: DiagramBuilder, name: str, monitor: TaskMonitor, view: SceneView) -> None:
    """Adds a monitor and connects its inputs to the view's outputs of the same names."""
    builder.AddNamedSystem(name, monitor)
    for port in map(monitor.get_input_port, range(monitor.num_input_ports())):
        if view.HasOutputPort(port.get_name()):
            builder.Connect(view.GetOutputPort(port.get_name()), port)


def shown_by(view: SceneView, monitor: TaskMonitor, names: Iterable[str]) -> dict[str, PerceivedPort]:
    """Returns output ports of the view, or else of the monitor, with the signs that mirror them."""
    mirrors = {
        "fingertips": np.tile(POINT_MIRROR, view.GetOutputPort("fingertips").size() // 3),
        **dict.fromkeys(("hand_pose", "object_pose", "place_pose"), POSE_MIRROR),
        "turned": np.array([-1.0]),
    }
    systems = {name: view if view.HasOutputPort(name) else monitor for name in names}
    return {
        name: PerceivedPort(system.GetOutputPort(name), mirrors.get(name)) for name, system in systems.items()
    }

"""`add_rerun_recorder`: adds a recorder to a diagram and connects it."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort

from geort_drake.errors import ScenarioError
from geort_drake.files import require_writable
from geort_drake.rerun.layout import VIEW_FROM, Layout, followed_bodies
from geort_drake.rerun.plant import Contacts, ContactSpec, Poses
from geort_drake.rerun.recorder import RerunRecorder
from geort_drake.rerun.scene import describe_scene
from geort_drake.rerun.specs import CloseUpSpec, Spec, port_name
from geort_drake.rerun.streams import Property, Viewer

_CONTACT = ContactSpec()


def add_rerun_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path: str | os.PathLike | None,
    specs: Mapping[str, Spec] | None = None,
    *,
    viewers: Sequence[Viewer] = (),
    period: float = 0.02,
    role: Role = Role.kIllustration,
    contact: ContactSpec = _CONTACT,
    close_ups: Mapping[str, CloseUpSpec] | None = None,
    view_from: ArrayLike = VIEW_FROM,
    properties: Mapping[str, Property] | None = None,
    plant_ports: Mapping[str, OutputPort] | None = None,
) -> RerunRecorder:
    """Adds a Rerun recorder of a plant and other ports to a diagram; on errors, the builder stays unchanged.

    Args:
        builder: builder of the diagram that contains `plant` and all ports below. For a port inside a nested
            diagram, give the nested diagram's exported port; for a plant inside one, see `plant_ports`.
        plant: finalized plant.
        scene_graph: the scene graph with the plant's geometry.
        path: the .rrd file, whose folder is created if needed; None with viewers only.
        specs: entity path → what to record in addition to the plant: signals and states under /; hands,
            points and cameras under /world.
        viewers: open viewers, such as `rerun.GrpcSink("rerun+http://127.0.0.1:9876/proxy")`, or servers to
            which viewers connect, such as `rerun.GrpcServerSink`.
        period: time between samples, s.
        role: role of the geometry to draw; a body without any is drawn with its proximity geometry.
        contact: options for recording contact forces (point and hydroelastic contact).
        close_ups: name → additional view of the scene.
        view_from: direction in W from the scene to the eye.
        properties: facts that the viewer lists, such as {"method": "geort", "seed": 3}.
        plant_ports: for a plant inside a nested diagram, the ports by which that diagram exports the plant's
            `body_poses` and `contact_results`.

    Raises:
        ScenarioError: the plant is not finalized; a port does not fit or is in another diagram; the period
            or `view_from` is invalid; or there is neither a file nor a viewer.
        OutputError: the file cannot be written.
    """
    if path is not None:
        require_writable(path)
    where = path or "live recording"
    if path is None and not viewers:
        raise ScenarioError("a recorder needs a file, viewers or both; given: neither")
    if not plant.is_finalized():
        raise ScenarioError(
            f"{where}: the plant '{plant.get_name()}' must be finalized before it is recorded"
        )
    if not period > 0:
        raise ScenarioError(f"{where}: period must be positive, s; given {period}")
    direction = np.asarray(view_from, float)
    if direction.shape != (3,) or not 0 < np.linalg.norm(direction) < np.inf:
        raise ScenarioError(f"{where}: view_from must be three numbers, not all 0; given {view_from!r}")
    followed = followed_bodies(close_ups or {}, specs or {})
    scene = describe_scene(plant, scene_graph, role, followed)
    recorded: dict[str, Spec] = {"body_poses": Poses(scene), "contact_results": Contacts(scene, contact)}
    recorded |= specs or {}

    unused = dict(plant_ports or {})

    def plant_port(name: str) -> OutputPort:
        own = plant.GetOutputPort(name)
        unused.pop(name, None)
        port = (plant_ports or {}).get(name, own)
        if type(port.Allocate()) is not type(own.Allocate()):
            raise ScenarioError(f"{where}: plant_ports: {port_name(port)} does not give {name}")
        return port

    inputs: dict[str, list[str]] = {}
    sources: dict[str, OutputPort] = {}
    names: dict[tuple[Any, int], str] = {}
    for key, spec in recorded.items():
        inputs[key] = []
        for name, port in spec.ports(key, plant_port).items():
            # A port that several specs share is read once.
            inputs[key].append(names.setdefault((port.get_system(), int(port.get_index())), name))
            sources.setdefault(inputs[key][-1], port)
    if unused:
        raise ScenarioError(
            f"{where}: plant_ports: nothing is recorded from {', '.join(unused)}; "
            "the recorder reads body_poses and contact_results"
        )
    _check_connectable(where, builder, sources)
    recorder = RerunRecorder(
        None if path is None else Path(path),
        recorded,
        inputs,
        sources,
        period,
        layout=Layout(scene, dict(close_ups or {}), direction),
        viewers=viewers,
        properties=properties or {},
    )
    taken = builder.HasSubsystemNamed("rerun_recorder")
    recorder.set_name(f"rerun_recorder_{len(builder.GetSystems())}" if taken else "rerun_recorder")
    builder.AddSystem(recorder)
    for name, source in sources.items():
        builder.Connect(source, recorder.GetInputPort(name))
    return recorder


def _check_connectable(where: object, builder: DiagramBuilder, sources: Mapping[str, OutputPort]) -> None:
    """Raises ScenarioError if a port is in another diagram."""
    systems = builder.GetSystems()
    for name, port in sources.items():
        system = port.get_system()
        if not any(one is system for one in systems):
            raise ScenarioError(
                f"{where}: '{name}': {port_name(port)} is not in the diagram of the recorder. "
                "If it is in a nested diagram, export it there (ExportOutput) and give the exported port; "
                "for a plant, as plant_ports={'body_poses': ..., 'contact_results': ...}"
            )

"""`add_rerun_recorder`: adds a recorder to a diagram and connects it."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort

from geort_drake.errors import ScenarioError
from geort_drake.rerun.layout import VIEW_FROM, Layout, followed_bodies
from geort_drake.rerun.plant import Contacts, ContactSpec, Poses
from geort_drake.rerun.recorder import RerunRecorder
from geort_drake.rerun.scene import describe_scene
from geort_drake.rerun.specs import (
    CameraSpec,
    CloseUpSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    Spec,
    StateSpec,
    port_name,
)
from geort_drake.rerun.streams import LiveSink, Property, is_live
from geort_drake.rerun.track import Track

Target = str | os.PathLike | LiveSink


def add_rerun_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path_or_viewer: Target | Sequence[Target],
    *,
    application_id: str = "geort_drake",
    period: float = 0.02,
    role: Role = Role.kIllustration,
    contact: bool | ContactSpec = True,
    signals: Mapping[str, SignalSpec] | None = None,
    hands: Mapping[str, HandSpec] | None = None,
    points: Mapping[str, PointsSpec] | None = None,
    states: Mapping[str, StateSpec] | None = None,
    cameras: Mapping[str, CameraSpec] | None = None,
    close_ups: Mapping[str, CloseUpSpec] | None = None,
    view_from: ArrayLike = VIEW_FROM,
    properties: Mapping[str, Property] | None = None,
    blueprint: rrb.Blueprint | None = None,
    plant_ports: Mapping[str, OutputPort] | None = None,
) -> RerunRecorder:
    """Adds a Rerun recorder of a plant and of other ports to a diagram.

    Args:
        builder: of the diagram that holds `plant` and all ports below. For a port inside a nested diagram,
            give the nested diagram's exported port; for a plant inside one, see `plant_ports`.
        plant: finalized.
        path_or_viewer: the .rrd file, whose folder is made when needed; or an open viewer, as its address
            "rerun+http://127.0.0.1:9876/proxy", as `rerun.GrpcSink` or as `rerun.GrpcServerSink`; or several
            of these, at most one of them a file.
        application_id: recordings with the same id share a layout in the viewer.
        period: of the samples, s.
        role: which geometry to draw; a body without any is drawn with its proximity geometry.
        contact: whether, or how, contact forces are recorded (point and hydroelastic contact).
        signals: entity path under / → time series.
        hands: entity path under /world → human hand.
        points: entity path under /world → points.
        states: entity path under / → named states.
        cameras: entity path under /world → camera.
        close_ups: name → another view of the scene, in the default layout.
        view_from: direction in W from the scene to the eye, in the default layout.
        properties: facts that the viewer lists, such as {"method": "geort", "seed": 3}.
        blueprint: layout; by default one that shows all recorded data.
        plant_ports: for a plant inside a nested diagram, the ports by which that diagram exports the plant's
            `body_poses` and, if contact is recorded, `contact_results`.

    Raises:
        ScenarioError: the plant is not finalized; a port does not fit or is in another diagram; the period
            or `view_from` is invalid; or there is more than one file. The builder is unchanged then.
    """
    path, sinks = _targets(path_or_viewer)
    where = path or "live recording"
    if not plant.is_finalized():
        raise ScenarioError(
            f"{where}: the plant '{plant.get_name()}' must be finalized before it is recorded"
        )
    if not period > 0:
        raise ScenarioError(f"{where}: period must be positive, s; given {period}")
    direction = np.asarray(view_from, float)
    if direction.shape != (3,) or not 0 < np.linalg.norm(direction) < np.inf:
        raise ScenarioError(f"{where}: view_from must be three numbers, not all 0; given {view_from!r}")
    followed = followed_bodies(close_ups or {}, hands or {})
    scene = describe_scene(plant, scene_graph, role, followed)
    specs: list[tuple[str, Spec]] = [("body_poses", Poses(scene))]
    if contact:
        options = contact if isinstance(contact, ContactSpec) else ContactSpec()
        specs.append(("contact_results", Contacts(scene, options)))
    for given in (states, signals, hands, points, cameras):
        specs += (given or {}).items()

    def plant_port(name: str) -> OutputPort:
        own = plant.GetOutputPort(name)
        port = (plant_ports or {}).get(name, own)
        if type(port.Allocate()) is not type(own.Allocate()):
            raise ScenarioError(f"{where}: plant_ports: {port_name(port)} does not hold {name}")
        return port

    tracks, sources = [], dict[str, OutputPort]()
    names: dict[tuple[Any, int], str] = {}
    for key, spec in specs:
        inputs = []
        for name, port in spec.ports(key, plant_port).items():
            # A port that several tracks share is read once.
            inputs.append(names.setdefault((port.get_system(), int(port.get_index())), name))
            sources.setdefault(inputs[-1], port)
        tracks.append(Track(key, spec, inputs))
    _check_connectable(where, builder, sources)
    recorder = RerunRecorder(
        path,
        tracks,
        sources,
        period,
        layout=Layout(scene, dict(close_ups or {}), direction),
        sinks=sinks,
        application_id=application_id,
        properties=properties or {},
        blueprint=blueprint,
    )
    recorder.set_name("rerun_recorder")
    builder.AddSystem(recorder)
    for name, source in sources.items():
        builder.Connect(source, recorder.GetInputPort(name))
    return recorder


def _targets(path_or_viewer: Target | Sequence[Target]) -> tuple[Path | None, list[LiveSink]]:
    """The file, if any, and the viewers."""
    single = isinstance(path_or_viewer, str | os.PathLike) or is_live(path_or_viewer)
    targets: Sequence[Any] = [path_or_viewer] if single else list(path_or_viewer)  # type: ignore[arg-type]
    files = [target for target in targets if not is_live(target)]
    if not targets or len(files) > 1:
        given = ", ".join(map(str, targets)) or "nothing"
        raise ScenarioError(f"a recorder takes one file, viewers, or both; given: {given}")
    viewers = [target for target in targets if is_live(target)]
    sinks = [rr.GrpcSink(viewer) if isinstance(viewer, str) else viewer for viewer in viewers]
    return Path(files[0]) if files else None, sinks


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

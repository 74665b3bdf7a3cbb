"""The default layout: plots and their pages, close-ups, trails; and plants inside other diagrams."""

from types import SimpleNamespace

import numpy as np
import pytest
import rerun.blueprint as rrb
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from rerun_world import World, constant, read

from geort_drake.errors import ScenarioError
from geort_drake.rerun import CloseUpSpec, PointsSpec, SignalSpec, add_rerun_recorder
from geort_drake.rerun.layout import Layout


@pytest.fixture
def laid_out(monkeypatch):
    """The views of the default layout by title, once it has been made."""
    found = {}
    make = Layout.blueprint

    def collect(part, page):
        for inner in part.contents:
            if isinstance(inner, rrb.View):
                found[inner.name] = inner
                pages[inner.name] = page
            else:
                collect(inner, inner.name or page)

    def blueprint(self, specs, rows):
        made = make(self, specs, rows)
        collect(made.root_container, "")
        return made

    pages = {}
    monkeypatch.setattr(Layout, "blueprint", blueprint)
    return SimpleNamespace(views=found, pages=pages)


def eye_of(view):
    """Where the eye is, what it looks at, and what is up."""
    eye = view.properties["EyeControls3D"]
    fields = (eye.position, eye.look_target, eye.eye_up)
    return [np.array(field.as_arrow_array().to_pylist()[0]) for field in fields]


def test_plots_are_named_with_their_unit_and_are_on_pages(tmp_path, laid_out):
    """Commanded and measured values share a plot; fingers are in their order; contact comes first."""
    world = World().finalize()
    q, torque = constant(world.builder, [1, 2]), constant(world.builder, [0.1, 0.2])
    names = ["index/a", "thumb/b"]
    signals = {
        "joints/command": SignalSpec(q, names, "command", unit="rad", page="angles"),
        "joints/measured": SignalSpec(q, names, "measured", unit="rad", page="angles"),
        "torques/all": SignalSpec(torque, ["x", "y"], title="all", unit="N m", page="torques", limits=(0, 1)),
    }
    world.record(tmp_path / "p.rrd", specs=signals, until=0.0)
    plots = [title for title in laid_out.views if title != "scene"]
    assert plots == ["contact force [N]", "thumb [rad]", "index [rad]", "all [N m]"]
    assert [laid_out.pages[title] for title in plots] == ["angles"] * 3 + ["torques"]
    assert laid_out.views["thumb [rad]"].contents == ["/joints/command/thumb", "/joints/measured/thumb"]


def test_a_close_up_moves_with_its_frame(tmp_path, laid_out):
    """Eye and target are in the body's frame; the view is upright at the end, with one translucent body."""
    world = World(height=2.0).finalize()
    frame = world.plant.GetFrameByName("upper")
    spec = CloseUpSpec(frame, eye=(0.3, 0, 0.1), target=(0, 0, 0.1), see_through=[world.ball])
    path = PointsSpec(constant(world.builder, [0, 0, 0]), trail=np.inf)
    world.record(tmp_path / "close.rrd", close_ups={"arm": spec}, specs={"path": path})
    with world.recorder:
        world.simulator.AdvanceTo(0.3)
        X_WU = world.plant.EvalBodyPoseInWorld(world.context, world.upper)
    view = laid_out.views["arm"]
    assert (view.origin, view.contents) == ("/world/arm/upper", ["/world/**"])
    eye, _, up = eye_of(view)
    np.testing.assert_allclose(eye, [0.3, 0, 0.1], atol=1e-6)
    # The last sample may be one step of the plant earlier.
    np.testing.assert_allclose(up, X_WU.rotation().matrix()[2], atol=0.02)
    assert set(view.visualizer_overrides) == {"/world/path", "/world/ball/body/ellipsoids"}
    (rgba,) = view.visualizer_overrides["/world/ball/body/ellipsoids"].colors.as_arrow_array().to_pylist()
    assert rgba >> 8 == 0x336699 and 0 < rgba & 255 < 255
    assert set(laid_out.views["scene"].visualizer_overrides) == {"/world/path"}


def inside(world):
    """The world's diagram as a system of another builder's, with the plant's ports exported."""
    for name in ("body_poses", "contact_results"):
        world.builder.ExportOutput(world.plant.GetOutputPort(name), name)
    outer = DiagramBuilder()
    return outer, outer.AddNamedSystem("robot", world.builder.Build())


def test_a_plant_inside_another_diagram_is_recorded_by_exported_ports(tmp_path):
    """Without them the error says how to export, before anything is added."""
    world = World(height=2.0).finalize()
    outer, robot = inside(world)
    for ports, message in (
        ({}, r"no\.rrd: 'body_poses'.*ExportOutput.*plant_ports=\{'body_poses'"),
        ({"body_poses": "body_poses"}, "'contact_results': .* is not in the diagram"),
        ({"body_poses": "contact_results", "contact_results": "contact_results"}, "does not give body_poses"),
    ):
        given = {name: robot.GetOutputPort(port) for name, port in ports.items()}
        with pytest.raises(ScenarioError, match=message):
            add_rerun_recorder(outer, world.plant, world.scene_graph, tmp_path / "no.rrd", plant_ports=given)
    assert outer.GetSystems() == [robot]
    ports = {name: robot.GetOutputPort(name) for name in ("body_poses", "contact_results")}
    recorder = add_rerun_recorder(
        outer, world.plant, world.scene_graph, tmp_path / "in.rrd", plant_ports=ports, period=0.1
    )
    simulator = Simulator(outer.Build())
    with recorder:
        simulator.AdvanceTo(0.3)
    _, found = read(recorder.path, "/world/ball/body", "Transform3D:translation")
    heights = np.array(found)[:, 0, 2]
    assert heights[0] == pytest.approx(2.0, abs=0.01) and (np.diff(heights) < 0).all()

"""How recordings are laid out: plots and their pages, close-ups, trails; and plants inside other diagrams."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from rerun_world import World, constant, pose_source, read

from geort_drake.colours import FINGER_COLOURS, rgb
from geort_drake.errors import ScenarioError
from geort_drake.people.keypoints import TIP_KEYPOINT, wrist_pose
from geort_drake.rerun import file as _rerun_file
from geort_drake.rerun.blueprint import Plot, grasp_blueprint
from geort_drake.rerun.recorder import (
    CloseUpSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    StateSpec,
    add_rerun_recorder,
)


@pytest.fixture
def laid_out(monkeypatch):
    """What the default layout is made of."""
    asked = {}

    def layout(**options):
        asked.update(options)
        return grasp_blueprint(**options)

    monkeypatch.setattr(_rerun_file, "grasp_blueprint", layout)
    return asked


def test_plots_are_named_with_their_unit_and_stand_on_pages(tmp_path, laid_out):
    """What is asked for and what is measured share a plot; fingers come in their order on each page."""
    world = World().finalize()
    q, torque = constant(world.builder, [1, 2]), constant(world.builder, [0.1, 0.2])
    names = ["index/a", "thumb/b"]
    signals = {
        "torques/all": SignalSpec(torque, ["x", "y"], title="all", unit="N m", page="torques", limits=(0, 1)),
        "joints/command": SignalSpec(q, names, "command", unit="rad", page="angles"),
        "joints/measured": SignalSpec(q, names, "measured", unit="rad", page="angles"),
    }
    world.record(tmp_path / "p.rrd", signals=signals)
    world.recorder.close()
    assert laid_out["plots"] == {
        "all [N m]": Plot(["/torques/all"], "torques", limits=(0, 1)),
        "thumb [rad]": Plot(["/joints/command/thumb", "/joints/measured/thumb"], "angles"),
        "index [rad]": Plot(["/joints/command/index", "/joints/measured/index"], "angles"),
    }


def test_a_series_has_the_colours_that_it_was_given(tmp_path):
    """Such as those of the fingers; contact forces on a finger have its colour by themselves."""
    world = World().finalize()
    port = constant(world.builder, [1, 2])
    colors = [rgb(FINGER_COLOURS[finger]) for finger in ("thumb", "ring")]
    world.record(tmp_path / "c.rrd", signals={"tips/gap": SignalSpec(port, ["thumb", "ring"], colors=colors)})
    with world.recorder:
        world.simulator.AdvanceTo(0.05)
    _, found = read(world.recorder.path, "/tips/gap", "SeriesLines:colors")
    assert [f"#{color >> 8:06X}" for color in found[0].tolist()] == [
        FINGER_COLOURS["thumb"],
        FINGER_COLOURS["ring"],
    ]


@pytest.mark.parametrize("pages", [1, 2])
@pytest.mark.parametrize("close_up", [False, True])
def test_every_layout_can_be_stored(tmp_path, pages, close_up):
    """With and without each of its parts."""
    world = World().finalize()
    port = constant(world.builder, [1.0])
    world.record(
        tmp_path / "l.rrd",
        signals={f"s/{i}": SignalSpec(port, ["a"], title=f"s{i}", page=f"page {i}") for i in range(pages)},
        states={"phase": StateSpec(port, ["reach", "hold"])},
        points={"path": PointsSpec(constant(world.builder, [0, 0, 1]), trail=0.5)},
        close_ups={"ball": CloseUpSpec(world.ball.body_frame(), (0.3, 0, 0))} if close_up else {},
    )
    with world.recorder:
        world.simulator.AdvanceTo(0.05)
    assert world.recorder.path.stat().st_size > 1000


def test_a_close_up_moves_with_its_frame(tmp_path, laid_out):
    """It is measured in the body's frame, upright at the end, and sees through what it was told to."""
    world = World(height=2.0).finalize()
    frame = world.plant.GetFrameByName("upper")
    spec = CloseUpSpec(frame, eye=(0.3, 0, 0.1), target=(0, 0, 0.1), see_through=[world.ball])
    path = PointsSpec(constant(world.builder, [0, 0, 0]), trail=np.inf)
    world.record(tmp_path / "close.rrd", close_ups={"arm": spec}, points={"path": path})
    with world.recorder:
        world.simulator.AdvanceTo(0.3)
        X_WU = world.plant.EvalBodyPoseInWorld(world.context, world.upper)
    (view,) = laid_out["close_ups"]
    assert (view.name, view.origin, view.contents) == ("arm", "/world/arm/upper", "/world/**")
    np.testing.assert_allclose(view.eye, [0.3, 0, 0.1])
    # The last sample may lie one step of the plant before.
    np.testing.assert_allclose(view.up, X_WU.rotation().matrix()[2], atol=0.02)
    (shape,) = view.overrides.values()
    assert list(view.overrides) == ["/world/ball/body/ellipsoids"]
    (rgba,) = shape.colors.as_arrow_array().to_pylist()
    assert rgba >> 8 == 0x336699 and 0 < rgba & 255 < 255
    assert laid_out["trails"] == {"/world/path": np.inf}


def test_a_close_up_of_a_hand_moves_with_its_wrist(tmp_path, laid_out, rng):
    """The wrist's frame is that of the keypoints; tips have the colours of their fingers."""
    world = World().finalize()
    p_HK = rng.uniform(0.02, 0.1, (21, 3))
    X_OH = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.1, 0.2, 0.3])
    keypoints, wrist = constant(world.builder, p_HK.ravel()), pose_source(world.builder, X_OH)
    world.record(
        tmp_path / "hand.rrd",
        hands={"person": HandSpec(keypoints, wrist)},
        close_ups={"hand": CloseUpSpec("person", (0.2, 0, 0))},
    )
    with world.recorder:
        world.simulator.AdvanceTo(0.05)
    R_WH, p_WH = wrist_pose((X_OH @ p_HK.T).T)
    (view,) = laid_out["close_ups"]
    assert (view.origin, view.contents) == ("/world/person/wrist", "/world/person/**")
    np.testing.assert_allclose(view.up, R_WH[2], atol=1e-9)
    _, found = read(world.recorder.path, view.origin, "Transform3D:translation")
    np.testing.assert_allclose(found[-1][0], p_WH, atol=1e-6)
    _, colors = read(world.recorder.path, "/world/person/keypoints", "Points3D:colors")
    for finger, tip in TIP_KEYPOINT.items():
        assert f"#{colors[0][tip] >> 8:06X}" == FINGER_COLOURS[finger]


def inside(world):
    """The world's diagram as a system of another builder's, with the plant's ports exported."""
    for name in ("body_poses", "contact_results"):
        world.builder.ExportOutput(world.plant.GetOutputPort(name), name)
    outer = DiagramBuilder()
    return outer, outer.AddNamedSystem("robot", world.builder.Build())


@pytest.mark.parametrize("view_from", [(0.0, 2.0, 0.0), (-1.0, 1.0, 0.5)])
def test_the_scene_is_seen_from_where_it_is_asked_for(tmp_path, laid_out, view_from):
    """From that direction, at a distance that takes the motion in."""
    world = World().finalize()
    world.record(tmp_path / "v.rrd", view_from=view_from)
    with world.recorder:
        world.simulator.AdvanceTo(0.1)
    sight = np.subtract(laid_out["eye"], laid_out["target"])
    np.testing.assert_allclose(
        sight / np.linalg.norm(sight), view_from / np.linalg.norm(view_from), atol=1e-9
    )


@pytest.mark.parametrize("view_from", [(0, 0, 0), (1, 0), (np.nan, 1, 0)])
def test_a_direction_that_is_none_is_refused(tmp_path, view_from):
    """And named."""
    with pytest.raises(ScenarioError, match="view_from must be three numbers, not all 0"):
        World().finalize().record(tmp_path / "v.rrd", view_from=view_from)


def test_a_plant_inside_another_diagram_is_recorded_by_exported_ports(tmp_path):
    """Without them the error says how to export, before anything is added."""
    world = World(height=2.0).finalize()
    outer, robot = inside(world)
    with pytest.raises(
        ScenarioError, match=r"no\.rrd: the plant.*ExportOutput.*plant_ports=\{\"body_poses\""
    ):
        add_rerun_recorder(outer, world.plant, world.scene_graph, tmp_path / "no.rrd")
    for ports, message in (
        ({"body_poses": "body_poses"}, "must be body_poses and contact_results, not body_poses"),
        ({"body_poses": "contact_results", "contact_results": "contact_results"}, "does not hold body_poses"),
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


def test_a_port_inside_another_diagram_is_named(tmp_path):
    """Drake's own error would come after the recorder was added."""
    world = World().finalize()
    inner = DiagramBuilder()
    port = constant(inner, [1.0])
    world.builder.AddNamedSystem("inner", inner.Build())
    systems = world.builder.GetSystems()
    with pytest.raises(ScenarioError, match=r"'load': port 'y0' of '.*' is not in the diagram.*ExportOutput"):
        world.record(tmp_path / "no.rrd", signals={"load": SignalSpec(port, ["a"])})
    assert world.builder.GetSystems() == systems

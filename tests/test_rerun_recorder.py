"""The Rerun recorder on a small world: its file, live viewers, and its layout."""

import socket

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from rerun.chunk import RrdReader
from rerun_world import GRAVITY, World, constant, entities, read, rerun, steps
from scipy.spatial.transform import Rotation

from geort_drake import CloseUpSpec, PointsSpec, SignalSpec, StateSpec, add_rerun_recorder
from geort_drake.errors import OutputError
from geort_drake.live.transports import wait_for
from geort_drake.rerun import RerunRecorder, recorder
from geort_drake.rerun import recorder as recorder_module
from geort_drake.rerun.layout import default_layout


def test_poses_in_the_file_are_those_of_the_plant(tmp_path):
    """The last sample is the plant's pose at that time; the ball's path is that of a free fall."""
    world = World(height=2.0).finalize().record(tmp_path / "poses.rrd", period=0.1)
    world.simulator.AdvanceTo(0.5)
    X_WU = world.plant.EvalBodyPoseInWorld(world.context, world.upper)
    world.recorder.close()
    times, p_WU = read(world.recorder.path, "/world/arm/upper", "Transform3D:translation")
    _, quaternions = read(world.recorder.path, "/world/arm/upper", "Transform3D:quaternion")
    np.testing.assert_allclose(times, np.arange(6) * 0.1, atol=1e-9)
    np.testing.assert_allclose(p_WU[-1][0], X_WU.translation(), atol=1e-6)
    R_WU = Rotation.from_quat(quaternions[-1][0]).as_matrix()
    np.testing.assert_allclose(R_WU, X_WU.rotation().matrix(), atol=1e-6)
    _, p_WB = read(world.recorder.path, "/world/ball/body", "Transform3D:translation")
    # Euler's steps of 2 ms are off by g t dt / 2, and a sample may lie on either side of a step at
    # its time, which is g t dt: 15 mm together.
    expected = 2.0 - GRAVITY / 2 * np.square(times)
    np.testing.assert_allclose([p[0][2] for p in p_WB], expected, atol=15e-3)


def test_equal_simulations_give_equal_recordings(tmp_path):
    """Neither the clock nor chance gets into a file."""
    paths = [tmp_path / folder / "trial.rrd" for folder in ("one", "two")]
    for path in paths:
        World(height=0.06).finalize().record(path, properties={"seed": 3}, until=0.2)
    compared = rerun("rrd", "compare", "--unordered", *paths)
    assert compared.returncode == 0, compared.stderr[-2000:]
    assert len({RrdReader(path).recordings()[0].recording_id for path in paths}) == 1
    other = tmp_path / "other" / "trial.rrd"
    World(height=0.07).finalize().record(other, properties={"seed": 3}, until=0.2)
    assert rerun("rrd", "compare", "--unordered", paths[0], other).returncode != 0


def test_properties_keep_their_types_from_one_recording_to_the_next(tmp_path):
    """Rerun remembers the first type of a name; that must not leak between recordings."""
    for number, seed in enumerate((3, "three", 3.5, True)):
        world = World().finalize().record(tmp_path / f"{number}.rrd", properties={"seed": seed})
        world.recorder.set_properties({"outcome": "held"})
        world.recorder.close()
        for name, expected in (("seed", seed), ("outcome", "held")):
            assert read(world.recorder.path, "/__properties/run", name)[1][0].tolist() == [expected]
    with pytest.raises(OutputError, match="is closed"):
        world.recorder.set_properties({"outcome": "too late"})


def test_a_file_that_cannot_be_written_is_refused_before_the_simulation(tmp_path):
    (tmp_path / "file").write_text("in the way")
    for path, fault in ((tmp_path / "file" / "a.rrd", "file is not a directory"), (".", "is a directory")):
        with pytest.raises(OutputError, match=fault):
            World().finalize().record(path)


def test_an_interrupted_simulation_leaves_a_whole_file(tmp_path):
    """The samples up to the failure are what one wants to look at."""
    world = World().finalize().record(tmp_path / "broken.rrd")

    def fail(context):
        if context.get_time() > 0.1:
            raise RuntimeError("the hand is on fire")

    world.simulator.set_monitor(fail)
    with pytest.raises(RuntimeError, match="on fire"), world.recorder:
        assert not world.recorder.path.exists()
        world.simulator.AdvanceTo(1.0)
    assert rerun("rrd", "verify", world.recorder.path).returncode == 0
    assert abs(read(world.recorder.path, "/world/ball/body", "Transform3D:translation")[0][-1] - 0.1) < 1e-7


def test_a_failure_while_writing_leaves_nothing(tmp_path, monkeypatch):
    """Half a file would look like a short simulation."""
    world = World().finalize().record(tmp_path / "half.rrd")
    monkeypatch.setattr(RerunRecorder, "_write", lambda *_: 1 / 0)
    world.simulator.AdvanceTo(0.1)
    with pytest.raises(ZeroDivisionError):
        world.recorder.close()
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    world.recorder.close()
    assert rerun("rrd", "verify", tmp_path / "half.rrd").returncode == 0


def test_rerun_switched_off_writes_nothing_and_says_so(tmp_path, monkeypatch):
    """Rerun's own environment variable would otherwise leave an empty file."""
    monkeypatch.setenv("RERUN", "off")
    world = World().finalize().record(tmp_path / "off.rrd")
    with pytest.warns(UserWarning, match="RERUN=off"):
        world.recorder.close()
    assert list(tmp_path.iterdir()) == []


def test_going_back_in_time_starts_over_from_there(tmp_path):
    """A simulator initialized anew does not leave two samples of the same instant."""
    world = World().finalize().record(tmp_path / "again.rrd", period=1 / 16)
    world.simulator.AdvanceTo(4 / 16)
    world.simulator.get_mutable_context().SetTime(2 / 16)
    world.simulator.Initialize()
    world.simulator.AdvanceTo(3 / 16)
    world.recorder.flush()
    times, _ = read(world.recorder.path, "/world/ball/body", "Transform3D:translation")
    np.testing.assert_allclose(times, np.arange(4) / 16, atol=1e-9)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def viewer():
    """One that nobody has started."""
    return rr.GrpcSink(f"rerun+http://127.0.0.1:{free_port()}/proxy")


def looked_at(world, path):
    """Replaces the viewer by a file."""
    world.recorder._viewers = [rr.FileSink(path)]
    return world


@pytest.fixture
def at_once(monkeypatch):
    """Batches of a single sample."""
    monkeypatch.setattr(recorder, "_BATCH_S", 0.0)


def test_batches_add_up_to_what_the_file_holds(tmp_path, at_once):
    """Poses, contact and states, of which some begin in a later batch."""
    world = World(height=0.1).finalize()
    phase = steps(world.builder, [0, 0.2, 1], [[0, 1, 1]])
    world.record(tmp_path / "file.rrd", specs={"phase": StateSpec(phase, ["fall", "rest"])})
    looked_at(world, tmp_path / "seen.rrd")
    with world.recorder:
        world.simulator.AdvanceTo(0.5)
    file, seen = tmp_path / "file.rrd", tmp_path / "seen.rrd"
    assert entities(file) - {"/__properties"} <= entities(seen)
    for entity, component in (
        ("/world/ball/body", "Transform3D:translation"),
        ("/world/contact/forces", "Arrows3D:vectors"),
        ("/phase", "StateChange:state"),
    ):
        times, values = read(file, entity, component)
        seen_times, seen_values = read(seen, entity, component)
        np.testing.assert_allclose(seen_times, times, atol=1e-9)
        assert len(values) > 1
        for value, seen_value in zip(values, seen_values, strict=True):
            np.testing.assert_array_equal(seen_value, value)
    # What is touched for the first time in a later batch has a series from there on.
    times, _ = read(seen, "/contact/force/ball/body", "Scalars:scalars")
    assert 0.05 < times[0] < 0.2
    assert times[-1] == pytest.approx(0.5)
    assert rerun("rrd", "verify", seen).returncode == 0


def test_without_a_file_samples_are_dropped_once_sent(tmp_path, at_once):
    """A session may go on for hours."""
    world = looked_at(World().finalize().record(None, viewers=[viewer()]), tmp_path / "seen.rrd")
    assert world.recorder.path is None
    with world.recorder:
        world.simulator.AdvanceTo(0.2)
        assert len(world.recorder._samples) == 0
    times, _ = read(tmp_path / "seen.rrd", "/world/ball/body", "Transform3D:translation")
    np.testing.assert_allclose(times, np.arange(11) * 0.02, atol=1e-9)


@pytest.mark.slow
def test_a_server_and_a_file_record_at_once_and_a_missing_viewer_causes_a_warning(tmp_path, monkeypatch):
    """The server listens while the simulation runs, and the file is whole after it.

    A viewer that one forgets to start, or closes, costs the file nothing.
    """
    monkeypatch.setattr("geort_drake.rerun.writer.FLUSH_TIMEOUT", 0.1)
    port = free_port()
    viewers = [rr.GrpcServerSink("127.0.0.1", port), viewer()]
    world = World().finalize().record(tmp_path / "file.rrd", viewers=viewers)
    world.simulator.AdvanceTo(0.1)

    def connected():
        with socket.socket() as client:
            return client.connect_ex(("127.0.0.1", port)) == 0

    wait_for(connected, 60.0, lambda: "nobody listens")
    with pytest.warns(UserWarning, match="viewer did not receive all data"):
        world.recorder.close()
    assert rerun("rrd", "verify", tmp_path / "file.rrd").returncode == 0
    times, _ = read(tmp_path / "file.rrd", "/world/ball/body", "Transform3D:translation")
    assert times[-1] == pytest.approx(0.1)


def test_a_forced_publish_takes_a_sample(tmp_path):
    """What is not simulated but moved by hand can be recorded, as Drake's other visualizers do."""
    world = World().finalize().record(tmp_path / "forced.rrd", period=100.0)
    root = world.simulator.get_mutable_context()
    diagram = world.simulator.get_system()
    for time in (0.0, 0.5):
        root.SetTime(time)
        world.plant.GetJointByName("shoulder").set_angle(world.context, time)
        diagram.ForcedPublish(root)
    world.recorder.close()
    times, turns = read(tmp_path / "forced.rrd", "/world/arm/upper", "Transform3D:quaternion")
    assert times == pytest.approx([0.0, 0.5])
    np.testing.assert_allclose(turns[-1][0], [0, np.sin(0.25), 0, np.cos(0.25)], atol=1e-6)


def views_of(part, page=""):
    """Every view in a part of a layout, with the title of its page."""
    for inner in part.contents:
        if isinstance(inner, rrb.View):
            yield page, inner
        else:
            yield from views_of(inner, inner.name or page)


@pytest.fixture
def laid_out(monkeypatch):
    """Page and view of each title of the default layout, once it has been made."""
    views = {}

    def layout(*arguments):
        blueprint = default_layout(*arguments)
        views.update({view.name: (page, view) for page, view in views_of(blueprint.root_container)})
        return blueprint

    monkeypatch.setattr(recorder_module, "default_layout", layout)
    return views


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
    plots = [title for title in laid_out if title != "scene"]
    assert plots == ["contact force [N]", "thumb [rad]", "index [rad]", "all [N m]"]
    assert [laid_out[title][0] for title in plots] == ["angles"] * 3 + ["torques"]
    assert laid_out["thumb [rad]"][1].contents == ["/joints/command/thumb", "/joints/measured/thumb"]
    # Rerun's 55 degrees contain the tube, which extends 0.22 m from its origin.
    eye = laid_out["scene"][1].properties["EyeControls3D"]
    ends = [field.as_arrow_array().to_pylist()[0] for field in (eye.position, eye.look_target)]
    assert np.linalg.norm(np.subtract(*ends)) > 0.22 / np.sin(np.radians(27.5))


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
    _, view = laid_out["arm"]
    assert (view.origin, view.contents) == ("/world/arm/upper", ["/world/**"])
    controls = view.properties["EyeControls3D"]
    eye, up = (field.as_arrow_array().to_pylist()[0] for field in (controls.position, controls.eye_up))
    np.testing.assert_allclose(eye, [0.3, 0, 0.1], atol=1e-6)
    # The last sample may be one step of the plant earlier.
    np.testing.assert_allclose(up, X_WU.rotation().matrix()[2], atol=0.02)
    assert set(view.visualizer_overrides) == {"/world/path", "/world/ball/body/ellipsoids"}
    (rgba,) = view.visualizer_overrides["/world/ball/body/ellipsoids"].colors.as_arrow_array().to_pylist()
    assert rgba >> 8 == 0x336699 and 0 < rgba & 255 < 255
    assert set(laid_out["scene"][1].visualizer_overrides) == {"/world/path"}


@pytest.mark.parametrize("height", [-0.2, 0.2])
def test_a_close_up_does_not_look_up_through_the_table(height, tmp_path, laid_out):
    """An eye that would be below its target at the end is above it instead, seen from the same side."""
    world = World(height=2.0).finalize()
    spec = CloseUpSpec(world.plant.GetFrameByName("upper"), eye=(0.3, 0.1, height))
    world.record(tmp_path / "close.rrd", close_ups={"arm": spec})
    with world.recorder:
        world.simulator.AdvanceTo(0.3)
        R_WU = world.plant.EvalBodyPoseInWorld(world.context, world.upper).rotation().matrix()
    position = laid_out["arm"][1].properties["EyeControls3D"].position
    p_WE, before = R_WU @ position.as_arrow_array().to_pylist()[0], R_WU @ spec.eye
    assert (before[2] > 0) == (height > 0)
    np.testing.assert_allclose(p_WE, [*before[:2], abs(before[2])], atol=0.02)


def test_a_plant_inside_another_diagram_is_recorded_by_exported_ports(tmp_path):
    """Without them, Drake says that the ports are in another diagram."""
    world, outer, names = World(height=2.0).finalize(), DiagramBuilder(), ("body_poses", "contact_results")
    for name in names:
        world.builder.ExportOutput(world.plant.GetOutputPort(name), name)
    robot = outer.AddNamedSystem("robot", world.builder.Build())
    with pytest.raises((RuntimeError, SystemExit), match="plant"):
        add_rerun_recorder(DiagramBuilder(), world.plant, world.scene_graph, tmp_path / "no.rrd")
    ports = {name: robot.GetOutputPort(name) for name in names}
    recorder = add_rerun_recorder(
        outer, world.plant, world.scene_graph, tmp_path / "in.rrd", plant_ports=ports, period=0.1
    )
    add_rerun_recorder(outer, world.plant, world.scene_graph, tmp_path / "2.rrd", plant_ports=ports)
    simulator = Simulator(outer.Build())
    with recorder:
        simulator.AdvanceTo(0.3)
    _, found = read(recorder.path, "/world/ball/body", "Transform3D:translation")
    heights = np.array(found)[:, 0, 2]
    assert heights[0] == pytest.approx(2.0, abs=0.01) and (np.diff(heights) < 0).all()

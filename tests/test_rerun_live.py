"""Live viewers get the same data as the file, in batches, and never delay it."""

import socket

import numpy as np
import pytest
import rerun as rr
from rerun_world import World, entities, read, rerun, steps

from geort_drake.live.transports import wait_for
from geort_drake.rerun import StateSpec, recorder


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
    world = World().finalize()
    world.record(None, viewers=[viewer()])
    looked_at(world, tmp_path / "seen.rrd")
    assert world.recorder.path is None
    with world.recorder:
        world.simulator.AdvanceTo(0.2)
        assert len(world.recorder._samples) == 0
    times, _ = read(tmp_path / "seen.rrd", "/world/ball/body", "Transform3D:translation")
    np.testing.assert_allclose(times, np.arange(11) * 0.02, atol=1e-9)


def test_a_server_and_a_file_at_once(tmp_path):
    """The server listens while the simulation runs, and the file is whole after it."""
    port = free_port()
    world = World().finalize()
    server = rr.GrpcServerSink("127.0.0.1", port)
    world.record(tmp_path / "file.rrd", viewers=[server])
    world.simulator.AdvanceTo(0.1)

    def connected():
        with socket.socket() as viewer:
            return viewer.connect_ex(("127.0.0.1", port)) == 0 or None

    wait_for(connected, 60.0, lambda: "nobody listens")
    world.recorder.close()
    times, _ = read(tmp_path / "file.rrd", "/world/ball/body", "Transform3D:translation")
    assert times[-1] == pytest.approx(0.1)


def test_a_viewer_that_is_not_there_costs_the_file_nothing(tmp_path, monkeypatch):
    """One forgets to start the viewer, or closes it."""
    monkeypatch.setattr("geort_drake.rerun.writer.FLUSH_TIMEOUT", 0.1)
    world = World().finalize()
    world.record(tmp_path / "file.rrd", viewers=[viewer()])
    world.simulator.AdvanceTo(0.1)
    with pytest.warns(UserWarning, match="viewer did not receive all data"):
        world.recorder.close()
    assert rerun("rrd", "verify", tmp_path / "file.rrd").returncode == 0


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

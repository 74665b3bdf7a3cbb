"""The Rerun recorder on a small world; files are read back with Rerun's own reader and tools."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rerun_world import GRAVITY, World, read, rerun
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError
from geort_drake.rerun import RerunRecorder, take_screenshot


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
    ids = {RrdReader(path).recordings()[0].recording_id for path in paths}
    assert len(ids) == 1
    other = (
        World(height=0.07)
        .finalize()
        .record(tmp_path / "other" / "trial.rrd", properties={"seed": 3}, until=0.2)
    )
    compared = rerun("rrd", "compare", "--unordered", paths[0], other.recorder.path)
    assert compared.returncode != 0


def test_a_screenshot_is_a_picture_or_a_reason(tmp_path, monkeypatch):
    """Without a graphics driver the error says what to install; a missing file is named."""
    monkeypatch.setattr("geort_drake.rerun.screenshot._NOTICE", 0.0)
    world = World().finalize().record(tmp_path / "seen.rrd", until=0.1)
    picture = tmp_path / "pictures" / "seen.png"
    with pytest.raises(RecordingError, match="no such recording"):
        take_screenshot(tmp_path / "missing.rrd", picture)
    try:
        take_screenshot(world.recorder.path, picture, size=(320, 240))
    except RecordingError as error:
        assert "mesa-vulkan-drivers" in str(error)
        assert not picture.exists()
    else:
        assert picture.read_bytes().startswith(b"\x89PNG")


# -- when the file is written, and that it is whole or absent


def test_properties_keep_their_types_from_one_recording_to_the_next(tmp_path):
    """Rerun remembers the first type of a name; that must not leak between recordings."""
    for number, seed in enumerate((3, "three", 3.5, True)):
        world = World().finalize()
        world.record(tmp_path / f"{number}.rrd", properties={"seed": seed})
        world.recorder.set_properties({"outcome": "held"})
        world.recorder.close()
        _, value = read(world.recorder.path, "/__properties/run", "seed")
        assert value[0].tolist() == [seed]
        _, value = read(world.recorder.path, "/__properties/run", "outcome")
        assert value[0].tolist() == ["held"]


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
    times, _ = read(world.recorder.path, "/world/ball/body", "Transform3D:translation")
    assert times[-1] == pytest.approx(0.1)


def test_a_failure_while_writing_leaves_nothing(tmp_path, monkeypatch):
    """Half a file would look like a short simulation."""
    world = World().finalize().record(tmp_path / "half.rrd")
    world.simulator.AdvanceTo(0.1)
    monkeypatch.setattr(RerunRecorder, "_write", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        world.recorder.close()
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    world.recorder.close()
    assert rerun("rrd", "verify", world.recorder.path).returncode == 0


def test_rerun_switched_off_writes_nothing_and_says_so(tmp_path, monkeypatch):
    """Rerun's own environment variable would otherwise leave an empty file."""
    monkeypatch.setenv("RERUN", "off")
    world = World().finalize().record(tmp_path / "off.rrd")
    with pytest.warns(UserWarning, match="RERUN=off"):
        world.recorder.close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_written_when_the_process_ends_without_close(tmp_path):
    """Also after an uncaught exception."""
    code = f"""
        import sys
        sys.path.insert(0, {str(sys.path[0])!r})
        from rerun_world import World
        world = World().finalize().record({str(tmp_path / "exit.rrd")!r})
        world.simulator.AdvanceTo(0.1)
        raise SystemExit("no close")
    """
    folder = __file__.rsplit("/", 1)[0]
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=folder, capture_output=True, text=True, check=False
    )
    assert "no close" in done.stderr
    times, _ = read(tmp_path / "exit.rrd", "/world/ball/body", "Transform3D:translation")
    assert times[-1] == pytest.approx(0.1)


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

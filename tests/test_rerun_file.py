"""When a recording is written, and that it is whole or absent."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from rerun_world import World, read, rerun


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
    monkeypatch.setattr(type(world.recorder._tracks[-1].spec), "write", lambda *_: 1 / 0)
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


def test_closing_twice_or_going_on_changes_nothing(tmp_path):
    """The file is written once."""
    world = World().finalize().record(tmp_path / "new" / "folder" / "once.rrd")
    world.simulator.AdvanceTo(0.1)
    world.recorder.close()
    written = world.recorder.path.read_bytes()
    world.simulator.AdvanceTo(0.2)
    world.recorder.close()
    assert world.recorder.path.read_bytes() == written
    assert world.recorder.times[-1] == pytest.approx(0.1)


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
    np.testing.assert_allclose(world.recorder.times, np.arange(4) / 16, atol=1e-9)
    world.recorder.flush()
    times, _ = read(world.recorder.path, "/world/ball/body", "Transform3D:translation")
    np.testing.assert_allclose(times, np.arange(4) / 16, atol=1e-9)

"""Runs and recordings in the formats of other programs, read back by readers that are not ours."""

import dataclasses
import json

import numpy as np
import pyarrow
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest
from rerun.experimental import LeRobotReader
from scipy.spatial.transform import Rotation

from geort_drake import Recording, synthesize_play
from geort_drake.cli import run_command
from geort_drake.errors import OutputError, RecordingError
from geort_drake.export.episode import episode_of, read_episodes
from geort_drake.export.lerobot import write_lerobot
from geort_drake.export.parquet import rows, write_parquet

# Joints, and their places in `command`.
JOINTS = {"joints.{}.thumb.j0": 0, "joints.{}.thumb.j1": 1, "joints.{}.index.j2": 2,
          "arm.{}.shoulder": 3, "arm.{}.elbow": 4}  # fmt: skip
FRAMES = {"cube-0": 30, "cube-1": 20, "sphere-0": 10}
PERIOD = 0.02
SCENARIO = "Resolved:\n  hand: allegro_right\n  hand_parent: adapter::hand_side\n"


def command(t):
    """Of the hand's joints, then of the arm's."""
    return np.array([np.sin(t), 0.1 * t, -0.3, np.cos(t), 0.5])


def pose(body, t):
    """X_WB (7,) of a body that turns and rises."""
    turn = Rotation.from_euler("z", body + t).as_quat(scalar_first=True)
    return np.array([*turn, 0.1 * body, 0.0, t])


def glove(seconds):
    """Of another rate than the robot's, with a tracker, lost from 0.1 to 0.2 s."""
    play = synthesize_play(3, seconds, 100.0)
    X_WH = np.column_stack([np.tile([1.0, 0, 0, 0], (len(play), 1)), play.t, play.t, play.t])
    valid = (play.t < 0.1) | (play.t > 0.2)
    return Recording(play.t, play.p_HK, valid, X_WH, {**play.metadata, "source": "test"})


@pytest.fixture
def run(tmp_path):
    """A run of three trials, written as the simulation writes it; the robot lags its commands by 0.1 rad."""
    folder = tmp_path / "run"
    trials = []
    for number, (name, frames) in enumerate(FRAMES.items()):
        thing = name.partition("-")[0]
        t = PERIOD * np.arange(frames)
        asked = np.array([command(time) for time in t])
        columns = {"t": t}
        for body, model in enumerate(("hand.palm", f"{thing}.{thing}", "adapter.plate")):
            columns[f"pose.{model}"] = rows(np.array([pose(body, time) for time in t]))
        for kind, lag in (("command", 0.0), ("measured", 0.1)):
            for joint, place in JOINTS.items():
                columns[joint.format(kind)] = asked[:, place] - lag
        columns["state.grasp"] = np.where(t > 0.1, "hold", "reach")
        folder.mkdir(exist_ok=True)
        pq.write_table(pyarrow.table(columns), folder / f"{name}.parquet")
        glove(frames * PERIOD).save(folder / f"{name}.glove.npz")
        trials.append({"object": thing, "seed": int(name[-1]), "success": number == 0, "outcome": "success",
                       "phase_times": {"HOLD": 0.1}})  # fmt: skip
    (folder / "results.json").write_text(json.dumps({"trials": trials}))
    (folder / "scenario.yaml").write_text(SCENARIO)
    return folder


def test_parquet_holds_the_run(run, tmp_path):
    """Arrow reads one table of all frames, null where the hand was lost, and one of the trials.

    Each object has a column of poses, null in other trials.
    """
    output = tmp_path / "out"
    assert list(write_parquet(read_episodes(run), output)) == list(FRAMES)
    frames = pyarrow.dataset.dataset(output / "frames").to_table().to_pylist()
    assert len(frames) == 60
    poses = [name for name in frames[0] if name.startswith("pose.")]
    given = {(row["episode"], name) for row in frames for name in poses if row[name] is not None}
    assert given == {
        (episode, f"pose.{body}")
        for episode in FRAMES
        for body in ("hand.palm", "adapter.plate", f"{episode[:-2]}.{episode[:-2]}")
    }
    row = next(row for row in frames if row["episode"] == "cube-0" and row["t"] == pytest.approx(0.4))
    assert row["joints.command.thumb.j1"] == pytest.approx(0.04)
    assert row["joints.measured.thumb.j1"] == pytest.approx(-0.06)
    assert (row["arm.command.elbow"], row["arm.measured.elbow"]) == (pytest.approx(0.5), pytest.approx(0.4))
    assert row["state.grasp"] == "hold"
    assert row["pose.cube.cube"][4:] == pytest.approx([0.1, 0.0, 0.4])
    recorded = Recording.load(run / "cube-0.glove.npz")
    np.testing.assert_array_equal(row["glove.p_HK"], recorded.p_HK[40].ravel())
    np.testing.assert_allclose(row["glove.X_WH"], recorded.X_WH[40])
    lost = [row for row in frames if not row["glove.valid"]]
    assert lost
    assert all(row["glove.p_HK"] is None and row["glove.X_WH"] is None for row in lost)
    trials = pq.read_table(output / "episodes.parquet").to_pylist()
    assert [(trial["episode"], trial["success"], trial["frames"]) for trial in trials] == [
        ("cube-0", True, 30), ("cube-1", False, 20), ("sphere-0", False, 10)
    ]  # fmt: skip
    assert json.loads(trials[0]["phase_times"]) == {"HOLD": 0.1}


def test_rerun_reads_the_lerobot_dataset(run, tmp_path):
    """Episodes, actions and observations are what was recorded; the glove's newest frame at each time.

    A lost hand stays where it was seen: a dataset for learning contains no numbers that mean nothing.
    """
    output = tmp_path / "dataset"
    assert list(write_lerobot(read_episodes(run), output)) == list(FRAMES)
    reader = LeRobotReader(output)
    assert (reader.version, reader.episodes()) == ("v3", [0, 1, 2])
    for number, (name, frames) in enumerate(FRAMES.items()):
        features, t = {}, PERIOD * np.arange(frames)
        for chunk in reader.stream(number):
            batch = chunk.to_record_batch()
            if "Scalars:scalars" in batch.schema.names:
                values = batch.column("Scalars:scalars").to_pylist()
                features[chunk.entity_path.strip("/")] = np.array(values)
        asked = np.array([command(time) for time in t])
        np.testing.assert_allclose(features["action"], asked, atol=1e-6)
        np.testing.assert_allclose(features["observation.state"], asked - 0.1, atol=1e-6)
        for body, feature in enumerate(("observation.hand_pose", "observation.environment_state")):
            turn = Rotation.from_rotvec(np.outer(body + t, [0, 0, 1])).as_quat(scalar_first=True)
            place = np.outer(t, [0, 0, 1]) + [0.1 * body, 0, 0]
            np.testing.assert_allclose(features[feature], np.hstack([turn, place]), atol=1e-6)
        glove = Recording.load(run / f"{name}.glove.npz")
        seen = glove.valid[::2]
        assert 2 < (~seen).sum() < frames
        newest = np.maximum.accumulate(np.where(seen, np.arange(frames), 0))
        expected = glove.p_HK[::2][newest].reshape(frames, 63)
        np.testing.assert_allclose(features["observation.glove"], expected, atol=1e-6)


def test_the_lerobot_layout_is_the_documented_one(run, tmp_path):
    """info.json, tasks, episodes and statistics have the keys and types of codebase version 3.0."""
    output = tmp_path / "dataset"
    list(write_lerobot(read_episodes(run), output, fps=25))
    info = json.loads((output / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 25, "allegro_right")
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 30, 2)
    assert info["splits"] == {"train": "0:3"}
    assert info["features"]["observation.environment_state"]["shape"] == [7]  # also of several objects
    files = [output / info["data_path"].format(chunk_index=0, file_index=number) for number in range(3)]
    data = pyarrow.dataset.dataset(files).to_table()
    assert set(info["features"]) == set(data.schema.names)
    rows = data.to_pylist()
    assert [row["index"] for row in rows] == list(range(30))
    assert [row["frame_index"] for row in rows] == [*range(15), *range(10), *range(5)]
    assert [row["next.done"] for row in rows].count(True) == 3
    assert [i for i, row in enumerate(rows) if row["next.success"]] == [14]
    episodes = pq.read_table(output / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"], e["length"]) for e in episodes] == [
        (0, 15, 15), (15, 25, 10), (25, 30, 5)
    ]  # fmt: skip
    tasks = ["grasp the cube", "grasp the sphere"]
    assert [e["tasks"] for e in episodes] == [tasks[:1], tasks[:1], tasks[1:]]
    statistics = json.loads((output / "meta" / "stats.json").read_text())
    actions = np.array([row["action"] for row in rows])
    np.testing.assert_allclose(statistics["action"]["mean"], actions.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(statistics["action"]["std"], actions.std(axis=0), atol=1e-6)
    assert statistics["action"]["count"] == [30]
    table = pq.read_table(output / "meta" / "tasks.parquet")
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    assert table.to_pylist() == [{"task_index": i, "task": task} for i, task in enumerate(tasks)]


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "results.json").unlink(), "results.json is missing; a run is a folder"),
        (lambda f: (f / "results.json").write_text("{}"), "not the results of geort-drake grasp"),
        (lambda f: (f / "cube-1.parquet").unlink(), "cube-1 lacks cube-1.parquet; .* without --no-rerun"),
        (lambda f: cut(f / "cube-0.parquet"), "cube-0.parquet: not readable"),
    ],
)
def test_incomplete_runs_are_refused(run, tmp_path, spoil, message):
    """And nothing is left behind."""
    spoil(run)
    with pytest.raises(RecordingError, match=message):
        list(write_parquet(read_episodes(run), tmp_path / "out"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


def test_a_session_without_an_outcome_is_exported(tmp_path):
    """Such as the log of a live session that was killed."""
    play = synthesize_play(0, 1.0, 30.0)
    names = [joint.format(kind) for kind in ("command", "measured") for joint in JOINTS]
    signals = {**play.metadata, "robot_signals": names}
    session = dataclasses.replace(play, robot=np.zeros((len(play), len(names))), metadata=signals)
    list(write_lerobot([episode_of(session, "session")], tmp_path / "out"))
    (episodes,) = (tmp_path / "out" / "meta" / "episodes").rglob("*.parquet")
    (row,) = pq.read_table(episodes).to_pylist()
    assert (row["outcome"], row["tasks"]) == ("unknown", ["teleoperate the robot"])


def test_unsuitable_exports_are_refused(run, tmp_path):
    """No robot in a LeRobot dataset, other joints in the same dataset, another folder in its place."""
    play = synthesize_play(0, 2.0, 30.0)
    with pytest.raises(RecordingError, match="no robot, so export it as Parquet"):
        list(write_lerobot([episode_of(play, "play")], tmp_path / "out"))
    first, second, _ = read_episodes(run)
    columns = second.samples.drop_columns([second.names_of("command")[0]])
    second = dataclasses.replace(second, samples=columns)
    with pytest.raises(RecordingError, match="cube-1: its action differs from earlier episodes"):
        list(write_lerobot([first, second], tmp_path / "out"))
    with pytest.raises(OutputError, match="is not an earlier export"):
        list(write_parquet(read_episodes(run), run))
    with pytest.raises(OutputError, match="Rerun recordings already"):
        run_command("export", [str(run), "--output", str(tmp_path / "x.rrd"), "--format", "rrd"])

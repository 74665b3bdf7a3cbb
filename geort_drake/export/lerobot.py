"""Writes episodes as a LeRobot dataset, codebase version 3.0, with a file for each.

The layout is that of https://huggingface.co/docs/lerobot/lerobot-dataset-v3. It does not use
LeRobot's own writer, whose package requires about a hundred others and pins old versions of torch and Rerun,
nor `lerobot-dataset`, which brings twenty others and an older NumPy.
"""

import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from geort_drake.errors import RecordingError
from geort_drake.export.episode import Episode
from geort_drake.export.parquet import rows
from geort_drake.files import atomic_directory, require_replaceable
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import ARM, HAND

VERSION = "v3.0"
INFO, STATS, TASKS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
_FILES_PER_CHUNK = 1000
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_POSE = ["qw", "qx", "qy", "qz", "x", "y", "z"]
_KEYPOINTS = [f"{axis}{keypoint}" for keypoint in range(21) for axis in "xyz"]
# Name → values (T, n), and names of the n numbers or None.
Features = dict[str, tuple[np.ndarray, list[str] | None]]


def write_lerobot(
    episodes: Iterable[Episode], output: str | os.PathLike, fps: int | None = None
) -> Iterator[str]:
    """Writes a dataset atomically and yields the name of each finished episode.

    Args:
        episodes: episodes of the same robot.
        output: path of the dataset's folder.
        fps: frames per second; by default the rate of the first episode. Each frame contains the latest
            sample.

    Raises:
        RecordingError: an episode has no robot, or other features than the first.
        OutputError: `output` exists and is no dataset.
    """
    require_replaceable(output, INFO)
    description: dict[str, dict] = {}
    tasks: dict[str, int] = {}
    lines: list[dict] = []  # one per episode
    columns: dict[str, list[np.ndarray]] = {}  # of all episodes, for the statistics
    robot, total = None, 0
    with atomic_directory(output) as draft:
        for number, recorded_episode in enumerate(episodes):
            if fps is None:
                fps = max(1, round(1.0 / float(np.median(np.diff(recorded_episode.t)))))
            frames = int(recorded_episode.t[-1] * fps + 1e-6) + 1
            episode = recorded_episode.resampled(np.arange(frames) / fps)
            features = features_of(episode)
            task = "teleoperate the robot"  # a real robot, whose objects are unknown
            if "object" in episode.facts:
                task = f"grasp the {str(episode.facts['object']).replace('_', ' ')}"
            if episode.facts.get("task", "grasp") != "grasp":
                task = find_task(episode.facts["task"]).summary
            counters: dict[str, np.ndarray] = {
                "timestamp": episode.t.astype(np.float32),
                "frame_index": np.arange(frames),
                "episode_index": np.full(frames, number),
                "index": total + np.arange(frames),
                "task_index": np.full(frames, tasks.setdefault(task, len(tasks))),
            }
            features |= {name: (values[:, None], None) for name, values in counters.items()}
            kinds = {
                name: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": names}
                for name, (values, names) in features.items()
            }
            if not lines:
                description, robot = kinds, episode.robot
            elif kinds != description:
                names = {**description, **kinds}
                differing = [name for name in names if description.get(name) != kinds.get(name)]
                raise RecordingError(
                    f"{episode.name}: its {', '.join(differing)} differs from earlier episodes; all episodes "
                    "of a dataset must be of one robot"
                )
            chunk, file = divmod(number, _FILES_PER_CHUNK)
            data = pa.table({name: _column(values) for name, (values, _) in features.items()})
            _write(draft / DATA_PATH.format(chunk_index=chunk, file_index=file), data)
            statistics: dict[str, list] = {}
            for name, (values, _) in features.items():
                columns.setdefault(name, []).append(values)
                statistics |= {f"stats/{name}/{key}": value for key, value in _statistics(values).items()}
            lines.append(
                {
                    "episode_index": number,
                    "tasks": [task],
                    "length": frames,
                    "data/chunk_index": chunk,
                    "data/file_index": file,
                    "dataset_from_index": total,
                    "dataset_to_index": total + frames,
                    "meta/episodes/chunk_index": 0,
                    "meta/episodes/file_index": 0,
                    "name": episode.name,
                    "outcome": episode.facts.get("outcome") or "unknown",
                    "session": json.dumps(episode.facts.get("session", {})),
                    **statistics,
                }
            )
            total += frames
            yield episode.name
        _write(draft / EPISODES_PATH, pa.Table.from_pylist(lines))
        # LeRobot reads the tasks by pandas, with the text as index.
        table = pd.DataFrame({"task_index": tasks.values()}, index=pd.Index(tasks, name="task"))
        table.to_parquet(draft / TASKS)
        info = {
            "codebase_version": VERSION,
            "robot_type": robot,
            "total_episodes": len(lines),
            "total_frames": total,
            "total_tasks": len(tasks),
            "chunks_size": _FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": fps,
            "splits": {"train": f"0:{len(lines)}"},
            "data_path": DATA_PATH,
            "video_path": None,
            "features": description,
        }
        statistics_of_all = {name: _statistics(np.concatenate(arrays)) for name, arrays in columns.items()}
        for name, content in ((INFO, info), (STATS, statistics_of_all)):
            text = json.dumps(content, indent=2, allow_nan=False)
            (draft / name).write_text(text + "\n", encoding="utf-8")


def features_of(episode: Episode) -> Features:
    """Returns the observations and actions for a policy.

    Raises:
        RecordingError: the episode has no commands or no measured joints.
    """
    commands, measured = episode.names_of("command"), episode.names_of("measured")
    if not (commands and measured):
        raise RecordingError(
            f"{episode.name}: this recording has no robot, so export it as Parquet; a LeRobot dataset needs "
            "a robot's commands and measured joint positions"
        )
    frames = len(episode.t)
    last = np.arange(frames) == frames - 1
    # While the hand is lost, its last pose is repeated.
    last_valid = np.maximum.accumulate(np.where(episode.glove.valid, np.arange(frames), 0))
    floats: Features = {
        "action": (episode.values(commands), commands),
        "observation.state": (episode.values(measured), measured),
        "observation.glove": (episode.glove.p_HK[last_valid].reshape(frames, 63), _KEYPOINTS),
    }
    poses = episode.poses()
    model_of = {body: body.partition(".")[0] for body in poses}
    # The robot hand's first moving body; a hand on a fixed base has none.
    if (palm := next((body for body in poses if model_of[body] == HAND), None)) is not None:
        floats["observation.hand_pose"] = (poses[palm], _POSE)
    robot = (ARM, HAND, episode.carrier)
    if object_poses := {body: X_WB for body, X_WB in poses.items() if model_of[body] not in robot}:
        names = (
            _POSE if len(object_poses) == 1 else [f"{body}.{name}" for body in object_poses for name in _POSE]
        )
        floats["observation.environment_state"] = (np.concatenate([*object_poses.values()], axis=1), names)
    if episode.glove.X_WH is not None:
        floats["observation.wrist"] = (episode.glove.X_WH[last_valid], _POSE)
    features: Features = {
        name: (values.astype(np.float32), labels) for name, (values, labels) in floats.items()
    }
    features["next.done"] = (last[:, None], None)
    if "success" in episode.facts:
        features["next.success"] = ((last & bool(episode.facts["success"]))[:, None], None)
    return features


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def _column(values: np.ndarray) -> pa.Array:
    """Makes a column of scalars for a feature of size 1, else of lists."""
    return pa.array(values[:, 0]) if values.shape[1] == 1 else rows(values)


def _statistics(values: np.ndarray) -> dict[str, list]:
    """Computes LeRobot's statistics of values (T, n): lists of n numbers, and a single count."""
    numbers = values.astype(float)
    quantiles = np.quantile(numbers, list(_QUANTILES.values()), axis=0)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": numbers.mean(axis=0).tolist(),
        "std": numbers.std(axis=0).tolist(),
        "count": [len(values)],
        **{name: row.tolist() for name, row in zip(_QUANTILES, quantiles, strict=True)},
    }

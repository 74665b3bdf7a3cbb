"""Episodes: recordings of all signals of the glove and the robot at common times."""

import dataclasses
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from geort_drake.errors import RecordingError
from geort_drake.people.recording import Recording, newest
from geort_drake.simulation.scenario import scenario_fields

RESULTS, SCENARIO = "results.json", "scenario.yaml"


@dataclasses.dataclass(frozen=True, eq=False)
class Episode:
    """A recording from beginning to end.

    Attributes:
        name: name of the recording, such as "cylinder-0".
        glove: the human hand, sampled at the times of `samples`.
        samples: a table as `RerunRecorder.table` makes it; its times t start at 0.
        facts: facts about the whole episode, JSON types only. For a trial, its entry in results.json and the
            metadata of the session that it replays.
        robot: name of the robot hand; None without a robot.
        carrier: model between arm and hand, such as an adapter; empty if there is none.
    """

    name: str
    glove: Recording
    samples: pa.Table
    facts: dict = dataclasses.field(default_factory=dict)
    robot: str | None = None
    carrier: str = ""

    @property
    def t(self) -> np.ndarray:
        """Times (T,), s."""
        return self.samples["t"].to_numpy()

    def names_of(self, kind: str) -> list[str]:
        """Returns the names of the columns with joint positions of a kind, "command" or "measured"."""
        return [name for name in self.samples.column_names if name.split(".")[1:2] == [kind]]

    def values(self, names: list[str]) -> np.ndarray:
        """Returns columns as an array (T, n)."""
        return np.stack([self.samples[name].to_numpy() for name in names], axis=1)

    def poses(self) -> dict[str, np.ndarray]:
        """Returns name of each moving body, such as "hand.link_3" → X_WB (T, 7), qw qx qy qz x y z."""
        columns = [name for name in self.samples.column_names if name.startswith("pose.")]
        return {
            name.removeprefix("pose."): np.stack(self.samples[name].to_numpy(zero_copy_only=False))
            for name in columns
        }

    def resampled(self, t: np.ndarray) -> "Episode":
        """Returns the episode resampled at times (T,), s, each with the latest sample up to then."""
        samples = self.samples.take(newest(self.t, t))
        samples = samples.set_column(samples.column_names.index("t"), "t", pa.array(np.asarray(t, float)))
        return dataclasses.replace(self, glove=self.glove.at(t), samples=samples)


def read_episodes(path: str | os.PathLike) -> Iterator[Episode]:
    """Reads the trials of a run, a folder that geort-drake grasp wrote.

    Raises:
        RecordingError: the folder is no such run, or a file of a trial is missing or damaged.
    """
    folder = Path(path)
    results = folder / RESULTS
    if not results.is_file():
        raise RecordingError(
            f"{folder}: {RESULTS} is missing; a run is a folder that geort-drake grasp or simulate wrote"
            if folder.exists()
            else f"{folder}: no such file or folder"
        )
    try:
        report = json.loads(results.read_text(encoding="utf-8"))
        trials = [{**trial, "session": report.get("session", {})} for trial in report["trials"]]
        names = [f"{trial['object']}-{trial['seed']}" for trial in trials]
        scenario = scenario_fields((folder / SCENARIO).read_text(encoding="utf-8"))
        robot, carrier = Path(scenario["hand"]).stem, scenario["hand_parent"].partition("::")[0]
    except (ValueError, KeyError, TypeError, OSError, RecursionError, yaml.YAMLError) as error:
        raise RecordingError(f"{folder}: not the results of geort-drake grasp: {error}") from error
    if not names:
        raise RecordingError(f"{results}: the run has no trials")
    for name in names:
        for file in (f"{name}.parquet", f"{name}.glove.npz"):
            if not (folder / file).is_file():
                raise RecordingError(
                    f"{folder}: trial {name} lacks {file}; an export needs it: simulate without --no-rerun"
                )
    for name, facts in zip(names, trials, strict=True):
        try:
            samples = pq.read_table(folder / f"{name}.parquet")
        except (pa.ArrowInvalid, OSError) as error:
            raise RecordingError(f"{folder / name}.parquet: not readable: {error}") from error
        glove = Recording.load(folder / f"{name}.glove.npz").at(samples["t"].to_numpy())
        yield Episode(name, glove, samples, facts, robot, carrier)


def episode_of(recording: Recording, name: str) -> Episode:
    """Makes an episode of a recording of a hand, with the joints of a real robot if it has them."""
    recording = dataclasses.replace(recording, t=recording.t - recording.t[0])
    facts, signals = recording.metadata, {}
    if recording.robot is not None:
        signals = dict(zip(facts["robot_signals"], recording.robot.T, strict=True))
    columns = {"t": recording.t, **{key: np.ascontiguousarray(values) for key, values in signals.items()}}
    return Episode(name, recording, pa.table(columns), facts, facts.get("hand"))

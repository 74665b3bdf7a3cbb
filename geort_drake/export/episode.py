"""Episodes: recordings of all signals of the glove and the robot at common times."""

import dataclasses
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from geort_drake.errors import RecordingError
from geort_drake.people.recording import Recording, newest
from geort_drake.rerun.reader import read_samples
from geort_drake.simulation.recording import HUMAN
from geort_drake.simulation.scenario import scenario_fields
from geort_drake.simulation.world import ARM, HAND

RESULTS, SCENARIO = "results.json", "scenario.yaml"


@dataclasses.dataclass(frozen=True, eq=False)
class Episode:
    """A recording from beginning to end. Names of signals, states and poses are entity paths with dots.

    Attributes:
        name: name of the recording, such as "cylinder-0".
        t: (T,) increasing times from 0, s.
        glove: the human hand, sampled at `t`.
        signals: name, such as "joints.command.thumb.joint_12" → (T,) joint angles in rad or forces in N.
        states: name → (T,) names of the state.
        poses: name → X_WB (T, 7) of each moving body as qw qx qy qz x y z, m.
        facts: facts about the whole episode, JSON types only. For a trial, its entry in results.json and the
            metadata of the session that it replays.
        robot: name of the robot hand; None without a robot.
        carrier: model between arm and hand, such as an adapter; empty if there is none.
    """

    name: str
    t: np.ndarray
    glove: Recording
    signals: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    states: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    poses: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    facts: dict = dataclasses.field(default_factory=dict)
    robot: str | None = None
    carrier: str = ""

    @property
    def command_names(self) -> list[str]:
        """Names of the signals with joint commands."""
        return [name for name in self.signals if name.split(".")[1:2] == ["command"]]

    @property
    def measured_names(self) -> list[str]:
        """Names of the signals with measured joint positions."""
        return [name for name in self.signals if name.split(".")[1:2] == ["measured"]]

    @property
    def hand_pose(self) -> np.ndarray | None:
        """X_WB (T, 7) of the robot hand's first moving body; None for a fixed base."""
        return next((X_WB for name, X_WB in self.poses.items() if name.partition(".")[0] == HAND), None)

    @property
    def handled_poses(self) -> dict[str, np.ndarray]:
        """Poses of the bodies that do not belong to the robot."""
        robot = (ARM, HAND, self.carrier)
        return {name: X for name, X in self.poses.items() if name.partition(".")[0] not in robot}

    def resampled(self, t: np.ndarray) -> "Episode":
        """Returns the episode resampled at times (T,), s, each with the latest sample up to then."""
        rows = newest(self.t, t)
        return dataclasses.replace(
            self,
            t=np.asarray(t, dtype=float),
            glove=self.glove.at(t),
            signals={name: values[rows] for name, values in self.signals.items()},
            states={name: values[rows] for name, values in self.states.items()},
            poses={name: values[rows] for name, values in self.poses.items()},
        )


def read_episodes(path: str | os.PathLike) -> Iterator[Episode]:
    """Reads the trials of a run, a folder that geort-drake grasp wrote.

    Raises:
        RecordingError: the folder is no such run, or a file of a trial is missing.
    """
    folder = Path(path)
    results = folder / RESULTS
    if not results.is_file():
        raise RecordingError(
            f"{folder}: {RESULTS} is missing; a run is a folder that geort-drake grasp wrote"
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
        for file in (f"{name}.rrd", f"{name}.glove.npz"):
            if not (folder / file).is_file():
                raise RecordingError(
                    f"{folder}: trial {name} lacks {file}; an export needs it: simulate without --no-rerun"
                )
    for name, facts in zip(names, trials, strict=True):
        samples = read_samples(folder / f"{name}.rrd")
        glove = Recording.load(folder / f"{name}.glove.npz").at(samples.t)
        # The person's hand is drawn next to the robot's, but is no body.
        bodies = {body: X for body, X in samples.poses.items() if body.partition(".")[0] != HUMAN}
        yield Episode(name, samples.t, glove, samples.signals, samples.states, bodies, facts, robot, carrier)


def episode_of(recording: Recording, name: str) -> Episode:
    """Makes an episode of a recording of a hand, with the joints of a real robot if it has them."""
    recording = dataclasses.replace(recording, t=recording.t - recording.t[0])
    facts, signals = recording.metadata, {}
    if recording.robot is not None:
        signals = dict(zip(facts["robot_signals"], recording.robot.T, strict=True))
    return Episode(name, recording.t, recording, signals, facts=facts, robot=facts.get("hand"))

"""Episodes: recordings with all signals of the glove and the robot at common times."""

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
    """One recording from beginning to end. Names of signals, states and poses are entity paths with dots.

    Attributes:
        name: of the recording, such as "cylinder-0".
        t: (T,) s from 0, increasing.
        glove: the human hand, sampled at `t`.
        signals: (T,) each, such as "joints.command.thumb.joint_12"; joint angles in rad, forces in N.
        states: (T,) each, the state's name.
        poses: X_WB (T, 7) of every moving body, qw qx qy qz x y z.
        facts: about the whole episode, JSON types; of a trial, its entry in results.json, and the metadata of
            the session that it replays.
        robot: name of the robot hand; None without a robot.
        carrier: model between arm and hand, such as an adapter; empty without one.
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
        """The signals with joint commands."""
        return [name for name in self.signals if name.split(".")[1:2] == ["command"]]

    @property
    def measured_names(self) -> list[str]:
        """The signals with measured joint positions."""
        return [name for name in self.signals if name.split(".")[1:2] == ["measured"]]

    @property
    def hand_pose(self) -> np.ndarray | None:
        """X_WB (T, 7) of the robot hand's first moving body; None on a fixed base."""
        return next((X_WB for name, X_WB in self.poses.items() if name.partition(".")[0] == HAND), None)

    @property
    def handled_poses(self) -> dict[str, np.ndarray]:
        """The poses of bodies that are not the robot's."""
        robot = (ARM, HAND, self.carrier)
        return {name: X for name, X in self.poses.items() if name.partition(".")[0] not in robot}

    def resampled(self, t: np.ndarray) -> "Episode":
        """The episode at other times (T,), s, each with the latest sample before it."""
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
    """The trials of a run, a folder that geort-drake grasp wrote.

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
        # The person's hand is drawn beside the robot's, and is no body.
        bodies = {body: X for body, X in samples.poses.items() if body.partition(".")[0] != HUMAN}
        yield Episode(name, samples.t, glove, samples.signals, samples.states, bodies, facts, robot, carrier)


def episode_of(recording: Recording, name: str) -> Episode:
    """A recording of a hand, and of the joints of a real robot if it has them."""
    recording = dataclasses.replace(recording, t=recording.t - recording.t[0])
    facts, signals = recording.metadata, {}
    if recording.robot is not None:
        signals = dict(zip(facts["robot_signals"], recording.robot.T, strict=True))
    return Episode(name, recording.t, recording, signals, facts=facts, robot=facts.get("hand"))

"""Replays recorded teleoperation sessions with random changes of the object.

A replay is open loop, so success against the size of a change shows how robust a motion is. A folder of
replays has the layout of a benchmark's folder; the `method` of a record is the session's name.
"""

import copy
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np

from geort_drake.benchmark.conditions import PERTURBATIONS, group_by_value, make_conditions
from geort_drake.benchmark.config import CONFIG, continue_config
from geort_drake.benchmark.folder import simulation_settings
from geort_drake.benchmark.records import Record, TrialKey
from geort_drake.benchmark.statistics import proportion
from geort_drake.benchmark.trials import Trial
from geort_drake.errors import RecordingError, ScenarioError, UnknownNameError
from geort_drake.files import sha256_of, write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.resources import object_names
from geort_drake.retargeting.checkpoint import WEIGHTS
from geort_drake.retargeting.method import Retarget
from geort_drake.retargeting.retargeter import UniversalRetargeter, load_retargeter, path_of, shipped_map
from geort_drake.simulation.scenario import Scenario, dump_scenario, scenario_fields
from geort_drake.simulation.scenario_files import check_scenario
from geort_drake.simulation.world import draw_placement


class _Config(TypedDict):
    settings: dict
    sessions: dict[str, dict]


class Replay:
    """Recorded sessions and the scenarios in which they are replayed.

    Args:
        scenario: scenario of the sessions; its ranges only affect the placement of a simulated session.
        sessions: recordings with wrist poses.
        side: side of the recorded hands; None for the robot hand's.
        object_name: the grasped object; None for the object in each session's metadata.
        retargeter: directory of a checkpoint, or a universal map by its hand's name or file, which is adapted
            to the person of each session; None for the map shipped for the hand.
        perturbations: name in `PERTURBATIONS` → sizes.
        trials: number of random draws per session and perturbation.

    Raises:
        RecordingError, ScenarioError, UnknownNameError, CheckpointError: an argument is unusable.
    """

    def __init__(
        self,
        scenario: Scenario,
        sessions: Sequence[Path],
        side: str | None,
        object_name: str | None,
        retargeter: Path | None,
        perturbations: Mapping[str, Sequence[float]],
        trials: int,
    ):
        description = load_hand(scenario.hand)
        self.recordings = _read_sessions(sessions, side or description.side)
        self.trials = trials
        self.hand = HandModel(description)
        path = shipped_map(self.hand) if retargeter is None else path_of(retargeter)
        retarget = load_retargeter(path, self.hand)
        self._retargets: dict[str, Retarget] = {
            name: retarget.for_person(recording.p_HK[recording.valid])
            if isinstance(retarget, UniversalRetargeter)
            else retarget
            for name, recording in self.recordings.items()
        }
        self.weights_sha256 = sha256_of(path if path.is_file() else path / WEIGHTS)
        self._scenarios = {
            name: as_recorded(scenario, recording, object_name) for name, recording in self.recordings.items()
        }
        # Name of a condition → session → scenario; the unchanged scenarios are under "".
        self._conditions: dict[str, dict[str, Scenario]] = {"": self._scenarios}
        for session, own in self._scenarios.items():
            check_scenario(own)
            for name, changed in make_conditions(own, perturbations, PERTURBATIONS).items():
                self._conditions.setdefault(name, {})[session] = changed

    def keys(self) -> list[TrialKey]:
        """Returns every trial; an unchanged session has only one, because nothing in it is random."""
        return [
            TrialKey(session, scenario.object.name, seed, condition)
            for seed in range(self.trials)
            for condition in self._conditions
            for session, scenario in self._scenarios.items()
            if condition or seed == 0
        ]

    def trial(self, key: TrialKey) -> Trial:
        """Returns a trial for a worker."""
        scenario = self._conditions[key.condition][key.method]
        recording = self.recordings[key.method]
        retarget = self._retargets[key.method]
        return Trial(key, dump_scenario(scenario), retarget, scenario.retargeting.latency, recording)

    def open(self, folder: Path) -> None:
        """Begins the replays in a folder, or continues them.

        Raises:
            BenchmarkError: the folder's trials were made with other settings.
        """
        config = {
            "settings": {"weights_sha256": self.weights_sha256, **simulation_settings(self.hand)},
            "sessions": {
                name: {
                    "recording_sha256": recording.digest,
                    "scenario": scenario_fields(dump_scenario(self._scenarios[name])),
                }
                for name, recording in self.recordings.items()
            },
        }
        continue_config(folder, config, _Config, ["sessions"])
        write_text(folder / CONFIG, json.dumps(config, indent=2, allow_nan=False) + "\n")


def as_recorded(scenario: Scenario, recording: Recording, object_name: str | None) -> Scenario:
    """Returns the scenario of a session, without random changes.

    The metadata of a simulated session contain object and seed, which determine the object's placement; for
    other sessions, the scenario does. The trial lasts for the session plus the required time of the hold.

    Raises:
        ScenarioError: neither the session nor `object_name` names the grasped object.
        UnknownNameError: there is no such object.
    """
    recorded = recording.metadata.get("object")
    if object_name is None and recorded is None:
        raise ScenarioError("the session does not name the grasped object; give it with --object")
    scenario = copy.deepcopy(scenario)
    scenario.object.name = str(object_name or recorded)
    if scenario.object.name not in object_names():
        raise UnknownNameError("object", scenario.object.name, object_names())
    config = scenario.object
    seed = recording.metadata.get("seed")
    if isinstance(seed, int) and recorded == config.name:
        drawn = draw_placement(scenario, 0.0, np.random.default_rng(seed))
        R = drawn.X_WO.rotation().matrix()
        config.position = [float(x) for x in drawn.X_WO.translation()[:2]]
        config.yaw = math.atan2(R[1, 0], R[0, 0])
        config.mass_factor, config.friction_factor = drawn.mass_factor, drawn.friction_factor
    config.position_range = config.yaw_range = config.mass_range = config.friction_range = 0.0
    scenario.timeout = float(recording.t[-1] - recording.t[0]) + scenario.monitor.hold_time
    return scenario


def summarize_replay(records: Iterable[Record]) -> dict:
    """Returns success for each perturbation and size over all sessions, and for each session; JSON-ready."""
    records = list(records)
    judged = [record for record in records if "error" not in record]
    unchanged = [record for record in judged if not record.get("condition")]
    panels = {}
    for name, perturbation in PERTURBATIONS.items():
        groups = group_by_value(judged, name)
        if groups:
            groups |= {0.0: unchanged} if unchanged else {}
            panels[name] = {
                "label": perturbation.label,
                "conditions": [
                    {"value": size, "nominal": False, "methods": {"replay": _success(groups[size])}}
                    for size in sorted(groups)
                ],
            }
    sessions = {}
    for name in sorted({record["method"] for record in records}):
        own = [record for record in judged if record["method"] == name]
        sessions[name] = {
            "unchanged": next((r["outcome"] for r in own if not r.get("condition")), None),
            "changed": _success([r for r in own if r.get("condition")]),
        }
    return {
        "trials": len(judged),
        "errors": len(records) - len(judged),
        "perturbations": panels,
        "sessions": sessions,
    }


def _success(records: Sequence[Record]) -> dict:
    return proportion(sum(record["success"] for record in records), len(records))


def _read_sessions(paths: Sequence[Path], side: str) -> dict[str, Recording]:
    recordings: dict[str, Recording] = {}
    for path in paths:
        name = path.name.removesuffix(".npz").removesuffix(".glove")
        if name in recordings:
            raise ScenarioError(f"{path}: another session has the name '{name}' too; rename one")
        recordings[name] = read_recording(path, side)
        if recordings[name].X_WH is None:
            raise ScenarioError(f"{path}: a replay needs wrist poses (X_WH); this recording has none")
        if not recordings[name].valid.any():
            raise RecordingError(f"{path}: valid: no frame shows a hand that is followed")
    return recordings

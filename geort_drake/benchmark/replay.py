"""Recorded sessions of teleoperation, replayed while the object is not quite as it was.

Nobody reacts in a replay, so success against the size of the change says how much a motion forgives.

FOLDER/config.json    what decides every trial; another run may add sessions, perturbations and trials
FOLDER/trials.jsonl   one line per finished trial, with the session's name as its `method`
FOLDER/summary.json, success.svg, report.md
"""

import copy
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypedDict

import numpy as np
import yaml

from geort_drake.benchmark.config import CONFIG, TRIALS, read_json, require_no_trials, require_same
from geort_drake.benchmark.folder import simulation_settings
from geort_drake.benchmark.plots import success_panels
from geort_drake.benchmark.sensitivity import condition_name
from geort_drake.benchmark.statistics import Record, proportion
from geort_drake.benchmark.trial import simulate
from geort_drake.benchmark.trial_log import TrialKey, read_records
from geort_drake.benchmark.workers import run_trials
from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.files import sha256_of, write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import WEIGHTS
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.simulation.diagram import Retarget
from geort_drake.simulation.scenario import Scenario, dump_scenario, object_names
from geort_drake.simulation.world import draw_placement


class Perturbation(NamedTuple):
    """A way in which the object can be changed."""

    # Field of the scenario's object that holds the largest change, and one unit of a size in its unit.
    field: str
    unit: float
    label: str
    sizes: tuple[float, ...]


PERTURBATIONS = {
    "position": Perturbation("position_range", 1e-3, "largest shift in x and y, mm", (5, 10, 20)),
    "yaw": Perturbation("yaw_range", math.radians(1), "largest turn, °", (5, 15, 30)),
    "mass": Perturbation("mass_range", 1.0, "largest change of mass, share", (0.2, 0.5, 0.8)),
    "friction": Perturbation("friction_range", 1.0, "largest change of friction, share", (0.2, 0.5, 0.8)),
}


class _Config(TypedDict):
    settings: dict
    sessions: dict[str, dict]


REPORT, SUMMARY, FIGURE = "report.md", "summary.json", "success.svg"


class Replay:
    """Sessions, and the scenarios that they are replayed in.

    Args:
        scenario: of the sessions; its ranges do not count but for the placement of a simulated session.
        sessions: files with wrist poses.
        side: of the recorded hands; None: the robot hand's.
        object_name: what was grasped; None: what each session says.
        retargeter: directory of a checkpoint.
        perturbations: name → sizes, in the units of `PERTURBATIONS`.
        trials: draws per session and perturbation.

    Raises:
        RecordingError, ScenarioError, UnknownNameError, CheckpointError: something of it cannot be used.
    """

    def __init__(
        self,
        scenario: Scenario,
        sessions: Sequence[Path],
        side: str | None,
        object_name: str | None,
        retargeter: Path,
        perturbations: Mapping[str, Sequence[float]],
        trials: int,
    ):
        description = load_hand(scenario.hand)
        self.recordings = _read_sessions(sessions, side or description.side)
        self.conditions = {
            condition_name(name, size): (name, size)
            for name, sizes in perturbations.items()
            for size in sizes
            if size > 0
        }
        self.trials = trials
        self.hand = HandModel(description)
        self.retarget: Retarget = load_retargeter(retargeter, self.hand)
        self.weights = sha256_of(Path(retargeter) / WEIGHTS)
        self._scenarios = {
            name: as_recorded(scenario, recording, object_name) for name, recording in self.recordings.items()
        }
        for key in self.keys():
            self.scenario(key).validate()

    def keys(self) -> list[TrialKey]:
        """Every trial; without a perturbation there is but one for each session, as nothing is drawn."""
        return [
            TrialKey(session, scenario.object.name, seed, condition)
            for seed in range(self.trials)
            for condition in ("", *self.conditions)
            for session, scenario in self._scenarios.items()
            if condition or seed == 0
        ]

    def scenario(self, key: TrialKey) -> Scenario:
        """The scenario of a trial."""
        scenario = copy.deepcopy(self._scenarios[key.method])
        if key.condition:
            name, size = self.conditions[key.condition]
            perturbation = PERTURBATIONS[name]
            setattr(scenario.object, perturbation.field, perturbation.unit * size)
        return scenario

    def run(self, keys: Sequence[TrialKey], jobs: int, backend: str) -> Iterator[dict]:
        """Simulates trials and yields their lines as they finish."""
        arguments = (
            (
                key,
                dump_scenario(scenario := self.scenario(key)),
                self.retarget,
                scenario.retargeting.latency,
                self.recordings[key.method],
            )
            for key in keys
        )
        yield from run_trials(simulate, arguments, jobs, backend)

    def open(self, folder: Path) -> None:
        """Begins in a folder, or goes on there.

        Raises:
            BenchmarkError: the folder's trials were made with something else.
        """
        wanted = {
            "settings": {"weights_sha256": self.weights, **simulation_settings(self.hand)},
            "sessions": {
                name: {
                    "recording_sha256": recording.digest,
                    "scenario": yaml.safe_load(dump_scenario(self._scenarios[name]))["Resolved"],
                }
                for name, recording in self.recordings.items()
            },
        }
        path = folder / CONFIG
        if path.is_file():
            stored = read_json(path, _Config, "a replay's configuration")
            require_same(path, stored["settings"], wanted["settings"])
            sessions = stored["sessions"]
            for name in sessions.keys() & wanted["sessions"].keys():
                require_same(path, sessions[name], wanted["sessions"][name], f"{name}.")
            wanted["sessions"] = {**sessions, **wanted["sessions"]}
        else:
            require_no_trials(folder)
        write_text(path, json.dumps(wanted, indent=2, allow_nan=False) + "\n")


def as_recorded(scenario: Scenario, recording: Recording, object_name: str | None) -> Scenario:
    """The scenario with the object as it was in a session, and nothing left to chance.

    A simulated session names its object and seed, which place and weigh the object as they did then; for
    another one the object is where the scenario says. The trial lasts as long as the session, and the time
    for which an object must be held longer.

    Raises:
        ScenarioError: the session does not say what was grasped, or says otherwise.
        UnknownNameError: there is no such object.
    """
    recorded = recording.metadata.get("object")
    if object_name is None and recorded is None:
        raise ScenarioError("the session does not say what was grasped; name it with --object")
    scenario = copy.deepcopy(scenario)
    scenario.object.name = str(object_name or recorded)
    if scenario.object.name not in object_names():
        raise UnknownNameError("object", scenario.object.name, object_names())
    thing = scenario.object
    seed = recording.metadata.get("seed")
    if isinstance(seed, int) and recorded == thing.name:
        drawn = draw_placement(scenario, 0.0, np.random.default_rng(seed))
        R = drawn.X_WO.rotation().matrix()
        thing.position = [float(x) for x in drawn.X_WO.translation()[:2]]
        thing.yaw = math.atan2(R[1, 0], R[0, 0])
        thing.mass_factor, thing.friction_factor = drawn.mass_factor, drawn.friction_factor
    thing.position_range = thing.yaw_range = thing.mass_range = thing.friction_range = 0.0
    scenario.timeout = float(recording.t[-1] - recording.t[0]) + scenario.monitor.hold_time
    return scenario


def write_report(folder: Path) -> dict:
    """Writes summary, figure and report of whatever trials a folder holds; returns the summary."""
    records = read_records(folder / TRIALS)
    summary = summarize_replay(records)
    write_text(folder / SUMMARY, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    lines = [
        "# Replayed sessions",
        "",
        f"{summary['trials']} trials of {len(summary['sessions'])} sessions, replayed without a person who "
        "reacts; shares with Wilson's 95 % interval.",
    ]
    if summary["errors"]:
        lines += ["", f"**{summary['errors']} trials raised an error and are in no figure; see errors/.**"]
    if summary["perturbations"]:
        write_text(folder / FIGURE, success_panels(summary["perturbations"]))
        lines += ["", f"![Success against the size of the change]({FIGURE})"]
    for panel in summary["perturbations"].values():
        lines += ["", f"| {panel['label']} | trials | success, % |", "|---|---|---|"]
        for condition in panel["conditions"]:
            (share,) = condition["methods"].values()
            percent = "{:.0f} [{:.0f}, {:.0f}]".format(*(100 * share[k] for k in ("rate", "low", "high")))
            lines.append(f"| {condition['value']:g} | {share['trials']} | {percent} |")
    lines += ["", "| session | unchanged | changed, all together |", "|---|---|---|"]
    for name, session in summary["sessions"].items():
        changed = session["changed"]
        lines.append(f"| {name} | {session['unchanged']} | {changed['successes']} of {changed['trials']} |")
    write_text(folder / REPORT, "\n".join(lines) + "\n")
    return summary


def summarize_replay(records: Iterable[Record]) -> dict:
    """Success over all sessions for each perturbation and size, and by session; JSON-ready."""
    records = list(records)
    judged = [record for record in records if "error" not in record]
    unchanged = [record for record in judged if not record.get("condition")]
    panels = {}
    for name, perturbation in PERTURBATIONS.items():
        groups = {0.0: unchanged}
        for record in judged:
            kind, _, size = record.get("condition", "").partition("=")
            if kind == name:
                groups.setdefault(float(size), []).append(record)
        if len(groups) > 1:
            panels[name] = {
                "label": perturbation.label,
                "conditions": [
                    {"value": size, "nominal": False, "methods": {"replay": _success(groups[size])}}
                    for size in sorted(groups)
                    if groups[size]
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
            raise ScenarioError(f"{path}: there is another session of the name '{name}'; rename one")
        recordings[name] = read_recording(path, side)
        if recordings[name].X_WH is None:
            raise ScenarioError(f"{path}: a replay needs wrist poses (X_WH), and it has none")
    return recordings

"""A grasp benchmark in its folder: which trials there are, which are left, and how they are run.

FOLDER/config.json     what decides every trial; another run may add methods, objects and trials to it
FOLDER/scenario.yaml   the resolved scenario
FOLDER/methods/        copies of the checkpoints
FOLDER/trials.jsonl    one line per finished trial
FOLDER/errors/         the traceback of each trial that raised
"""

import dataclasses as dc
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from geort_drake.benchmark.config import (
    CONFIG,
    ERRORS,
    METHODS,
    SCENARIO,
    read_config,
    require_no_trials,
    require_same,
)
from geort_drake.benchmark.methods import Method, make_retargeter, measure_latency, names_of
from geort_drake.benchmark.trial import plan, simulate
from geort_drake.benchmark.trial_log import TrialKey, check_record, identity, key_of
from geort_drake.benchmark.trial_sources import code_digest
from geort_drake.benchmark.workers import run_trials
from geort_drake.comparison.versions import versions
from geort_drake.errors import BenchmarkError
from geort_drake.files import digest_of, write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import Recording
from geort_drake.resources import diagrams_dir, models_dir
from geort_drake.simulation.scenario import Scenario, dump_scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal

_VERSIONS = ("geort_drake", "python", "numpy", "scipy", "drake")


@dc.dataclass(frozen=True)
class Benchmark:
    """Methods, objects and seeds, and all that their trials share."""

    folder: Path
    config: dict
    scenario_text: str
    person: HumanHand
    methods: dict[str, Method]
    # Name of each changed scenario → its resolved text.
    conditions: dict[str, str] = dc.field(default_factory=dict)

    def keys(self, methods: Iterable[str], objects: Iterable[str], trials: int) -> list[TrialKey]:
        """Trials in the order in which they are run: seed by seed, so that any beginning is balanced."""
        first = self.config["settings"]["scenario"]["random_seed"]
        return [
            TrialKey(method, name, first + k, condition)
            for k in range(trials)
            for condition in ("", *self.conditions)
            for name in dict.fromkeys(objects)
            for method in dict.fromkeys(methods)
        ]

    def goals(self, objects: Sequence[str], jobs: int, backend: str) -> Iterator[tuple[str, GraspGoal]]:
        """Plans a grasp of each object, which is the same for all methods."""
        arguments = ((self.scenario_text, name) for name in objects)
        yield from zip(objects, run_trials(plan, arguments, jobs, backend, ordered=True), strict=True)

    def run(
        self, keys: Sequence[TrialKey], goals: dict[str, GraspGoal], jobs: int, backend: str
    ) -> Iterator[dict]:
        """Simulates trials and yields their lines as they finish."""
        arguments = (self.arguments(key, goals[key.object]) for key in keys)
        yield from run_trials(simulate, arguments, jobs, backend)

    def arguments(self, key: TrialKey, goal: GraspGoal) -> tuple:
        """What `simulate` takes for a trial."""
        method = self.methods[key.method]
        text = self.conditions[key.condition] if key.condition else self.scenario_text
        return key, text, method.retarget, method.latency, (self.person, goal)


def open_benchmark(
    folder: Path,
    scenario: Scenario,
    recording: Recording,
    methods: Sequence[str],
    objects: Sequence[str],
    trials: int,
    seed: int = 0,
    zero_latency: bool = False,
    notes: dict | None = None,
    conditions: Mapping[str, Scenario] | None = None,
    any_code: bool = False,
) -> Benchmark:
    """Begins a benchmark in a folder, or goes on with the one that is there.

    Args:
        folder: of the results.
        scenario: of every trial but for object and seed; its seed is the first one.
        recording: of the person who teleoperates, and on which methods are trained.
        methods: names of methods and directories of checkpoints.
        objects: names of objects.
        trials: how many seeds per method and object.
        seed: of the training.
        zero_latency: every method answers at once.
        notes: what else the configuration says; not compared.
        conditions: name → changed scenario in which the trials are run as well.
        any_code: go on although the code of the trials has changed since the benchmark began.

    Raises:
        BenchmarkError: the folder's benchmark was begun with another configuration.
        UnknownNameError, HandError, CheckpointError, TrainingError: see `make_retargeter`.
    """
    names = names_of(methods)
    description = load_hand(scenario.hand)
    hand = HandModel(description)
    text = dump_scenario(scenario)
    resolved = yaml.safe_load(text)["Resolved"]
    texts = {name: dump_scenario(changed) for name, changed in (conditions or {}).items()}
    wanted: dict[str, Any] = {
        "settings": {
            "recording_sha256": recording.digest,
            "training_seed": seed,
            "latency": "zero" if zero_latency else "measured",
            "scenario": resolved,
            **simulation_settings(hand),
        },
        "objects": list(dict.fromkeys(objects)),
        "methods": {},
        "trials": trials,
        "conditions": {
            name: _changes(resolved, yaml.safe_load(changed)["Resolved"]) for name, changed in texts.items()
        },
        "notes": {"platform": versions()["platform"], **(notes or {})},
    }
    path = folder / CONFIG
    stored = read_config(folder) if path.exists() else None
    if stored is not None:
        if any_code:
            wanted["settings"]["code_sha256"] = stored["settings"]["code_sha256"]
        require_same(path, stored["settings"], wanted["settings"])
        known_conditions = stored.get("conditions", {})
        for name in known_conditions.keys() & wanted["conditions"].keys():
            require_same(path, known_conditions[name], wanted["conditions"][name], f"condition {name}: ")
        wanted["conditions"] = {**known_conditions, **wanted["conditions"]}
        wanted["objects"] = list(dict.fromkeys([*stored["objects"], *objects]))
        wanted["trials"] = max(trials, stored["trials"])
        wanted["notes"] = stored["notes"]
        wanted["methods"] = dict(stored["methods"])
    else:
        require_no_trials(folder)
    ready = {}
    for name, method in names.items():
        retarget, digest = make_retargeter(
            name, method, folder / METHODS, scenario.hand, hand, recording, seed
        )
        known = wanted["methods"].get(name)
        if known is None:
            latency = 0.0 if zero_latency else measure_latency(retarget, recording)
            known = {"weights_sha256": digest, "latency_s": latency}
        require_same(
            path, {"weights_sha256": known["weights_sha256"]}, {"weights_sha256": digest}, f"{name}."
        )
        wanted["methods"][name] = known
        ready[name] = Method(retarget, digest, known["latency_s"])
    if wanted != stored:
        write_text(folder / SCENARIO, text)
        write_text(path, json.dumps(wanted, indent=2, allow_nan=False) + "\n")
    return Benchmark(folder, wanted, text, HumanHand.fit(recording), ready, texts)


def simulation_settings(hand: HandModel) -> dict:
    """What decides a trial beside scenario and method: the models, the code and the libraries."""
    made_with = versions()
    return {
        "hand": hand.description.name,
        "hand_sha256": hand.digest,
        "models_sha256": digest_of(models_dir().parent, [models_dir(), diagrams_dir()]),
        "code_sha256": code_digest(),
        "versions": {name: made_with[name] for name in _VERSIONS},
    }


def keep_error(folder: Path, record: dict) -> dict:
    """A trial's line as it is kept: the traceback of one that raised goes into a file, which its line names.

    A result that is none, such as a force that is not finite, is an error too.
    """
    if "error" not in record:
        try:
            check_record(record, "the simulation gave no sound result")
            return record
        except BenchmarkError as error:
            record = {**identity(key_of(record)), "error": str(error)}
    path = Path(ERRORS) / f"{key_of(record).file_stem}.txt"
    write_text(folder / path, record["error"])
    return {**record, "error": record["error"].strip().splitlines()[-1], "traceback": str(path)}


def _changes(nominal: dict, changed: dict) -> dict:
    """The fields of a changed scenario that differ, nested as they are."""
    return {
        name: _changes(nominal[name], value) if isinstance(value, dict) else value
        for name, value in changed.items()
        if value != nominal.get(name)
    }

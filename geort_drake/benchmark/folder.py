"""Opens a benchmark of one task in its folder, prepares its trials, and repeats single trials.

FOLDER/config.json     everything that determines the trials; later runs may add methods, objects and trials
FOLDER/scenario.yaml   the resolved scenario
FOLDER/methods/        copies of the checkpoints
FOLDER/trials.jsonl    one line per finished trial
FOLDER/errors/         tracebacks of failed trials
FOLDER/rrd/            Rerun recordings of repeated trials
"""

import dataclasses as dc
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from geort_drake.benchmark.conditions import ASSUMPTIONS, make_conditions, parse_values
from geort_drake.benchmark.config import (
    CONFIG,
    METHODS,
    SCENARIO,
    TRIALS,
    GraspConfig,
    continue_config,
    read_config,
)
from geort_drake.benchmark.methods import make_retargeter, measure_latency
from geort_drake.benchmark.records import Record, TrialKey, key_of, read_records
from geort_drake.benchmark.trials import Trial, plan_cases, simulate
from geort_drake.benchmark.workers import code_digest
from geort_drake.comparison.retargeters import names_of
from geort_drake.comparison.train import training_recording
from geort_drake.errors import BenchmarkError, UnknownNameError
from geort_drake.files import digest_of, write_text
from geort_drake.hands.model import HandModel
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import Recording
from geort_drake.resources import diagrams_dir, models_dir
from geort_drake.retargeting.method import Retarget
from geort_drake.simulation.free_play import after_play, keep_reached, persons_hand, seen_fingertips
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.simulation.scenario import Scenario, dump_scenario, scenario_fields
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.versions import versions

_VERSIONS = ("geort_drake", "python", "numpy", "scipy", "drake")


@dc.dataclass(frozen=True)
class Benchmark:
    """Methods and conditions, and everything that their trials share.

    Attributes:
        folder: folder of the results.
        config: content of `config.json`.
        scenario_text: the resolved scenario, as YAML.
        hand: model of the robot's hand.
        people: name of each condition → the operator's hand; "" is the scenario itself.
        methods: name → retargeter, which must be picklable, and its latency, s.
        conditions: name of each changed scenario → its resolved text.
    """

    folder: Path
    config: dict
    scenario_text: str
    hand: HandModel
    people: dict[str, HumanHand]
    methods: dict[str, tuple[Retarget, float]]
    conditions: dict[str, str] = dc.field(default_factory=dict)
    # Method and condition → the map after free play, and the fingertips that the person saw in it.
    _played: dict[tuple[str, str], tuple[Retarget, FreePlay]] = dc.field(default_factory=dict)

    def keys(self, methods: Iterable[str], objects: Iterable[str], trials: int) -> list[TrialKey]:
        """Returns the trials in order: seed by seed, so that an interrupted run is balanced."""
        first = self.config["settings"]["scenario"]["random_seed"]
        return [
            TrialKey(method, name, first + k, condition)
            for k in range(trials)
            for condition in ("", *self.conditions)
            for name in dict.fromkeys(objects)
            for method in dict.fromkeys(methods)
        ]

    def trial(self, key: TrialKey, plans: Sequence[Any]) -> Trial:
        """Returns a trial for a worker, with the one of `plans` that the person selects after free play."""
        (retarget, latency), person = self.methods[key.method], self.people[key.condition]
        text = self.conditions[key.condition] if key.condition else self.scenario_text
        if (key.method, key.condition) not in self._played:
            own = after_play(retarget, person)
            seen = seen_fingertips(own, self.hand, person, latency)
            self._played[key.method, key.condition] = own, seen
        own, seen = self._played[key.method, key.condition]
        task = find_task(self.config["settings"]["scenario"].get("task", "grasp"))
        goal, attainable = keep_reached(plans, seen)
        if task.begins_after_play:
            retarget = own
        return Trial(key, text, retarget, latency, (person, goal), attainable)


def read_person(path: Path | None, side: str, seed: int) -> tuple[Recording, dict[str, Any]]:
    """Returns the teleoperator's recording, or synthetic play, and notes on it for the configuration."""
    notes = {"recording": None if path is None else str(path.resolve()), "side": side}
    return training_recording(path, side, seed), notes


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
    operator: Recording | None = None,
    trainings: int = 1,
    latencies: Mapping[str, float] | None = None,
    made: Mapping[str, tuple[Retarget, str]] | None = None,
) -> Benchmark:
    """Starts a benchmark in a folder, or continues the existing one.

    Args:
        folder: folder of the results.
        scenario: scenario of every trial, apart from object and seed; its seed is the first one.
        recording: the teleoperator's recording, on which methods are trained.
        methods: names of methods and directories of checkpoints.
        objects: names of the task's cases.
        trials: number of seeds per method and object.
        seed: seed of the first training.
        zero_latency: whether to simulate all methods without latency.
        notes: further entries of the configuration, which are not compared.
        conditions: name → changed scenario in which the trials are also run.
        any_code: whether to continue even if the code of the trials has changed.
        operator: recording of the person who operates, such as another session; None for `recording`.
        trainings: number of trainings of each trained method, with seeds from `seed` on.
        latencies: method → known latency, s, such as one measured in another task.
        made: name → further retargeter, which must be picklable, and its digest.

    Raises:
        BenchmarkError: the folder's benchmark was started with another configuration.
        UnknownNameError, HandError, CheckpointError, TrainingError: see `make_retargeter`.
    """
    names, made = names_of(methods, trainings), made or {}
    hand = HandModel(scenario.hand)
    text = dump_scenario(scenario)
    resolved = scenario_fields(text)
    texts = {name: dump_scenario(changed) for name, changed in (conditions or {}).items()}
    config: dict[str, Any] = {
        "settings": {
            "training_seed": seed,  # compared first, because synthetic play depends on it
            "recording_sha256": recording.digest,
            "operator_sha256": (operator or recording).digest,
            "latency": "zero" if zero_latency else "measured",
            "scenario": resolved,
            **simulation_settings(hand),
        },
        "objects": list(dict.fromkeys(objects)),
        "methods": {},
        "trials": trials,
        "conditions": {name: _changes(resolved, scenario_fields(changed)) for name, changed in texts.items()},
        "refused": {},
        "notes": {"platform": versions()["platform"], **(notes or {})},
    }
    path = folder / CONFIG
    stored = continue_config(folder, config, GraspConfig, ["methods", "conditions"], any_code)
    if stored is not None:
        config["refused"] = stored.get("refused", {})
        config["objects"] = list(dict.fromkeys([*stored["objects"], *objects]))
        config["trials"] = max(trials, stored["trials"])
        config["notes"] = stored["notes"]
    ready = {}
    for name in [*names, *made]:
        begun = name in config["methods"]
        retarget, digest = made.get(name) or make_retargeter(
            name, names[name], folder / METHODS, scenario.hand, hand, recording, seed, begun
        )
        if not begun:
            latency = 0.0 if zero_latency else (latencies or {}).get(name)
            latency = measure_latency(retarget, recording) if latency is None else latency
            config["methods"][name] = {"weights_sha256": digest, "latency_s": latency}
        known = config["methods"][name]
        if known["weights_sha256"] != digest:
            raise BenchmarkError(
                f"{path}: {name} has changed since this benchmark was begun; undo the change "
                f"({folder / METHODS} has a copy of the original), or choose another folder"
            )
        ready[name] = (retarget, known["latency_s"])
    if config != stored:
        write_text(folder / SCENARIO, text)
        write_text(path, json.dumps(config, indent=2, allow_nan=False) + "\n")
    scenarios = {"": scenario, **(conditions or {})}
    people = {name: persons_hand(each, operator or recording) for name, each in scenarios.items()}
    return Benchmark(folder, config, text, hand, people, ready, texts)


def note_refused(benchmark: Benchmark, refused: Mapping[str, str]) -> None:
    """Stores in the configuration which objects the hand cannot grasp, and why; they have no trials."""
    if not refused.items() <= benchmark.config["refused"].items():
        benchmark.config["refused"] |= refused
        text = json.dumps(benchmark.config, indent=2, allow_nan=False) + "\n"
        write_text(benchmark.folder / CONFIG, text)


def repeat_trial(folder: Path, key: TrialKey) -> tuple[Record, Path]:
    """Simulates a finished trial again and writes its Rerun recording.

    Returns:
        The new record, which may contain an `error`, and the file of the recording.

    Raises:
        BenchmarkError: the outcome differs from the stored one.
        UnknownNameError: there is no such finished trial; the message lists similar ones.
    """
    config = read_config(folder)
    records = {key_of(record): record for record in read_records(folder / TRIALS)}
    if key not in records:
        alike = [other for other in records if other.condition == key.condition] or list(records)
        named = [str(other) for other in alike if other.object == key.object]
        raise UnknownNameError("finished trial", str(key), named or map(str, alike))
    notes, settings = config["notes"], config["settings"]
    scenario, conditions = load_scenario(folder / SCENARIO, "Resolved"), {}
    if key.condition:
        conditions = make_conditions(scenario, parse_values([key.condition], ASSUMPTIONS), ASSUMPTIONS)
    side, seed = notes.get("side", "right"), settings["training_seed"]
    recording, operator = (
        read_person(Path(notes[name]) if notes.get(name) else None, side, seed)[0]
        for name in ("recording", "operator")
    )
    checkpoint = folder / METHODS / key.method
    benchmark = open_benchmark(
        folder,
        scenario,
        recording,
        [str(checkpoint) if checkpoint.exists() else key.method],
        [key.object],
        trials=1,
        seed=settings["training_seed"],
        zero_latency=settings["latency"] == "zero",
        conditions=conditions,
        any_code=True,
        operator=operator if notes.get("operator") else None,
    )
    ((_, plans),) = plan_cases(benchmark.scenario_text, [key.object], 1, "loky")
    if isinstance(plans, str):
        raise BenchmarkError(plans)
    path = rerun_path(folder, key)
    path.parent.mkdir(exist_ok=True)
    record = simulate(benchmark.trial(key, plans), path)
    if "error" not in record:
        before = records[key]
        differing = [name for name in record if name != "wall_time" and record[name] != before.get(name)]
        if differing:
            raise BenchmarkError(
                f"{folder / TRIALS}: the repeated trial differs in {', '.join(differing)}; were the code or "
                f"the kind of machine different? Its recording is {path}"
            )
    return record, path


def code_has_changed(folder: Path) -> bool:
    """Whether the code of the trials has changed since the folder's benchmark was started."""
    return read_config(folder)["settings"]["code_sha256"] != code_digest()


def rerun_path(folder: Path, key: TrialKey) -> Path:
    """Returns the file of a repeated trial's Rerun recording."""
    return folder / "rrd" / f"{key.file_stem}.rrd"


def simulation_settings(hand: HandModel) -> dict:
    """Returns digests of models and code, and versions, that determine trials with scenario and method."""
    made_with = versions()
    return {
        "hand": hand.description.name,
        "hand_sha256": hand.digest,
        "models_sha256": digest_of(models_dir().parent, [models_dir(), diagrams_dir()]),
        "code_sha256": code_digest(),
        "versions": {name: made_with[name] for name in _VERSIONS},
    }


def _changes(nominal: dict, changed: dict) -> dict:
    """Returns the fields of a changed scenario that differ from the nominal one, nested."""
    return {
        name: _changes(nominal[name], value) if isinstance(value, dict) else value
        for name, value in changed.items()
        if value != nominal.get(name)
    }

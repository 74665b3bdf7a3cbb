"""Runs a benchmark in a folder: its methods, people, objects and seeds, trial by trial.

FOLDER/trials.jsonl     one row per finished trial: the result
FOLDER/settings.json    what determines the trials, with digests and versions
FOLDER/scenarios.yaml   the scenarios, named TASK KIND CONDITION
FOLDER/report.md        see `report`
"""

import copy
import dataclasses as dc
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from pydrake.common.yaml import yaml_dump_typed

from geort_drake.benchmark.log import TRIALS, Row, TrialKey, TrialLog, read_rows
from geort_drake.benchmark.workers import call_in_workers, error_row, plan, simulate
from geort_drake.console import warn
from geort_drake.errors import BenchmarkError, MethodError, ScenarioError
from geort_drake.files import digest_of, sha256_of, source_digest, write_text
from geort_drake.hands.hand import Hand
from geort_drake.methods import is_trained, measure_latency, resolve
from geort_drake.people.recording import Recording
from geort_drake.resources import diagrams_dir, models_dir
from geort_drake.retargeting.base import Retarget
from geort_drake.retargeting.train import training_recording
from geort_drake.simulation.scenario import Scenario, dump_scenario, scenario_fields
from geort_drake.simulation.scenario_files import check_scenario, load_scenario, merged, scenario_names
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import Trial, TrialBuilder, plan_key
from geort_drake.versions import git_state, versions

SETTINGS, SCENARIOS = "settings.json", "scenarios.yaml"


class Variant(NamedTuple):
    """Names a scenario of a benchmark; see `TrialKey` for the attributes."""

    task: str
    kind: str
    condition: str = ""

    def __str__(self) -> str:
        return " ".join(filter(None, self))


@dc.dataclass
class Settings:
    """What determines the trials of a benchmark, beside its scenarios.

    Attributes:
        recording: file of the recording on which methods are trained; None for synthetic play.
        operator: file of the recording of the person who operates; None for `recording`, or for an average
            adult where that is None as well.
        side: side of the recorded hand.
        seed: seed of the first training, and of synthetic play.
        measure_latency: whether a method has the latency that is measured here, instead of the scenario's.
        persons: numbers of the people who operate, see `Scenario.person`.
        objects: cases of the tasks.
        trials: number of seeds, from that of the scenarios on.
        trainings: number of trainings of each trained method.
        methods: name → `source`, name or path; `latency_s`, None if it is not measured; `digests`, SHA-256 of
            each training's weights.
        refused: "TASK CASE" → why the hand cannot do it; such cases have no trials.
        provenance: digests and versions of what made the trials; not compared, but differences are told.
    """

    recording: str | None = None
    operator: str | None = None
    side: str = "right"
    seed: int = 0
    measure_latency: bool = False
    persons: list[int] = dc.field(default_factory=lambda: [0])
    objects: list[str] = dc.field(default_factory=list)
    trials: int = 30
    trainings: int = 1
    methods: dict[str, dict[str, Any]] = dc.field(default_factory=dict)
    refused: dict[str, str] = dc.field(default_factory=dict)
    provenance: dict[str, Any] = dc.field(default_factory=dict)


_FIXED = ("recording", "operator", "side", "seed", "measure_latency")


def read_settings(folder: Path) -> Settings:
    """Reads the settings of a benchmark; raises BenchmarkError if they are missing or damaged."""
    path = folder / SETTINGS
    try:
        return Settings(**json.loads(path.read_bytes()))
    except FileNotFoundError as error:
        raise BenchmarkError(f"{path}: no such file; is {folder} the folder of a benchmark?") from error
    except (ValueError, TypeError) as error:
        raise BenchmarkError(f"{path}: not the settings of a benchmark: {error}") from error


def read_scenarios(folder: Path) -> dict[Variant, Scenario]:
    """Reads the scenarios of a benchmark; raises ScenarioError if they are unusable."""
    path = folder / SCENARIOS
    return {Variant(*name.split(" ", 2)): load_scenario(path, name) for name in scenario_names(path)}


def vary(scenario: Scenario, texts: Iterable[str]) -> dict[str, Scenario]:
    """Returns changed scenarios by condition, such as "operator.visual_delay=0.3".

    Args:
        texts: `FIELD=V1,V2`, with a field of the scenario, dots between nested names, and values in YAML;
            a value that the scenario has already gives no condition.

    Raises:
        ScenarioError: there is no such field, or a value does not fit it.
    """
    conditions = {}
    for text in texts:
        field, equals, values = text.partition("=")
        if not equals:
            raise ScenarioError(
                f"'{text}' must have the form FIELD=V1,V2, such as operator.visual_delay=0,0.3"
            )
        for value in values.split(","):
            nested: Any = yaml.safe_load(value)
            for part in reversed(field.split(".")):
                nested = {part: nested}
            changed = merged(yaml.safe_dump(nested), None, f"{field}={value}", scenario)
            check_scenario(changed)
            if dump_scenario(changed) != dump_scenario(scenario):
                conditions[f"{field}={value}"] = changed
    return conditions


class Benchmark:
    """The methods and people of a benchmark, and its scenarios.

    Opening a folder with trials continues them with the settings that they have.

    Args:
        folder: folder of the results.
        settings: settings; objects, persons, trials and trainings extend the stored ones.
        scenarios: scenarios of one robot.
        methods: name → method, see `names_of`; the first is the reference of comparisons.

    Attributes:
        hand: model of the robot's hand.
        problems: name of a method that cannot be used → why; its trials get rows with this error.

    Raises:
        BenchmarkError: the folder's trials have other settings.
        UnknownNameError, HandError, MapError, TrainingError: see `resolve`.
    """

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        scenarios: Mapping[Variant, Scenario],
        methods: Mapping[str, str],
    ):
        self.folder, self.settings, self.scenarios = folder, settings, dict(scenarios)
        hands = {scenario.hand for scenario in scenarios.values()}
        if len(hands) != 1:
            raise BenchmarkError(f"the scenarios have different hands: {', '.join(sorted(hands))}")
        self.hand = Hand(hands.pop())
        self.recording = self._read(settings.recording)
        operator = settings.operator or settings.recording
        self._builder = TrialBuilder(self.hand, self._read(operator) if operator else None)
        settings.provenance = self._provenance()
        self._earlier: Mapping[Variant, Scenario] = {}
        if (folder / SETTINGS).exists():
            self._continue(read_settings(folder), read_scenarios(folder))
        elif (folder / TRIALS).exists() and read_rows(folder / TRIALS):
            raise BenchmarkError(f"{folder}: contains trials but no {SETTINGS}; choose another folder")
        self._maps: dict[tuple[str, int], Retarget] = {}
        self.problems: dict[str, str] = {}
        for name, source in methods.items():
            self._add_method(name, source)
        self._save()

    def keys(
        self, methods: Iterable[str], objects: Sequence[str], persons: Sequence[int], trials: int
    ) -> list[TrialKey]:
        """Returns the trials of methods, seed by seed, so that every prefix is balanced.

        Args:
            objects: cases; a task that has none of these is tried with all of its own.
        """
        keys = []
        for number in range(trials):
            for variant, scenario in self.scenarios.items():
                seed, known = scenario.random_seed + number, find_task(variant.task).cases()
                for case in [name for name in dict.fromkeys(objects) if name in known] or known:
                    for person in persons if variant.condition == "" else [scenario.person]:
                        for method in methods:
                            trained = is_trained(self.settings.methods[method]["source"])
                            for training in range(self.settings.trainings if trained else 1):
                                keys.append(TrialKey(method, training, *variant, case, person, seed))
        return keys

    def plan(self, keys: Iterable[TrialKey], jobs: int) -> Iterator[str]:
        """Plans the cases of trials in workers; yields the name of each, and settles which are refused."""
        cases: dict[tuple, TrialKey] = {}
        for key in keys:
            cases.setdefault((key[2:5], key.object), key)
        scenarios = {plan_key(each): each for each in map(self.scenario, cases.values())}
        if not scenarios:
            return
        arguments = ((text,) for text in scenarios)
        planned = call_in_workers(plan, arguments, min(jobs, len(scenarios)), ordered=True)
        for scenario, goals in zip(scenarios.values(), planned, strict=True):
            case = find_task(scenario.task).case_of(scenario)
            if isinstance(goals, str):
                self.settings.refused[f"{scenario.task} {case}"] = goals
            else:
                self._builder.keep_plans(scenario, goals)
            yield case
        self._save()

    def scenario(self, key: TrialKey) -> Scenario:
        """Returns the scenario of a trial, with its case, person, seed and latency."""
        scenario = copy.deepcopy(self.scenarios[Variant(key.task, key.kind, key.condition)])
        find_task(key.task).choose(scenario, key.object)
        scenario.random_seed, scenario.person = key.seed, key.person
        if self.settings.measure_latency and not key.condition.startswith("retargeting.latency="):
            scenario.retargeting.latency = self.settings.methods[key.method]["latency_s"]
        return scenario

    def trial(self, key: TrialKey) -> Trial:
        """Returns a planned trial."""
        return self._builder.trial(self.scenario(key), self._maps[key.method, key.training])

    def run(self, log: TrialLog, keys: Sequence[TrialKey], jobs: int) -> Iterator[Row]:
        """Simulates planned trials in workers; logs and yields each row as its trial ends."""
        for key in keys:
            if key.method in self.problems:
                log.append(row := error_row(key, self.problems[key.method]))
                yield row
        usable = [key for key in keys if key.method not in self.problems]
        if not usable:
            return
        trials = ((key, self.trial(key)) for key in usable)
        for row in call_in_workers(simulate, trials, min(jobs, len(usable))):
            log.append(row)
            yield row

    def _read(self, path: str | None) -> Recording:
        return training_recording(path, self.settings.side, self.settings.seed)

    def _continue(self, stored: Settings, scenarios: Mapping[Variant, Scenario]) -> None:
        """Extends the stored settings by the new ones; raises BenchmarkError if they contradict them."""
        path, now = self.folder / SETTINGS, self.settings
        for name in _FIXED:
            _require_same(path, name, getattr(stored, name), getattr(now, name))
        for variant in scenarios.keys() & self.scenarios.keys():
            texts = (dump_scenario(each[variant]) for each in (scenarios, self.scenarios))
            _require_same(self.folder / SCENARIOS, str(variant), *map(scenario_fields, texts))
        for name, origin in stored.provenance.items():
            if origin != now.provenance.get(name):
                warn(f"{path}: the trials were made with another {name}: {origin}")
        self._earlier = scenarios
        now.methods, now.refused = stored.methods, stored.refused
        now.provenance = stored.provenance
        now.trials, now.trainings = max(now.trials, stored.trials), max(now.trainings, stored.trainings)
        now.objects = list(dict.fromkeys([*stored.objects, *now.objects]))
        now.persons = list(dict.fromkeys([*stored.persons, *now.persons]))

    def _add_method(self, name: str, source: str) -> None:
        """Makes all trainings of a method, and measures its latency if it is not known."""
        entry = self.settings.methods.setdefault(name, {"source": source, "latency_s": None, "digests": []})
        trainings = self.settings.trainings if is_trained(source) else 1
        for number in range(trainings):
            try:
                retarget, path = resolve(source, self.hand, self.recording, self.settings.seed + number)
            except MethodError as error:
                self.problems[name] = f"MethodError: {error}"
                warn(f"{error}; its trials are recorded as errors")
                return
            self._maps[name, number] = retarget
            digest = None if path is None else sha256_of(path)
            if number == len(entry["digests"]):
                entry["digests"].append(digest)
            elif entry["digests"][number] != digest:
                warn(f"{name} has changed since earlier trials of this benchmark")
        if entry["latency_s"] is None and self.settings.measure_latency:
            entry["latency_s"] = measure_latency(self._maps[name, 0], self.recording)

    def _provenance(self) -> dict[str, Any]:
        return {
            "recording_sha256": self.recording.digest,
            "hand_sha256": self.hand.digest,
            "models_sha256": digest_of(models_dir().parent, [models_dir(), diagrams_dir()]),
            "code_sha256": source_digest("people", "hands", "retargeting", "simulation", "systems"),
            "versions": versions(),
            "git": git_state(),
        }

    def _save(self) -> None:
        scenarios = {**self._earlier, **self.scenarios}
        text = "".join(yaml_dump_typed(each, child_name=str(name)) for name, each in scenarios.items())
        write_text(self.folder / SCENARIOS, text)
        write_text(self.folder / SETTINGS, json.dumps(dc.asdict(self.settings), indent=2) + "\n")


def _require_same(path: Path, name: str, stored: Any, current: Any) -> None:
    """Raises BenchmarkError for the first field in which two settings differ."""
    if isinstance(stored, dict) and isinstance(current, dict):
        for field in {**stored, **current}:
            _require_same(path, f"{name}.{field}", stored.get(field), current.get(field))
    elif stored != current:
        raise BenchmarkError(
            f"{path}: this benchmark was begun with another {name}: {stored}, not {current}; use the same, "
            "or choose another folder"
        )

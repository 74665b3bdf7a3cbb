"""Trains methods again and again with one setting changed, and keeps every run's figures.

A sweep is a folder: `runs/NAME` are the checkpoints, `sweep.json` says what all runs have in common and
how each of them went. A run that is there is not trained again, so what was interrupted can go on, and
more settings or seeds can join.
"""

import dataclasses
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from joblib import delayed

from geort_drake.benchmark.workers import workers
from geort_drake.comparison.checkpoint_cache import TRAINING_CODE
from geort_drake.comparison.pipeline import hand_settings, train_checkpoint, training_config
from geort_drake.errors import CheckpointError, GeortError, OutputError
from geort_drake.files import digest_of, require_writable, write_text
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.readers import read_recording
from geort_drake.retargeting.checkpoint import METRICS, PROVENANCE, load_checkpoint
from geort_drake.retargeting.methods.geort import TrainingConfig
from geort_drake.settings import parse_settings, settings_of

SWEEP, RUNS = "sweep.json", "runs"
FACTORS = (0.0, 0.5, 2.0)  # of a weight's value; 0 removes its criterion


@dataclass(frozen=True)
class Run:
    """One training: a method, a seed, and at most one setting other than in the default run."""

    method: str
    seed: int
    common: Mapping[str, Any] = field(default_factory=dict)  # settings of all runs
    change: tuple[str, float] | None = None  # the setting that differs, and its value
    of_hand: Mapping[str, Any] = field(default_factory=dict)  # settings that the hand's description has

    @property
    def name(self) -> str:
        """The run's folder, such as geort-coverage_weight=0-seed0."""
        change = "default" if self.change is None else f"{self.change[0]}={self.change[1]:.12g}"
        return f"{self.method}-{change}-seed{self.seed}"

    @property
    def config(self) -> TrainingConfig:
        """What the run is trained with."""
        return training_config(self.method, self.settings)

    @property
    def settings(self) -> dict[str, Any]:
        """What of it differs from the method's defaults, by name."""
        return {**self.of_hand, **self.common, **dict([self.change] if self.change else [])}


@dataclass(frozen=True)
class Ground:
    """What all runs of a sweep stand on: the hand, the recording, the common settings and the code."""

    hand: str
    recording: Path
    facts: dict  # JSON-ready, as in sweep.json

    @classmethod
    def of(cls, hand: str, recording: Path, common: Mapping[str, Any]) -> "Ground":
        """Reads hand and recording. The code is that of training, hands and metrics.

        Raises:
            HandError, RecordingError: one of them is unusable.
        """
        description = load_hand(hand)
        here = Path(__file__).parent
        facts = {
            "hand": description.name,
            "hand_sha256": HandModel(description).digest,
            "recording_sha256": read_recording(recording, description.side, training=True).digest,
            "code_sha256": digest_of(here.parent, [*TRAINING_CODE, *here.glob("*metrics.py")]),
            "settings": dict(common),
        }
        return cls(hand, Path(recording), facts)


def plan(
    methods: Sequence[str],
    seeds: Sequence[int],
    changes: Sequence[str] = (),
    common: Sequence[str] = (),
    hand: HandDescription | None = None,
) -> list[Run]:
    """The runs of a sweep, the default ones first.

    Args:
        methods: names of methods that are trained.
        seeds: every change is tried with each of them.
        changes: texts NAME=V1,V2,…; without any, every `*_weight` at 0, half and double its value.
        common: texts NAME=VALUE, settings of all runs.
        hand: its own settings are defaults as well.

    Raises:
        UnknownNameError: no such method, or a method has no such setting.
        GeortError: a text is malformed or a value makes no sense, of the hand's settings too.
    """
    runs = []
    for method in methods:
        default = training_config(method, hand=hand)
        shared = parse_settings(common, default, method)
        config = training_config(method, shared, hand)
        tried: list[tuple[str, float] | None] = [None]
        for name, value in _changes(method, config, changes):
            training_config(method, {**shared, name: value}, hand)
            if value != getattr(config, name) and (name, value) not in tried:
                tried.append((name, value))
        own = hand_settings(hand, method) if hand else {}
        runs += [Run(method, seed, shared, change, own) for change in tried for seed in dict.fromkeys(seeds)]
    return runs


def _changes(method: str, config: TrainingConfig, texts: Sequence[str]) -> Iterator[tuple[str, float]]:
    for text in texts:
        name, _, values = text.partition("=")
        for value in values.split(","):
            (number,) = parse_settings([f"{name}={value}"], config, method).values()
            if isinstance(number, bool | str):
                raise GeortError(f"a sweep changes numbers; setting {name} of {method} is none")
            yield name, number
    if not texts:
        for name, value in settings_of(config).items():
            if name.endswith("_weight"):
                yield from ((name, factor * value) for factor in FACTORS)


class Sweep:
    """A sweep in its folder.

    A record says of a run: name, method, seed, changed, value, settings, seconds, warnings, and metrics or
    else error. A folder holds runs on one `Ground` only; a checkpoint that is damaged is trained again.

    Args:
        runs: of `plan`.
        ground: what they are trained on.
        folder: made if it is not there.

    Attributes:
        records: name → record of the runs that are there, those of earlier commands included.
        missing: the runs that are to be trained.

    Raises:
        OutputError: the folder holds a sweep on another ground, or cannot be written to.
        CheckpointError: a run's folder holds another checkpoint.
    """

    def __init__(self, runs: Sequence[Run], ground: Ground, folder: Path):
        require_writable(folder, directory=True)
        self.folder, self.ground = folder, ground
        self.records = {record["name"]: record for record in _earlier(folder, ground)}
        self.missing = []
        for run in runs:
            record = _at_hand(folder, run, ground)
            if record is None:
                self.missing.append(run)
            else:
                self.records[run.name] = record

    def train(self, jobs: int = 1) -> Iterator[dict]:
        """Trains what is missing in `jobs` processes of one thread each; yields each record as its run ends.

        `sweep.json` is written at the beginning and whenever a run ends.
        """
        self._write()
        tasks = (delayed(_trained)(run, self.ground, self.folder) for run in self.missing)
        with workers(jobs) as parallel:
            for record in parallel(return_as="generator_unordered")(tasks):
                self.records[record["name"]] = record
                self._write()
                yield record

    def _write(self) -> None:
        ground = {"recording": self.ground.recording.name, **self.ground.facts}
        content = {"ground": ground, "runs": list(self.records.values())}
        write_text(self.folder / SWEEP, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_sweep(folder: Path) -> dict:
    """The contents of a sweep's `sweep.json`.

    Raises:
        OutputError: it is missing or damaged.
    """
    path = folder / SWEEP
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content["runs"], content["ground"]["recording_sha256"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise OutputError(f"{path}: is not the table of a sweep: {error}") from error
    return content


def _earlier(folder: Path, ground: Ground) -> list[dict]:
    """The records that are there, all on the same ground."""
    if not (folder / SWEEP).exists():
        if any((folder / RUNS).glob("*")):
            raise OutputError(f"{folder / RUNS} holds runs without {SWEEP}; choose another folder")
        return []
    content = read_sweep(folder)
    other = [name for name, value in ground.facts.items() if content["ground"].get(name) != value]
    if other:
        raise OutputError(
            f"{folder} holds a sweep that differs in {', '.join(other)}; choose another folder or delete it"
        )
    return content["runs"]


def _at_hand(folder: Path, run: Run, ground: Ground) -> dict | None:
    """The record of a run that was trained earlier; None if it is to be trained."""
    path = folder / RUNS / run.name
    if not path.exists():
        return None
    try:
        checkpoint = load_checkpoint(path)
        figures = json.loads((path / METRICS).read_text(encoding="utf-8"))
    except (CheckpointError, OSError, ValueError):
        return None
    training = checkpoint.config["training"]
    wanted = {**dataclasses.asdict(run.config), "seed": run.seed}
    facts = {
        "method": (checkpoint.config["method"], run.method),
        "hand": (checkpoint.hand["model_sha256"], ground.facts["hand_sha256"]),
        "recording": (checkpoint.provenance["recording"]["sha256"], ground.facts["recording_sha256"]),
        **{name: (training.get(name), value) for name, value in wanted.items()},
    }
    other = [name for name, (given, asked) in facts.items() if given != asked]
    if other:
        raise CheckpointError(f"{path}: is another run: {', '.join(other)} differ; choose another folder")
    return _record(run, path, figures)


def _trained(run: Run, ground: Ground, folder: Path) -> dict:
    """Trains one run; what goes wrong is part of the record, so that the other runs go on."""
    path = folder / RUNS / run.name
    try:
        with warnings.catch_warnings():
            # They are in the checkpoint, from where they come into the record.
            warnings.simplefilter("ignore", RuntimeWarning)
            train_checkpoint(
                ground.hand, ground.recording, path, run.method, run.seed,
                show_progress=False, settings=run.settings,
            )  # fmt: skip
        return _record(run, path, json.loads((path / METRICS).read_text(encoding="utf-8")))
    except Exception as error:
        return {**_head(run), "error": f"{type(error).__name__}: {error}"}


def _record(run: Run, path: Path, figures: dict) -> dict:
    provenance = json.loads((path / PROVENANCE).read_text(encoding="utf-8"))
    phases = ("recording_s", "robot_data_s", "fit_s", "evaluation_s")
    return {
        **_head(run),
        "seconds": round(sum(provenance["timings"][phase] for phase in phases), 1),
        "warnings": provenance["warnings"],
        "metrics": figures,
    }


def _head(run: Run) -> dict:
    changed, value = run.change or (None, None)
    named = {"name": run.name, "method": run.method, "seed": run.seed, "changed": changed, "value": value}
    return {**named, "settings": settings_of(run.config)}

"""What decides every trial of a benchmark, as `config.json` keeps it: read, checked and compared."""

import json
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

from geort_drake.benchmark.json_types import require_type
from geort_drake.errors import BenchmarkError

CONFIG, SCENARIO, TRIALS, METHODS, ERRORS = (
    "config.json",
    "scenario.yaml",
    "trials.jsonl",
    "methods",
    "errors",
)


class _ScenarioFields(TypedDict):
    random_seed: int
    timeout: float  # s


class _Settings(TypedDict):
    recording_sha256: str
    training_seed: int
    latency: Literal["measured", "zero"]
    scenario: _ScenarioFields
    hand: str
    hand_sha256: str
    models_sha256: str
    code_sha256: str
    versions: dict[str, str]


class _MethodFields(TypedDict):
    weights_sha256: str | None
    latency_s: float


class _Notes(TypedDict, total=False):
    recording: str | None
    side: str


class _Config(TypedDict):
    settings: _Settings
    objects: list[str]
    methods: dict[str, _MethodFields]
    trials: int
    conditions: NotRequired[dict[str, dict]]
    notes: _Notes


def read_config(folder: Path) -> dict:
    """The configuration of the benchmark in a folder.

    Raises:
        BenchmarkError: there is none, or it is not one.
    """
    path = folder / CONFIG
    if not path.is_file():
        raise BenchmarkError(f"{path}: there is no such file; a benchmark writes it when it begins")
    config = read_json(path, _Config, "a benchmark's configuration")
    for field in ("methods", "objects"):
        if not config[field]:
            raise BenchmarkError(f"{path}: {field} must name at least one, not {config[field]}")
    return config


def read_json(path: Path, schema: Any, what: str) -> dict:
    """A file's JSON object, which has the fields of `schema`; `what` it should be is for the message.

    Raises:
        BenchmarkError: it is not JSON, or a field is missing or of another type.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise BenchmarkError(f"{path}: not {what}: {error}") from error
    require_type(content, schema, f"{path}: not {what}")
    return content


def require_no_trials(folder: Path) -> None:
    """Raises BenchmarkError where a folder without a configuration holds trials: nobody knows of what."""
    path = folder / TRIALS
    if path.exists() and path.stat().st_size:
        raise BenchmarkError(f"{path}: holds trials without their {CONFIG}; choose another folder")


def require_same(path: Path, stored: dict, wanted: dict, within: str = "") -> None:
    """Raises BenchmarkError, by its name, for the first field in which two configurations differ."""
    for field in {**stored, **wanted}:
        before, now = stored.get(field), wanted.get(field)
        if isinstance(before, dict) and isinstance(now, dict):
            require_same(path, before, now, f"{within}{field}.")
        elif before != now:
            raise BenchmarkError(
                f"{path}: this benchmark was begun with another {within}{field}: {before}, not {now}; "
                "go on with the same, or choose another folder"
            )

"""Reads and checks a benchmark's `config.json` and other JSON."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import msgspec
from msgspec import Meta

from geort_drake.errors import BenchmarkError
from geort_drake.files import finite_json

CONFIG, SCENARIO, TRIALS = "config.json", "scenario.yaml", "trials.jsonl"
METHODS, ERRORS = "methods", "errors"
_NOT_CONFIG = "{}: not the configuration of a benchmark"


class _ScenarioFields(TypedDict):
    random_seed: int
    timeout: float


class _Settings(TypedDict):
    recording_sha256: str
    operator_sha256: str
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
    operator: str | None
    side: str


class GraspConfig(TypedDict):
    """The configuration of a grasp benchmark."""

    settings: _Settings
    objects: Annotated[list[str], Meta(min_length=1)]
    methods: Annotated[dict[str, _MethodFields], Meta(min_length=1)]
    trials: int
    conditions: NotRequired[dict[str, dict]]
    refused: NotRequired[dict[str, str]]
    notes: _Notes


def read_config(folder: Path) -> dict:
    """Reads the configuration of a grasp benchmark; raises BenchmarkError if it is missing or damaged."""
    path = folder / CONFIG
    if not path.is_file():
        raise BenchmarkError(f"{path}: no such file; is {folder} the folder of a benchmark?")
    return parse_json(path.read_bytes(), GraspConfig, _NOT_CONFIG.format(path))


def continue_config(
    folder: Path, config: dict[str, Any], schema: Any, parts: Sequence[str], any_code: bool = False
) -> dict[str, Any] | None:
    """Checks a configuration against the stored one, and adds the stored entries to it.

    Args:
        folder: folder of the benchmark.
        config: new configuration, extended in place; its `settings` must equal the stored ones.
        schema: schema of the stored configuration.
        parts: keys of dictionaries whose common entries must be equal.
        any_code: whether to accept changed code of the trials.

    Returns:
        The stored configuration, or None.

    Raises:
        BenchmarkError: the configurations differ, the stored one is damaged, or trials lack one.
    """
    path, trials = folder / CONFIG, folder / TRIALS
    if not path.is_file():
        if trials.exists() and trials.stat().st_size:
            raise BenchmarkError(f"{trials}: contains trials but no {CONFIG}; choose another folder")
        return None
    stored = parse_json(path.read_bytes(), schema, _NOT_CONFIG.format(path))
    if any_code:
        config["settings"]["code_sha256"] = stored["settings"]["code_sha256"]
    require_same(path, stored["settings"], config["settings"])
    for part in parts:
        before = stored.get(part, {})
        for name in before.keys() & config[part].keys():
            require_same(path, before[name], config[part][name], f"{part}.{name}.")
        config[part] = {**before, **config[part]}
    return stored


def require_same(path: Path, stored: dict[str, Any], given: dict[str, Any], within: str = "") -> None:
    """Raises BenchmarkError for the first field in which two configurations differ."""
    for field in {**stored, **given}:
        before, now = stored.get(field), given.get(field)
        if isinstance(before, dict) and isinstance(now, dict):
            require_same(path, before, now, f"{within}{field}.")
        elif before != now:
            name, digest, _ = f"{within}{field}".partition("_sha256")
            raise BenchmarkError(
                f"{path}: this benchmark was begun with another {name}"
                + ("" if digest else f": {before}, not {now}")
                + "; use the same, or choose another folder"
            )


def parse_json(text: bytes, schema: Any, where: str) -> dict:
    """Parses JSON that must have at least the fields of a TypedDict or dataclass.

    Raises:
        BenchmarkError: not JSON, or a field is missing, of a wrong type or not finite; starts with `where`.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BenchmarkError(f"{where}: {error}") from error
    check(content, schema, where)
    return content


def check(content: Any, schema: Any, where: str) -> None:
    """Checks parsed JSON; see `parse_json`."""
    try:
        msgspec.convert(content, schema)
    except msgspec.ValidationError as error:
        raise BenchmarkError(f"{where}: {error}") from error
    for name, value in content.items():
        if finite_json(value) != value:
            raise BenchmarkError(f"{where}: {name} must be finite, not {value}")

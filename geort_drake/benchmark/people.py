"""Compares sessions of real people, recorded by the live page, with the simulated person's trials."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from geort_drake.benchmark.motion import FIGURES, motion_of
from geort_drake.benchmark.records import Record
from geort_drake.benchmark.statistics import axes_of, mean_and_interval, proportion, restricted_time, table_of
from geort_drake.errors import BenchmarkError
from geort_drake.people.recording import Recording


class _Outcome(msgspec.Struct):
    success: bool
    seconds: float | None = None


class _Facts(msgspec.Struct):
    """Metadata of a session that are compared; see `PageControl`."""

    object: str
    map: str
    began: float
    outcome: _Outcome


def read_people(folder: Path) -> list[Record]:
    """Reads the sessions in a folder, with a subfolder for each person, as records of trials.

    Returns:
        For each session: `person`, the subfolder; `map`, `object`, `success`; `completion_time` from the
        engagement to the start of the hold, s; and `motion`, see `motion_of`.

    Raises:
        BenchmarkError: there is no session, or one lacks metadata.
        RecordingError: a file is not a recording.
    """
    records: list[Record] = []
    for path in sorted(folder.rglob("[!.]*.npz")):  # a hidden file is an unfinished one
        recording = Recording.load(path)
        if not recording.metadata.get("consent"):
            continue  # such as guided play
        try:
            facts = msgspec.convert(recording.metadata, _Facts)
        except msgspec.ValidationError as error:
            raise BenchmarkError(f"{path}: metadata: {error}") from error
        seconds = facts.outcome.seconds
        time = None if seconds is None else max(seconds - facts.began, 0.0)
        records.append(
            {
                "person": path.parent.relative_to(folder).as_posix(),
                "map": facts.map,
                "object": facts.object,
                "success": facts.outcome.success,
                "completion_time": time,
                "motion": motion_of(recording),
            }
        )
    if not records:
        raise BenchmarkError(
            f"{folder}: contains no session of the live page; record some with "
            f"`geort-drake live --record {folder}/PERSON`"
        )
    return records


def summarize_people(people: Sequence[Record], simulated: Sequence[Record], timeout: float) -> dict:
    """Returns figures of real people for each map, and of the simulated person for each method; JSON-ready.

    Args:
        people: records from `read_people`.
        simulated: records of trials; those with an error or of objects that no person grasped are ignored.
        timeout: time after which a trial has failed, s; sessions of people have no timeout of their own.

    Returns:
        `objects`; `people`: map → `persons` and figures; `simulated`: method → figures: `success`, see
        `proportion`; `completion_time` and the figures of `motion_of`, see `mean_and_interval`.
    """
    objects = sorted({record["object"] for record in people})
    by_map: dict[str, list[Record]] = {}
    for record in people:
        group = by_map.setdefault(record["map"], [])
        late = record["success"] and record["completion_time"] > timeout
        # The bootstrap of objects and seeds resamples persons and their sessions instead.
        number = sum(other["object"] == record["person"] for other in group)
        success = record["success"] and not late
        group.append({**record, "object": record["person"], "seed": number, "success": success})
    by_method: dict[str, list[Record]] = {}
    for record in simulated:
        if "error" not in record and record["object"] in objects:
            by_method.setdefault(record["method"], []).append(record)
    return {
        "objects": objects,
        "people": {
            name: {"persons": len({r["person"] for r in group}), **_figures(group, timeout)}
            for name, group in sorted(by_map.items())
        },
        "simulated": {name: _figures(group, timeout) for name, group in by_method.items()},
    }


def _figures(records: Sequence[Record], timeout: float) -> dict:
    axes = axes_of(records)

    def mean(name: str) -> dict:
        values = table_of(records, axes, lambda record: _number(record.get("motion", {}).get(name)))
        return mean_and_interval(values)

    return {
        "success": proportion(sum(record["success"] for record in records), len(records)),
        "completion_time": mean_and_interval(
            table_of(records, axes, lambda record: restricted_time(record, timeout))
        ),
        **{name: mean(name) for name in FIGURES},
    }


def _number(value: float | None) -> float:
    return np.nan if value is None else value

"""Compares retargeting methods on one hand with the same recordings, protocols and metrics.

The result is one row per method, protocol, part, seed and metric; every table is computed from the rows.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich import box
from rich.console import Group
from rich.padding import Padding
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from geort_drake.errors import GeortError, MapError, RecordingError
from geort_drake.files import finite_json
from geort_drake.hands.hand import Hand
from geort_drake.methods import is_own, resolve
from geort_drake.metrics.evaluation import MIN_FRAMES, evaluate
from geort_drake.people.recording import Recording
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.store import load_retargeter
from geort_drake.versions import versions

SAME_PERSON, HELD_OUT, OTHER_PERSON = "same_person", "held_out", "other_person"
# Successive frames are similar, so frames this close to a held-out block are not used for training, s.
GUARD_S = 1.0

# Protocol → its title in tables, and the meaning of its metrics.
PROTOCOLS = {
    SAME_PERSON: (
        "same person, training recording",
        "trained and scored on the same recording, as in the paper",
    ),
    HELD_OUT: (
        "same person, held-out blocks",
        f"scored on each contiguous block, trained on the rest, {GUARD_S:g} s before and after the block "
        "left out; no coverage, as a block contains too little motion to cover the C-space",
    ),
    OTHER_PERSON: (
        "another person",
        "trained on one person's recording, scored on another's; only a universal map adapts, to the first "
        "second",
    ),
}
# Parts of a protocol: name of a file or block → the recordings for training and for scoring.
Parts = dict[str, tuple[Recording, Recording]]


def held_out(recording: Recording, blocks: int) -> Parts:
    """Divides the valid frames of a recording into `blocks` contiguous blocks, each scored by itself.

    Frames of the block, and those up to GUARD_S before or after it, are invalid in the training recording.

    Raises:
        RecordingError: there are fewer than two blocks, or blocks are too short for the metrics.
    """
    frames = np.flatnonzero(recording.valid)
    limit = len(frames) // MIN_FRAMES
    if not 2 <= blocks <= limit:
        raise RecordingError(
            f"held-out blocks must be 2 to {limit} for {len(frames)} valid frames (at least {MIN_FRAMES} "
            f"each), not {blocks}"
        )
    parts = {}
    for number, block in enumerate(np.array_split(frames, blocks), start=1):
        in_block = np.zeros(len(recording), dtype=bool)
        in_block[block] = True
        first, last = recording.t[block[[0, -1]]]
        away = (recording.t < first - GUARD_S) | (recording.t > last + GUARD_S)
        parts[f"block {number} of {blocks}"] = (
            dataclasses.replace(recording, valid=recording.valid & away),
            dataclasses.replace(recording, valid=in_block),
        )
    return parts


def other_person(recording: Recording, others: Mapping[str, Recording]) -> Parts:
    """Returns the parts that train on one recording and score on others, name → recording.

    Raises:
        RecordingError: one of the others is the training recording.
    """
    for name, other in others.items():
        if other.digest == recording.digest:
            raise RecordingError(f"{name}: this is the training recording; give another one")
    return {name: (recording, other) for name, other in others.items()}


FORMAT = 4  # of the comparison file; incremented when keys change
Row = dict[str, Any]
_KEYS = ["method", "protocol", "metric"]


# A column of a table: name of the metric, heading and format.
Column = tuple[str, str, str]
# Title of each table → its columns. Every table fits a terminal of 80 characters.
TABLES: dict[str, tuple[Column, ...]] = {
    "direction and size": (
        ("motion_preservation", "MP", "{:.3f}"),
        ("motion_preservation_track", "track", "{:.3f}"),
        ("cross_talk", "cross\ntalk", "{:.2f}"),
        ("size.median", "gain", "{:.2f}"),
        ("size.over_affine", "of the\naffine", "{:.2f}"),
        ("size.least_over_affine", "least\nfinger", "{:.2f}"),
        ("gain_p95_p5", "p95/\np5", "{:.3g}"),
        ("flatness", "flat-\nness", "{:.3f}"),
    ),
    "pinches, posture and collision": (
        ("pinch.closed", "pinches\nclosed", "{:.1%}"),
        ("pinch.too_deep", "too\ndeep", "{:.1%}"),
        ("pinch.mean_mm", "mean\nmm", "{:.1f}"),
        ("pinch.p95_mm", "95 %\nmm", "{:.1f}"),
        ("pinch.false", "false", "{:.2%}"),
        ("posture.median", "posture\n°", "{:.0f}"),
        ("posture.p90", "90 %\n°", "{:.0f}"),
        ("self_collision", "self-\ncollision", "{:.1%}"),
    ),
    "reach": (
        ("coverage.5mm", "cover\n5 mm", "{:.2f}"),
        ("coverage.10mm", "\n10 mm", "{:.2f}"),
        ("coverage.15mm", "\n15 mm", "{:.2f}"),
        ("coverage_context_averaged.10mm", "averaged\n10 mm", "{:.2f}"),
        ("self_collision_raw", "raw\ncollision", "{:.1%}"),
        ("pinch.all_pairs.closed", "all pairs\nclosed", "{:.1%}"),
    ),
    "stillness, smoothness and latency": (
        ("jitter", "jitter", "{:.2f}"),
        ("engagement.jump_mm", "jump\nmm", "{:.0f}"),
        ("engagement.settling_mm", "settling\nmm", "{:.1f}"),
        ("smoothness.mean", "step\nrad", "{:.3f}"),
        ("smoothness.p95", "95 %\nrad", "{:.3f}"),
        ("smoothness.jerk", "jerk\nrad/s³", "{:.0f}"),
        ("latency_us.median", "call\nµs", "{:.0f}"),
        ("latency_us.p99", "99 %\nµs", "{:.0f}"),
    ),
}
# Metrics of which higher values are better, and those of which neither are; of all others, lower ones are.
HIGHER = (
    "motion_preservation", "motion_preservation_track", "coverage", "coverage_context_averaged",
    "pinch.closed", "pinch.all_pairs.closed", "size.least_over_affine",
)  # fmt: skip
NEITHER = (
    "pinch.mean_mm", "pinch.all_pairs.mean_mm", "pinch.frames", "pinch.all_pairs.frames", "size.median",
    "size.over_affine", "size.fingers",
)  # fmt: skip
# Method → metrics that its training has as a loss or a bound; a comparison by these is not blind.
TRAINED_ON = {
    "geort": "MP, coverage, flatness, pinches and self-collision",
    "universal": "MP, track, gain, pinches, posture and self-collision",
}


def better(metric: str) -> str | None:
    """Returns whether "higher" or "lower" values of a metric are better; None if neither."""
    for names, direction in ((NEITHER, None), (HIGHER, "higher")):
        if any(metric == name or metric.startswith(f"{name}.") for name in names):
            return direction
    return "lower"


def flat(metrics: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float | None]]:
    """Yields the name of each metric, the keys to it joined by dots, and its value."""
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Evaluates methods one by one under the same protocols.

    An online method gets the recorded frames in order, from rest. Metrics of hands that were not recorded use
    its stationary outputs; see `AnyTeleop.settled_map`. A universal map gets only the first second of the
    scored recording to learn the person.

    Args:
        hand: model of the robot hand.
        protocols: name of each of the `PROTOCOLS` to follow → its parts.
        seeds: seeds of training and metrics; all cases run with each of them.
        frame_limit: largest number of valid frames, from the first on, of each scored recording or block.
    """

    hand: Hand
    protocols: Mapping[str, Parts]
    seeds: Sequence[int]
    frame_limit: int | None = None

    @property
    def cases_per_method(self) -> int:
        """Number of cases that `run` evaluates, over all seeds."""
        return len(self.seeds) * sum(map(len, self.protocols.values()))

    def run(self, name: str, starts: Callable[[str], None] = lambda _note: None) -> list[Row]:
        """Evaluates one method under every protocol.

        Args:
            name: name of a method, or path of a map or a Python file for this hand.
            starts: called with a description before each case.

        Returns:
            Rows with `method`, `protocol`, `part`, `seed`, `metric`, `value`, and `weight`: the number of
            frames of a figure of pinches, else 1. A failed case has one row with an `error` instead of a
            metric; the others continue.
        """
        rows: list[Row] = []
        for protocol, parts in self.protocols.items():
            for seed in self.seeds:
                for part in parts:
                    starts(f"{Path(name).name}, {part}, seed {seed}")
                    key = {"method": name, "protocol": protocol, "part": part, "seed": seed}
                    try:
                        metrics = dict(flat(self._evaluate(name, protocol, part, seed)))
                    except GeortError as error:
                        rows.append({**key, "error": str(error)})
                        continue
                    rows += [
                        {**key, "metric": metric, "value": value, "weight": _weight(metric, metrics)}
                        for metric, value in metrics.items()
                    ]
        return rows

    def _evaluate(self, name: str, protocol: str, part: str, seed: int) -> dict:
        trained_on, source = self.protocols[protocol][part]
        if (count := min(int(source.valid.sum()), self.frame_limit or len(source))) < MIN_FRAMES:
            raise RecordingError(f"{part}: {count} valid frames, at least {MIN_FRAMES} are needed")
        if name not in METHODS and not is_own(name):
            _check_training(name, protocol, part, source)
        retarget, _ = resolve(name, self.hand, trained_on, seed)
        metrics = evaluate(retarget, self.hand, source, seed, self.frame_limit, protocol != HELD_OUT)
        return finite_json(metrics)


def _weight(metric: str, metrics: Mapping[str, float | None]) -> float:
    """Returns the number of frames behind a figure of pinches, so that parts count by them; 1 for others."""
    group, _, name = metric.rpartition(".")
    is_share = group.startswith("pinch") and name not in ("frames", "false")
    return float(metrics[f"{group}.frames"] or 0) if is_share else 1.0


def _check_training(name: str, protocol: str, part: str, scored_on: Recording) -> None:
    """Raises MapError unless the training of a map of one person fits the protocol."""
    recording = load_retargeter(name).info.get("provenance", {}).get("recording")
    if recording is None:
        return  # a universal map
    if protocol == HELD_OUT:
        raise MapError(f"{name}: a map cannot be trained without the block; name its method instead")
    is_same = recording["sha256"] == scored_on.digest
    if protocol == SAME_PERSON and not is_same:
        raise MapError(
            f"{name}: was trained on another recording than {part}; give that one to --recording, "
            "and this one to --score-on"
        )
    if protocol != SAME_PERSON and is_same:
        raise MapError(f"{name}: was trained on {part}; give another person's recording")


def summary(rows: Sequence[Row]) -> pd.DataFrame:
    """Summarises rows over parts and seeds.

    Returns:
        One row per method, protocol and metric: `mean` over seeds of the means over parts, which count by
        their `weight`; the number of pinches is a sum over parts; `worst_part`: worst value over parts and
        seeds, missing for a single part; `worst_seed`: worst of the seeds' means, missing for a single seed.
    """
    frame = pd.DataFrame(rows, columns=[*_KEYS, "part", "seed", "value", "weight"])
    frame = frame.dropna(subset=["metric", "value"]).astype({"value": float, "weight": float})
    result = []
    for key, group in frame.groupby(_KEYS, sort=False):
        metric = key[2]
        means = [_mean_of_parts(metric, parts) for _, parts in group.groupby("seed")]
        worst_part = worst(metric, group["value"]) if group["part"].nunique() > 1 else np.nan
        worst_seed = worst(metric, means) if len(means) > 1 else np.nan
        result.append([*key, np.mean(means), worst_part, worst_seed])
    return pd.DataFrame(result, columns=[*_KEYS, "mean", "worst_part", "worst_seed"])


def _mean_of_parts(metric: str, parts: pd.DataFrame) -> float:
    """Returns the mean over parts, which count by their weight; the sum of a number of frames."""
    if metric.endswith(".frames"):
        return float(parts["value"].sum())
    return float(np.average(parts["value"], weights=parts["weight"]))


def worst(metric: str, values: Sequence[float]) -> float:
    """Returns the worst of several values; NaN if neither higher nor lower ones are better."""
    direction = better(metric)
    return np.nan if direction is None else float(min(values) if direction == "higher" else max(values))


def report(comparison: Comparison, rows: Sequence[Row], recording: Recording, name: str) -> dict:
    """Returns all results as JSON types; docs/reference/comparison-file.md describes them.

    Args:
        comparison: the comparison that produced them.
        rows: rows of all methods, or of those finished so far.
        recording: the training recording.
        name: name of the recording's file.
    """
    successes = [row for row in rows if "error" not in row]
    return {
        "format": FORMAT,
        "hand": comparison.hand.description.name,
        "hand_sha256": comparison.hand.digest,
        "recording": name,
        "recording_sha256": recording.digest,
        "seeds": list(comparison.seeds),
        "frame_limit": comparison.frame_limit,
        "versions": versions(),
        "protocols": {name: PROTOCOLS[name][1] for name in comparison.protocols},
        "metrics": {metric: better(metric) for metric in dict.fromkeys(row["metric"] for row in successes)},
        "rows": successes,
        "errors": [row for row in rows if "error" in row],
        "summary": finite_json(summary(rows).to_dict("records")),
    }


def tables(comparison: Comparison, rows: Sequence[Row]) -> Iterator[Group]:
    """Yields for each protocol its meaning and a few tables with methods as rows.

    The first row of a method is its mean; the worst part and the worst seed follow, if there are several. If
    cases failed, the row states how many succeeded. Empty columns are left out.
    """
    figures = summary(rows)
    methods = dict.fromkeys(row["method"] for row in rows)
    notes = [f"{name} was trained on {TRAINED_ON[name]}." for name in methods if name in TRAINED_ON]
    for protocol in comparison.protocols:
        heading, meaning = PROTOCOLS[protocol]
        protocol_figures = figures[figures["protocol"] == protocol]
        lines = [
            line
            for method in methods
            for line in _lines(method, protocol, rows, protocol_figures[protocol_figures["method"] == method])
        ]
        protocol_tables = [_table(title, columns, lines) for title, columns in TABLES.items()]
        yield Group(
            Rule(f"{comparison.hand.description.name}: {heading}", align="left"),
            Padding(Text("\n".join([meaning, *notes])), (0, 0, 1, 0)),
            *filter(None, protocol_tables),
        )


def _lines(
    method: str, protocol: str, rows: Sequence[Row], figures: pd.DataFrame
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yields the label and the figures of each row of a method."""
    method_rows = [row for row in rows if row["method"] == method and row["protocol"] == protocol]
    cases = {(row["part"], row["seed"]) for row in method_rows}
    failure_count = sum("error" in row for row in method_rows)
    label = Path(method).name + (f" ({len(cases) - failure_count} of {len(cases)})" if failure_count else "")
    for column in ("mean", "worst_part", "worst_seed"):
        values = figures.set_index("metric")[column].dropna().to_dict()
        if column == "mean" or values:
            yield label if column == "mean" else f"  {column.replace('_', ' ')}", values


def _table(title: str, columns: Sequence[Column], lines: Sequence[tuple[str, dict]]) -> Table | None:
    visible = [column for column in columns if any(column[0] in values for _, values in lines)]
    if not visible:
        return None
    table = Table(title=title, title_justify="left", box=box.SIMPLE, padding=(0, 1, 0, 0))
    table.add_column("method")
    for _, heading, _ in visible:
        table.add_column(heading, justify="right", no_wrap=True)
    for label, values in lines:
        cells = (form.format(values[metric]) if metric in values else "–" for metric, _, form in visible)
        table.add_row(label, *cells)
    return table


def failures(rows: Sequence[Row]) -> Iterator[str]:
    """Yields a line for each failed case: method, part, seed and error."""
    for row in rows:
        if "error" in row:
            yield f"{Path(row['method']).name}, {row['part']}, seed {row['seed']}: {row['error']}"

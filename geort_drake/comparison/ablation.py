"""What each criterion contributes: the runs of a sweep as tables in Markdown."""

import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence

from geort_drake.comparison.metric_table import Metric

COLUMNS = (
    Metric("motion_preservation", "motion preservation", "{:.3f}"),
    Metric("motion_preservation_track", "along recorded steps", "{:.3f}"),
    Metric("coverage.10mm", "coverage at 10 mm", "{:.1%}"),
    Metric("coverage_context_averaged.10mm", "context-averaged", "{:.1%}"),
    Metric("cross_talk", "cross-talk", "{:.2f}"),
    Metric("flatness", "flatness", "{:.3f}"),
    Metric("gain_p95_p5", "gain, 95 % / 5 %", "{:.1f}"),
    Metric("pinch.closed", "pinches closed", "{:.1%}"),
    Metric("pinch.too_deep", "too deep", "{:.1%}"),
    Metric("pinch.false", "false pinches", "{:.2%}"),
    Metric("self_collision", "self-collision over 2 mm", "{:.1%}"),
)
LEGEND = """\
The first row of a table is the mean over seeds of the default run. The other rows are changes against it:
the mean of the differences between runs with the same seed, in percentage points where the first row has
percent. ± is the standard deviation over seeds.
"""


def ablation(sweep: Mapping) -> str:
    """The tables of a sweep: for each method the runs without one criterion, then other changes.

    Args:
        sweep: contents of `sweep.json`, see `sweep.read_sweep`.
    """
    ground = sweep["ground"]
    given = ", ".join(f"{name} = {value}" for name, value in ground["settings"].items()) or "defaults"
    parts = [
        "# What each criterion contributes\n",
        f"{ground['hand']}, {ground['recording']}; settings of all runs: {given}.\n",
        LEGEND,
    ]
    for method in dict.fromkeys(record["method"] for record in sweep["runs"]):
        parts += _of_method(method, [record for record in sweep["runs"] if record["method"] == method])
    return "\n".join(parts)


def _of_method(method: str, records: Sequence[Mapping]) -> Iterator[str]:
    figures: dict[tuple, dict[int, Mapping]] = {}  # change → seed → metrics
    for record in records:
        seeds = figures.setdefault((record["changed"], record["value"]), {})
        if "metrics" in record:
            seeds[record["seed"]] = record["metrics"]
    default = figures.pop((None, None), {})
    removed = [change for change in figures if change[1] == 0]
    others = sorted(figures.keys() - removed)
    for title, changes in {"each criterion removed": removed, "other weights": others}.items():
        if not changes:
            continue
        rows = [["default", _listed(default), *(_spread(m, map(m.of, default.values())) for m in COLUMNS)]]
        for name, value in changes:
            ours = figures[name, value]
            both = [(ours[seed], default[seed]) for seed in ours if seed in default]
            cells = [_spread(m, [_difference(m, *pair) for pair in both], "+") for m in COLUMNS]
            rows.append([f"`{name}` = {value:g}", _listed(ours.keys() & default.keys()), *cells])
        head = ["run", "seeds", *(metric.heading for metric in COLUMNS)]
        lines = [head, ["---", "---", *["---:"] * len(COLUMNS)], *rows]
        yield f"## {method}: {title}\n"
        yield "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _listed(seeds: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(seeds))) or "none"


def _difference(metric: Metric, ours: Mapping, theirs: Mapping) -> float | None:
    a, b = metric.of(ours), metric.of(theirs)
    return None if a is None or b is None else a - b


def _spread(metric: Metric, values: Iterable[float | None], sign: str = "") -> str:
    """Mean and standard deviation of what there is, in the metric's form."""
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    text = metric.form.replace("{:", "{:" + sign).format(statistics.mean(known))
    return text if len(known) == 1 else f"{text} ± {metric.form.format(statistics.stdev(known))}"

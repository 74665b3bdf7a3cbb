"""Methods, and settings of a method, against each other: what is gained by one figure is lost by another."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from geort_drake.comparison.metric_table import Metric
from geort_drake.comparison.plot_style import MARKERS, WIDTH, legend_below

COVERAGE = Metric("coverage.10mm", "coverage at 10 mm", "{:.0%}", "higher")
COVERAGE_IN_CONTEXT = Metric(
    "coverage_context_averaged.10mm", "context-averaged coverage at 10 mm", "{:.0%}", "higher"
)
MOTION = Metric("motion_preservation", "motion preservation", "{:.2f}", "higher")
PINCHES = Metric("pinch.closed", "pinches closed", "{:.0%}", "higher")
COLLISION = Metric("self_collision", "self-collision over 2 mm", "{:.1%}", "lower")
# Abscissa and ordinate of each panel.
FRONTIER = ((COVERAGE, MOTION), (COVERAGE, PINCHES), (COVERAGE, COLLISION), (COVERAGE_IN_CONTEXT, MOTION))


def frontier(metrics: Mapping[str, Mapping]) -> Figure:
    """A point per method in each panel of `FRONTIER`; a method without the metric has none there."""
    figure = Figure(figsize=(WIDTH, 6.4), layout="constrained")
    for ax, (x, y) in zip(figure.subplots(2, 2).flat, FRONTIER, strict=True):
        for number, (name, values) in enumerate(metrics.items()):
            marker = MARKERS[number % len(MARKERS)]
            ax.plot(_number(x, values), _number(y, values), marker, color=f"C{number}", label=name, ms=7)
        _label(ax, x, y)
    legend_below(figure)
    return figure


def sweep_frontier(runs: Sequence[Mapping]) -> Figure:
    """The frontier of a sweep, method by method: a line through the values of each setting, seeds averaged.

    Bars span the seeds. A small marker is a value below the default, a large one above; the run without a
    criterion, where its weight is 0, is hollow.

    Args:
        runs: the `runs` of a `sweep.json`; those that failed are left out.
    """
    runs = [run for run in runs if "metrics" in run]
    methods = list(dict.fromkeys(run["method"] for run in runs))
    figure = Figure(figsize=(WIDTH, 7.4 * max(len(methods), 1)), layout="constrained")
    parts = figure.subfigures(max(len(methods), 1), 1, squeeze=False)[:, 0]
    for part, method in zip(parts, methods, strict=False):
        part.suptitle(method)
        _sweep_panels(part, [run for run in runs if run["method"] == method])
    return figure


def _sweep_panels(part: SubFigure, runs: Sequence[Mapping]) -> None:
    groups: dict[tuple, list[Mapping]] = {}  # setting and value → metrics by seed
    usual: Mapping = {}
    for run in runs:
        groups.setdefault((run["changed"], run["value"]), []).append(run["metrics"])
        usual = run["settings"] if run["changed"] is None else usual
    default = groups.pop((None, None), [])
    for ax, (x, y) in zip(part.subplots(2, 2).flat, FRONTIER, strict=True):
        for number, name in enumerate(dict.fromkeys(name for name, _ in groups)):
            colour, marker = f"C{number}", MARKERS[number % len(MARKERS)]
            values = {value: metrics for (changed, value), metrics in groups.items() if changed == name}
            for value, metrics in values.items():
                face, size = ("white", 6) if value == 0 else (colour, 7 if value > usual.get(name, 0) else 4)
                _point(ax, x, y, metrics, color=colour, marker=marker, ms=size, markerfacecolor=face)
            line = values | ({usual[name]: default} if default else {})
            through = [[_mean(metric, line[value]) for metric in (x, y)] for value in sorted(line) if value]
            ax.plot(*np.transpose(through), color=colour, lw=0.8)
            label = name.removesuffix("_weight").replace("_", " ")
            ax.plot([], [], marker, color=colour, label=label, ms=6)
        if default:
            _point(ax, x, y, default, color="black", marker="*", ms=11)
            ax.plot([], [], "*", color="black", label="default", ms=9)
        ax.plot([], [], "o", color="black", markerfacecolor="white", label="removed", ms=6)
        _label(ax, x, y)
    legend_below(part, columns=5)


def _point(ax: Axes, x: Metric, y: Metric, seeds: Sequence[Mapping], **style: Any) -> None:
    """The mean over seeds, with bars from the least to the greatest."""
    numbers = np.array([[_number(metric, values) for values in seeds] for metric in (x, y)])
    across, up = numbers.mean(axis=1)
    xerr, yerr = np.abs(np.stack([numbers.min(axis=1), numbers.max(axis=1)], axis=1) - [[across], [up]])
    ax.errorbar([across], [up], yerr[:, None], xerr[:, None], elinewidth=0.5, **style)


def _mean(metric: Metric, seeds: Sequence[Mapping]) -> float:
    return float(np.mean([_number(metric, values) for values in seeds]))


def _number(metric: Metric, values: Mapping) -> float:
    value = metric.of(values)
    return np.nan if value is None else value


def _label(ax: Axes, x: Metric, y: Metric) -> None:
    """Names both axes, with an arrow to where it is better."""
    for axis, metric in ((ax.xaxis, x), (ax.yaxis, y)):
        axis.set_label_text(f"{metric.heading} →" if metric.better == "higher" else f"← {metric.heading}")
        if metric.form.endswith("%}"):
            axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
            axis.set_major_formatter(PercentFormatter(1.0))
    ax.margins(0.08)

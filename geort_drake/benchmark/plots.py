"""Plots of a grasp benchmark, as SVG text that stands in a page."""

import io
from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from geort_drake.benchmark.records import Record
from geort_drake.benchmark.statistics import completed_share
from geort_drake.comparison.plots import COLOURS, MARKERS, STYLE, WIDTH
from geort_drake.simulation.tasks.grasp.monitor import GraspPhase


def grasp_plots(records: Sequence[Record], summary: Mapping) -> dict[str, str]:
    """Name → SVG of `completion` over time, `success` by object, and time in each `phase`.

    Args:
        records: lines of the results file.
        summary: what `summarize` made of them.
    """
    # Text stays text, and equal figures give equal files.
    with mpl.rc_context({**STYLE, "svg.fonttype": "none", "svg.hashsalt": "geort_drake"}):
        return {
            "completion": _svg(_completion(records, summary)),
            "success": _svg(_success(summary)),
            "phase": _svg(_phases(summary)),
        }


def _completion(records: Sequence[Record], summary: Mapping) -> Figure:
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes = figure.subplots()
    for number, name in enumerate(summary["methods"]):
        curve = completed_share([r for r in records if r["method"] == name], summary["timeout_s"])
        colour = COLOURS[number % len(COLOURS)]
        t, marks = curve.pop("t"), max(1, len(curve["share"]) // 8)
        axes.step(
            t, curve["share"], where="post", label=name, color=colour,
            marker=MARKERS[number % len(MARKERS)], markevery=marks, markersize=4,
        )  # fmt: skip
        axes.fill_between(t, curve["low"], curve["high"], step="post", color=colour, alpha=0.1, linewidth=0)
    axes.set(xlabel="time from the start, s", ylabel="trials completed", ylim=(0, 1.02))
    axes.set_xlim(0, summary["timeout_s"])
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    figure.legend(loc="outside right upper")
    return figure


def _success(summary: Mapping) -> Figure:
    objects, methods = summary["objects"], summary["methods"]
    figure = Figure(figsize=(WIDTH, 1.2 + 0.45 * len(objects)), layout="constrained")
    axes = figure.subplots()
    rows = np.arange(len(objects))
    for number, (name, entry) in enumerate(methods.items()):
        rates = [entry["objects"][thing]["one_time_success"] for thing in objects]
        known = [k for k, rate in enumerate(rates) if rate["rate"] is not None]
        x = np.array([rates[k]["rate"] for k in known])
        bounds = np.array([[rates[k]["low"], rates[k]["high"]] for k in known]).reshape(-1, 2).T
        axes.errorbar(
            x, rows[known] + 0.8 * ((number + 0.5) / len(methods) - 0.5),
            xerr=np.abs(bounds - x), label=name, linestyle="none", elinewidth=1, markersize=4,
            color=COLOURS[number % len(COLOURS)], marker=MARKERS[number % len(MARKERS)],
        )  # fmt: skip
    axes.set(xlabel="one-time success, with Wilson's 95 % interval", xlim=(-0.02, 1.02))
    axes.set_yticks(rows, objects)
    axes.invert_yaxis()
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    figure.legend(loc="outside right upper")
    return figure


def _phases(summary: Mapping) -> Figure:
    methods = summary["methods"]
    figure = Figure(figsize=(WIDTH, 1.0 + 0.35 * len(methods)), layout="constrained")
    axes = figure.subplots()
    start = np.zeros(len(methods))
    phases = [phase.name.lower() for phase in GraspPhase if phase not in (GraspPhase.DONE, GraspPhase.THROWN)]
    for phase, colour in zip(phases, COLOURS, strict=False):
        spent = np.array([entry["overall"]["phase_s"].get(phase, 0.0) for entry in methods.values()])
        axes.barh(list(methods), spent, left=start, label=phase, color=colour, height=0.6)
        start += spent
    axes.set(xlabel="mean time in each phase of a trial, s")
    axes.invert_yaxis()
    figure.legend(loc="outside right upper")
    return figure


def success_panels(panels: Mapping[str, Mapping]) -> str:
    """SVG of small multiples: success against a parameter, a line for each method, with intervals.

    Args:
        panels: parameter → `label` and `conditions`: each `value` → `methods`: name → `proportion`; a
            condition that is `nominal` is marked by an upright line.
    """
    names = list(dict.fromkeys(n for p in panels.values() for c in p["conditions"] for n in c["methods"]))
    with mpl.rc_context({**STYLE, "svg.fonttype": "none", "svg.hashsalt": "geort_drake"}):
        columns = min(3, len(panels))
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(WIDTH, 0.6 + 2.2 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for axes in grid[len(panels) :]:
            axes.remove()
        for axes, panel in zip(grid, panels.values(), strict=False):
            conditions = panel["conditions"]
            # Equally far apart, as factors and shares crowd at one end of a scale; lines a little aside.
            for number, name in enumerate(names):
                known = [k for k, c in enumerate(conditions) if c["methods"].get(name, {}).get("trials")]
                shares = [conditions[k]["methods"][name] for k in known]
                rate = np.array([share["rate"] for share in shares])
                bounds = np.array([[s["low"], s["high"]] for s in shares]).reshape(-1, 2).T
                axes.errorbar(
                    np.array(known) + 0.3 * ((number + 0.5) / len(names) - 0.5), rate,
                    yerr=np.abs(bounds - rate), label=name, elinewidth=0.8, markersize=3.5, linewidth=1,
                    color=COLOURS[number % len(COLOURS)], marker=MARKERS[number % len(MARKERS)],
                )  # fmt: skip
            for k, condition in enumerate(conditions):
                if condition["nominal"]:
                    axes.axvline(k, color="#222222", linewidth=0.8, linestyle=":", zorder=0)
            axes.set(xlabel=panel["label"], ylim=(-0.04, 1.04), xlim=(-0.4, len(conditions) - 0.6))
            axes.set_xticks(range(len(conditions)), [f"{c['value']:g}" for c in conditions])
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        for row in range(rows):
            grid[row * columns].set_ylabel("success")
        if len(names) > 1:
            figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return _svg(figure)


def _svg(figure: Figure) -> str:
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    # The document type and its address have no place inside a page.
    text = stream.getvalue()
    return text[text.index("<svg") :]

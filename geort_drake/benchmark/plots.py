"""Draws plots of a benchmark, as SVG text for a page or a file."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from matplotlib.ticker import PercentFormatter

from geort_drake.benchmark.records import Record
from geort_drake.benchmark.statistics import completed_share

# The Okabe-Ito colours, which colour-blind people can tell apart; marker shapes repeat the distinction.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#777777", "#8C6D31")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
STYLE: Any = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": "medium",
    "figure.facecolor": "white",
    "font.size": 9,
    "grid.alpha": 0.3,
    "legend.frameon": False,
}
WIDTH = 7.0  # inches, the text width of a page
# Keeps text as text instead of paths, and makes equal figures give equal files.
_SVG_STYLE: Any = {**STYLE, "svg.fonttype": "none", "svg.hashsalt": "geort_drake"}


@mpl.rc_context(_SVG_STYLE)
def completion_plot(records: Sequence[Record], methods: Sequence[str], timeout: float) -> str:
    """Plots the fraction of trials completed over time, with intervals, as SVG.

    Args:
        records: records without a condition.
        methods: names of methods, in the order of the legend.
        timeout: end of the time axis, s.
    """
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes = figure.subplots()
    for number, name in enumerate(methods):
        curve = completed_share([r for r in records if r["method"] == name], timeout)
        colour = COLOURS[number % len(COLOURS)]
        t, marks = curve.pop("t"), max(1, len(curve["share"]) // 8)
        axes.step(
            t, curve["share"], where="post", label=name, color=colour,
            marker=MARKERS[number % len(MARKERS)], markevery=marks, markersize=4,
        )  # fmt: skip
        axes.fill_between(t, curve["low"], curve["high"], step="post", color=colour, alpha=0.1, linewidth=0)
    axes.set(xlabel="time from the start, s", ylabel="trials completed", ylim=(0, 1.02))
    axes.set_xlim(0, timeout)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    figure.legend(loc="outside right upper")
    return _svg(figure)


@mpl.rc_context(_SVG_STYLE)
def success_panels(panels: Mapping[str, Mapping]) -> str:
    """Plots success against each parameter, a line for each method, with intervals, as SVG.

    Args:
        panels: parameter → `label` and `conditions`, each with `value`, `methods`: name → `proportion`, and
            `nominal`, which draws a vertical line.
    """
    names = list(dict.fromkeys(n for p in panels.values() for c in p["conditions"] for n in c["methods"]))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(WIDTH, 0.6 + 2.2 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axes in grid[len(panels) :]:
        axes.remove()
    for axes, panel in zip(grid, panels.values(), strict=False):
        conditions = panel["conditions"]
        # Values are equally spaced, because factors would crowd at one end of a linear axis.
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
    # Omits the XML prologue, which a page must not contain.
    text = stream.getvalue()
    return text[text.index("<svg") :]

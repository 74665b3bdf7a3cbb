"""Plots of a grasp benchmark, as SVG text that stands in a page."""

import io
from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from geort_drake.evaluation.grasp_statistics import Record, completed_share
from geort_drake.evaluation.plots import COLOURS, MARKERS, STYLE, WIDTH
from geort_drake.systems.grasp_monitor import GraspPhase


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


def _svg(figure: Figure) -> str:
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    # The document type and its address have no place inside a page.
    text = stream.getvalue()
    return text[text.index("<svg") :]

"""Writes the report of a benchmark: `report.md` with its figures, the same for all tasks."""

import dataclasses as dc
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from geort_drake.benchmark.analysis import endings, frame_of, table
from geort_drake.benchmark.log import TRIALS, read_rows
from geort_drake.benchmark.run import Settings, read_settings
from geort_drake.files import atomic_path, write_text

REPORT, SUCCESS, COMPLETION = "report.md", "success.svg", "completion.svg"
GROUP = ["task", "kind", "condition"]
# The Okabe-Ito colours, which colour-blind people can tell apart; marker shapes repeat the distinction.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#777777", "#8C6D31")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
# Keeps text as text instead of paths, and makes equal figures give equal files.
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
    "svg.fonttype": "none",
    "svg.hashsalt": "geort_drake",
}
WIDTH = 7.0  # inches, the text width of a page
_MEANING = """\
Intervals are 95 % intervals, for a population of objects and people of which these are samples.

- *First attempt*: success without a second attempt. *Score*: degree of success.
- *Time*: mean time to success; failures count as the timeout.
- *Difference*: of success to the first method, in points, over the same objects, people and seeds.
- *Won : lost*: pairs in which only this or only the first method succeeded, and the p-value of the exact sign
  test after Holm's correction for the number of methods.
- *Unattainable*: trials before which free play showed no plan within the method's reach."""


@dc.dataclass(frozen=True)
class Report:
    """The figures of a benchmark.

    Attributes:
        settings: settings of the benchmark.
        frame: its trials, see `frame_of`.
        methods: names of the methods in order.
        tables: (task, kind, condition) → result of `analysis.table`; the condition of the scenario itself is
            empty.
    """

    settings: Settings
    frame: pd.DataFrame
    methods: list[str]
    tables: dict[tuple[str, str, str], pd.DataFrame]

    def judged(self, group: tuple[str, str, str]) -> pd.DataFrame:
        """Returns the trials of a group that have a result."""
        frame = self.frame.groupby(GROUP).get_group(group)
        return frame[frame["error"].isna()]

    @property
    def errors(self) -> int:
        """Number of trials that raised an error."""
        return int(self.frame["error"].notna().sum())

    def to_json(self) -> dict:
        """Returns the tables as JSON types, with intervals as [mean, low, high]."""
        return {
            "errors": self.errors,
            "refused": self.settings.refused,
            "tables": [
                {**dict(zip(GROUP, key, strict=True)), "methods": each.to_dict("records")}
                for key, each in self.tables.items()
            ],
        }


def write_report(folder: Path) -> Report:
    """Writes the report of the finished trials in a benchmark's folder, and returns its figures."""
    settings, rows, links = read_settings(folder), read_rows(folder / TRIALS), []
    frame = frame_of(rows)
    methods = [name for name in settings.methods if rows and name in set(frame["method"])]
    groups = frame.groupby(GROUP, sort=False) if rows else ()
    report = Report(settings, frame, methods, {key: table(each, methods) for key, each in groups})
    for name, title, draw in (
        (SUCCESS, "Success by method, with intervals", _draw_success),
        (COMPLETION, "Fraction of trials completed over time", _draw_completion),
    ):
        if report.tables:
            with mpl.rc_context(STYLE), atomic_path(folder / name) as path:
                draw(report).savefig(path, format="svg", metadata={"Date": None, "Creator": None})
            links.append(f"![{title}]({name})")
    write_text(folder / REPORT, _markdown(report, links))
    return report


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Formats a table in Markdown; all columns but the first contain numbers."""
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]
    escaped = [[cell.replace("|", r"\|") for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in escaped)


def cells(row: Mapping[str, Any]) -> dict[str, str]:
    """Formats the figures of a method, by heading."""
    p = row["p"]
    return {
        "method": row["method"],
        "trials": str(row["trials"]),
        "success, %": row["success"].text(),
        "first attempt, %": row["first_attempt"].text(),
        "score": row["score"].text("{:.2f}", 1.0),
        "time, s": row["time"].text("{:.1f}", 1.0),
        "difference": row["difference"].text("{:+.0f}"),
        "won : lost": "–" if np.isnan(p) else f"{row['won']} : {row['lost']}",
        "p": "–" if np.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}",
        "unattainable": str(row["unattainable"]),
    }


def _markdown(report: Report, links: Sequence[str]) -> str:
    settings, parts = report.settings, ["# Benchmark", _MEANING]
    if report.errors:
        failed = report.frame[report.frame["error"].notna()]
        lines = [f"- {'; '.join(map(str, row[:-1]))}: {row[-1]}" for row in _unique(failed, "error")]
        parts += [f"**Trials that raised an error and are not counted: {report.errors}**", "\n".join(lines)]
    if settings.refused:
        lines = [f"- {case}: {reason}" for case, reason in settings.refused.items()]
        parts += ["Left out, because the hand cannot do it:", "\n".join(lines)]
    for (task, kind, condition), figures in report.tables.items():
        title = f"{task}, {kind} people" + (f", {condition}" if condition else "")
        parts.append(f"## {title}")
        if rows := [cells(row) for row in figures.to_dict("records")]:
            parts.append(markdown_table(list(rows[0]), [list(row.values()) for row in rows]))
        if not condition:
            parts += _details(report, (task, kind, condition))
    parts += ["## Figures", *links] if links else ["There is no trial with a result yet."]
    version = settings.provenance.get("versions", {}).get("geort_drake")
    commit = (settings.provenance.get("git") or {}).get("commit", "unknown")
    latencies = "those of the scenarios"
    if settings.measure_latency:
        measured = {name: 1e3 * (entry["latency_s"] or 0.0) for name, entry in settings.methods.items()}
        latencies = ", ".join(f"{name} {value:.2f} ms" for name, value in measured.items())
    parts += [
        "## How it was made",
        f"Person: {settings.operator or settings.recording or 'an average adult'}. "
        f"Simulated latencies: {latencies}. geort_drake {version}, commit {commit}. Every trial has a row in "
        f"`{TRIALS}`.",
    ]
    return "\n\n".join(parts) + "\n"


def _details(report: Report, group: tuple[str, str, str]) -> list[str]:
    """Returns success by object, and the outcomes and faults of each method, for the trials of a group."""
    frame = report.judged(group)
    if not len(frame):
        return []
    rate = frame.astype({"success": float}).pivot_table("success", "method", "object", sort=False)
    rows = [
        [name, *("–" if np.isnan(value) else f"{100 * value:.0f}" for value in rate.loc[name])]
        for name in report.methods
        if name in rate.index
    ]
    lines = []
    for name in report.methods:
        of_method = frame[frame["method"] == name]
        counts = ", ".join(f"{count} × {ending}" for ending, count in endings(of_method).most_common())
        faults = pd.DataFrame([each for each in of_method["faults"] if isinstance(each, dict)]).sum()
        fault_texts = "".join(f"; {count:.0f} outputs {fault}" for fault, count in faults.items())
        lines.append(f"- {name}: {counts or '–'}{fault_texts}")
    by_object = markdown_table(["success, %", *map(str, rate.columns)], rows)
    return [by_object] * (len(rate.columns) > 1) + ["Outcomes:", "\n".join(lines)]


def _unique(frame: pd.DataFrame, column: str) -> Iterable[tuple]:
    """Returns the distinct values of a column with the number of rows, and the method that had them."""
    for (method, value), group in frame.groupby(["method", column], sort=False):
        yield method, f"{len(group)} {'trial' if len(group) == 1 else 'trials'}", value


def _draw_success(report: Report) -> Figure:
    """Draws success with its interval, a panel for each task and kind of person, by method and condition."""
    panels = dict.fromkeys(group[:2] for group in report.tables)
    points = {
        panel: [
            (method, condition, report.tables[*panel, condition].set_index("method").loc[method, "success"])
            for *of, condition in report.tables
            if tuple(of) == panel
            for method in report.methods
        ]
        for panel in panels
    }
    figure, grid = _grid(len(panels), 0.5 + 0.22 * max(map(len, points.values())))
    for axes, (panel, rows) in zip(grid, points.items(), strict=True):
        for place, (method, _, interval) in enumerate(rows):
            mean, low, high = (100 * value for value in interval)
            if np.isnan(mean):
                continue
            errors = None if np.isnan(low) else [[mean - low], [high - mean]]
            number = report.methods.index(method)
            style = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)]}
            axes.errorbar([mean], [place], xerr=errors, linestyle="", markersize=4, **style)
        axes.set(title=", ".join(panel), xlim=(-2, 102), ylim=(len(rows) - 0.5, -0.5))
        labels = [", ".join(filter(None, (method, condition))) for method, condition, _ in rows]
        axes.set_yticks(range(len(rows)), labels)
        axes.set_xlabel("success, %")
    return figure


def _draw_completion(report: Report) -> Figure:
    """Draws the fraction of trials completed over time, a panel for each task, kind and condition."""
    figure, grid = _grid(len(report.tables), 2.0)
    for axes, group in zip(grid, report.tables, strict=True):
        judged = report.judged(group)
        for number, name in enumerate(report.methods):
            of_method = judged[judged["method"] == name]
            times = np.sort(of_method["completion_time"].dropna().to_numpy(float))
            t = [0.0, *times, of_method["timeout"].max() if len(of_method) else 0.0]
            share = [0.0, *(100 * np.arange(1, len(times) + 1) / max(len(of_method), 1))]
            colour = COLOURS[number % len(COLOURS)]
            axes.step(t, [*share, share[-1]], where="post", label=name, color=colour, linewidth=1.2)
        title = ", ".join(filter(None, group))
        axes.set(title=title, xlabel="time, s", ylabel="completed, %", ylim=(-2, 102))
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _grid(count: int, height: float) -> tuple[Figure, list[Any]]:
    """Makes a figure with `count` panels, two in a row, of this height in inches."""
    columns = min(2, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(WIDTH, 0.8 + (0.5 + height) * rows), layout="constrained")
    grid = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes in grid[count:]:
        axes.remove()
    return figure, grid[:count]

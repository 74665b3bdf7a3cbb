"""Plots of an evaluation: methods against each other, the spaces of the fingertips, and the gain."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure, SubFigure
from matplotlib.rcsetup import cycler
from matplotlib.ticker import PercentFormatter

from geort_drake.evaluation.comparison import Judged
from geort_drake.evaluation.metric_table import Metric
from geort_drake.evaluation.metrics import RobotSpace
from geort_drake.files import atomic_path
from geort_drake.retargeting.map_figures import ROBOT_VOXEL

# Okabe and Ito's colours, which colour-blind people tell apart as well; shapes say the same once more.
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
WIDTH = 7.0  # inches: a page of print between its margins, so that letters keep their size


COVERAGE = Metric("coverage.10mm", "coverage at 10 mm", "{:.0%}", "higher")
COVERAGE_IN_CONTEXT = Metric(
    "coverage_context_averaged.10mm", "context-averaged coverage at 10 mm", "{:.0%}", "higher"
)
MOTION = Metric("motion_preservation", "motion preservation", "{:.2f}", "higher")
PINCHES = Metric("pinch.closed", "pinches closed", "{:.0%}", "higher")
COLLISION = Metric("self_collision", "self-collision over 2 mm", "{:.1%}", "lower")
# Abscissa and ordinate of each panel.
FRONTIER = ((COVERAGE, MOTION), (COVERAGE, PINCHES), (COVERAGE, COLLISION), (COVERAGE_IN_CONTEXT, MOTION))


def write_plots(
    folder: Path, results: Mapping[str, Judged], finger_names: Sequence[str], space: RobotSpace
) -> list[Path]:
    """Writes the frontier, both fingertip spaces as in the paper's figure 2, and the gain.

    Args:
        folder: of the PNG files; made if it is not there.
        results: name or checkpoint of a method → its figures, all on the same frames.
        finger_names: F names.
        space: the C-space of the hand.

    Returns:
        The files; none without results.
    """
    named = {Path(name).name: judged for name, judged in results.items()}
    if not named:
        return []
    human = next(iter(named.values())).p_HF
    clouds = {name: judged.p_BF for name, judged in named.items()}
    with mpl.rc_context(STYLE):
        figures = {
            "frontier.png": frontier({name: judged.metrics for name, judged in named.items()}),
            "fingertips.png": fingertips(human, clouds, finger_names, space.reachable),
            "gain.png": gain({name: judged.gains for name, judged in named.items()}),
        }
        return [save(figure, folder / name) for name, figure in figures.items()]


def write_sweep_plot(folder: Path, runs: Sequence[Mapping]) -> Path:
    """Writes the frontier of a sweep; see `sweep_frontier`."""
    with mpl.rc_context(STYLE):
        return save(sweep_frontier(runs), folder / "frontier.png")


def save(figure: Figure, path: Path) -> Path:
    """Writes a figure to a PNG file, atomically."""
    with atomic_path(path) as draft:
        figure.savefig(draft, dpi=200)
    return path


def frontier(metrics: Mapping[str, Mapping]) -> Figure:
    """A point per method in each panel of `FRONTIER`; a method without the metric has none there."""
    figure = Figure(figsize=(WIDTH, 6.4), layout="constrained")
    for ax, (x, y) in zip(figure.subplots(2, 2).flat, FRONTIER, strict=True):
        for number, (name, values) in enumerate(metrics.items()):
            marker = MARKERS[number % len(MARKERS)]
            ax.plot(_number(x, values), _number(y, values), marker, color=f"C{number}", label=name, ms=7)
        _label(ax, x, y)
    _legend_below(figure)
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
    _legend_below(part, columns=5)


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
            axis.set_major_formatter(PercentFormatter(1.0))
    ax.margins(0.08)


def _legend_below(figure: Figure | SubFigure, columns: int = 4, **options: Any) -> None:
    """One legend for all axes, of what the first one shows."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), columns), **options)


# What is seen from where: (horizontal, vertical) coordinates in B and H.
VIEWS = {"from the side": (0, 2), "from the front": (1, 2)}


def fingertips(
    human: np.ndarray,
    robot: Mapping[str, np.ndarray],
    finger_names: Sequence[str],
    reachable: Sequence[np.ndarray] = (),
    columns: int = 4,
) -> Figure:
    """Where the person's fingertips were and where each method puts the robot's, in two views.

    Args:
        human: (T, F, 3) fingertips in H, m.
        robot: name of a method → (T, F, 3) fingertips in B, m.
        finger_names: F names.
        reachable: per finger, (M, 3) centres of the voxels of the robot's C-space in B, m.
        columns: clouds beside each other.
    """
    clouds = {"human": human, **robot}
    bands = -(-len(clouds) // columns)
    columns = min(columns, len(clouds))
    every = 1000 * np.concatenate([*(points.reshape(-1, 3) for points in clouds.values()), *reachable])
    low, high = every.min(axis=0) - 5, every.max(axis=0) + 5
    span = high - low
    ratios = [span[up] / span[across] for across, up in VIEWS.values()]
    cell = WIDTH / 4 - 0.3
    height = bands * sum(ratio * cell + 0.5 for ratio in ratios) + 0.5
    figure = Figure(figsize=(cell * columns + 1.2, height), layout="constrained")
    grid = figure.add_gridspec(2 * bands, columns, height_ratios=ratios * bands)
    for number, (name, points) in enumerate(clouds.items()):
        band, column = divmod(number, columns)
        for row, (view, (across, up)) in enumerate(VIEWS.items()):
            ax = figure.add_subplot(grid[2 * band + row, column])
            for finger, voxels in enumerate(reachable if name != "human" else ()):
                _shade(ax, voxels[:, [across, up]], f"C{finger}")
            for finger, finger_name in enumerate(finger_names):
                x, y = 1000 * points[:, finger, across], 1000 * points[:, finger, up]
                ax.scatter(x, y, s=1.5, linewidths=0, color=f"C{finger}", label=finger_name)
            ax.set(aspect="equal", xlim=(low[across], high[across]), ylim=(low[up], high[up]))
            ax.set_xlabel(f"{'xyz'[across]} / mm")
            if row == 0:
                ax.set_title(name)
            if column == 0:
                ax.set_ylabel(f"{view}\n{'xyz'[up]} / mm")
            else:
                ax.tick_params(labelleft=False)
    _legend_below(figure, markerscale=6)
    return figure


def _shade(ax: Axes, centres: np.ndarray, colour: str) -> None:
    """Tints the squares of the C-space's voxels, centres (M, 2) in m."""
    squares = np.round(centres / ROBOT_VOXEL - 0.5).astype(int)
    corner = squares.min(axis=0)
    width, height = squares.max(axis=0) - corner + 1
    image = np.full((height, width), np.nan)
    image[tuple((squares - corner).T[::-1])] = 1.0
    left, bottom = 1000 * ROBOT_VOXEL * corner
    extent = (left, left + 1000 * ROBOT_VOXEL * width, bottom, bottom + 1000 * ROBOT_VOXEL * height)
    colours = ListedColormap([colour])
    ax.imshow(image, colours, extent=extent, origin="lower", interpolation="nearest", alpha=0.18)


def gain(gains: Mapping[str, np.ndarray]) -> Figure:
    """How far a robot fingertip moves when the human one moves by 2 mm, as a distribution per method.

    The 5th and 95th percentiles, over all fingers, are marked. Steps that are not answered have no place
    on the logarithmic axis; their share is written beside.

    Args:
        gains: name of a method → (F, N) of `metrics.flatness_and_gain`.
    """
    figure = Figure(figsize=(WIDTH, 0.8 + 0.75 * len(gains)), layout="constrained")
    axes = figure.subplots(len(gains), 1, sharex=True, squeeze=False)[:, 0]
    bins = np.geomspace(0.02, 50, 120)
    for number, (ax, (name, values)) in enumerate(zip(axes, gains.items(), strict=True)):
        low, high = np.percentile(values, (5, 95))
        ax.hist(np.ravel(values), bins, color=f"C{number}", alpha=0.6)
        for mark in (low, high):
            ax.axvline(mark, color=f"C{number}", lw=1.5)
        ax.axvline(1, color="black", lw=0.6, ls=":")
        ax.set(xscale="log", xlim=(bins[0], bins[-1]), yticks=[])
        note = f"5 %: {low:.2g}\n95 %: {high:.2g}\nunanswered: {(values == 0).mean():.0%}"
        ax.text(1.02, 0.5, note, transform=ax.transAxes, va="center", fontsize="small")
        ax.spines["left"].set_visible(False)
        ax.set_ylabel(name, rotation=0, ha="right", va="center")
    axes[-1].set_xlabel("robot fingertip's motion / human fingertip's motion, steps of 2 mm")
    return figure

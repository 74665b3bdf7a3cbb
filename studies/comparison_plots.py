"""Draws the figures of docs/results/open-loop.md.

python studies/comparison_plots.py --recording human_alex.npy

`comparison_frontier.png` shows methods by pairs of metrics, `comparison_fingertips.png` their fingertips.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from geort_drake import HandModel, read_recording
from geort_drake.benchmark.plots import MARKERS, STYLE, WIDTH
from geort_drake.cli.options import CommandParser, methods_for, output_folder
from geort_drake.colours import FINGER_COLOURS
from geort_drake.comparison.comparison import Comparison, Evaluation
from geort_drake.comparison.metric_table import Metric
from geort_drake.comparison.protocols import same_person
from geort_drake.console import run_main, track
from geort_drake.errors import GeortError
from geort_drake.files import atomic_path
from geort_drake.retargeting.training.map_figures import ROBOT_VOXEL

_COVERAGE = Metric("coverage.10mm", "coverage at 10 mm", "{:.0%}", "higher")
_CONTEXT_COVERAGE = Metric(
    "coverage_context_averaged.10mm", "context-averaged coverage at 10 mm", "{:.0%}", "higher"
)
_MOTION = Metric("motion_preservation", "motion preservation", "{:.2f}", "higher")
_PINCHES = Metric("pinch.closed", "pinches closed", "{:.0%}", "higher")
_COLLISION = Metric("self_collision", "self-collision over 2 mm", "{:.1%}", "lower")
# x and y axis of each panel of the frontier.
FRONTIER = (
    (_COVERAGE, _MOTION),
    (_COVERAGE, _PINCHES),
    (_COVERAGE, _COLLISION),
    (_CONTEXT_COVERAGE, _MOTION),
)
# Title of a view of fingertips → its horizontal and vertical coordinate in B and H.
VIEWS = {"from the side": (0, 2), "from the front": (1, 2)}


def main(argv: Sequence[str] | None = None) -> None:
    parser = CommandParser(None, __doc__)
    parser.add_hand()
    parser.add_argument("--recording", type=Path, required=True, help="recording to train on and to show")
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="methods (default: all)")
    parser.add_argument("--output", type=output_folder, default="docs/figures", help="folder of the pictures")
    arguments = parser.parse_args(argv)
    hand = HandModel(arguments.hand)
    recording = read_recording(arguments.recording, hand.description.side, training=True)
    protocol = same_person(recording, arguments.recording.name)
    comparison = Comparison(hand, [protocol], [0])
    done: dict[str, Evaluation] = {}
    for name in track("evaluating", arguments.methods or methods_for(arguments.hand), None):
        (outcome,) = comparison.run(name)[protocol.name]
        if outcome.evaluation is None:
            raise GeortError(f"{name}: {outcome.error}")
        done[Path(name).name] = outcome.evaluation
    human = next(iter(done.values())).p_HF
    clouds = {name: evaluation.p_BF for name, evaluation in done.items()}
    with mpl.rc_context(STYLE):
        figures = {
            "comparison_frontier": frontier({name: each.metrics for name, each in done.items()}),
            "comparison_fingertips": fingertips(
                human, clouds, hand.finger_names, comparison.space(0).reachable
            ),
        }
        for name, figure in figures.items():
            with atomic_path(arguments.output / f"{name}.png") as draft:
                figure.savefig(draft, dpi=200)


def frontier(metrics: Mapping[str, Mapping]) -> Figure:
    """Draws a point per method (name → metrics) in each panel of `FRONTIER` for which it has the metrics."""
    figure = Figure(figsize=(WIDTH, 6.4), layout="constrained")
    for axes, (x, y) in zip(figure.subplots(2, 2).flat, FRONTIER, strict=True):
        for number, (name, values) in enumerate(metrics.items()):
            point = [np.nan if (value := metric.of(values)) is None else value for metric in (x, y)]
            marker = MARKERS[number % len(MARKERS)]
            axes.plot(*point, marker, color=f"C{number}", label=name, markersize=7)
        for axis, metric in ((axes.xaxis, x), (axes.yaxis, y)):
            # The arrow points to better values.
            axis.set_label_text(f"{metric.heading} →" if metric.better == "higher" else f"← {metric.heading}")
            if metric.form.endswith("%}"):
                axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
                axis.set_major_formatter(PercentFormatter(1.0))
        axes.margins(0.08)
    _legend_below(figure)
    return figure


def fingertips(
    human: np.ndarray,
    robot: Mapping[str, np.ndarray],
    finger_names: Sequence[str],
    reachable: Sequence[np.ndarray] = (),
    columns: int = 4,
) -> Figure:
    """Draws the fingertips of the person, and of the robot with each method, in two views.

    Args:
        human: (T, F, 3) fingertips in H, m.
        robot: name of a method → (T, F, 3) fingertips in B, m.
        finger_names: F names.
        reachable: per finger, (M, 3) centres of the voxels of the robot's C-space in B, m.
        columns: number of clouds in a row.
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
            axes = figure.add_subplot(grid[2 * band + row, column])
            for finger, voxels in enumerate(reachable if name != "human" else ()):
                _shade(axes, voxels[:, [across, up]], FINGER_COLOURS[finger_names[finger]])
            for finger, finger_name in enumerate(finger_names):
                x, y = 1000 * points[:, finger, across], 1000 * points[:, finger, up]
                axes.scatter(x, y, s=1.5, linewidths=0, color=FINGER_COLOURS[finger_name], label=finger_name)
            axes.set(aspect="equal", xlim=(low[across], high[across]), ylim=(low[up], high[up]))
            axes.set_xlabel(f"{'xyz'[across]} / mm")
            if row == 0:
                axes.set_title(name)
            if column == 0:
                axes.set_ylabel(f"{view}\n{'xyz'[up]} / mm")
            else:
                axes.tick_params(labelleft=False)
    _legend_below(figure, markerscale=6)
    return figure


def _shade(axes: Axes, centres: np.ndarray, colour: str) -> None:
    """Tints the squares of the C-space's voxels with centres (M, 2), m."""
    squares = np.round(centres / ROBOT_VOXEL - 0.5).astype(int)
    corner = squares.min(axis=0)
    width, height = squares.max(axis=0) - corner + 1
    image = np.full((height, width), np.nan)
    image[tuple((squares - corner).T[::-1])] = 1.0
    left, bottom = 1000 * ROBOT_VOXEL * corner
    extent = (left, left + 1000 * ROBOT_VOXEL * width, bottom, bottom + 1000 * ROBOT_VOXEL * height)
    colours = ListedColormap([colour])
    axes.imshow(image, colours, extent=extent, origin="lower", interpolation="nearest", alpha=0.18)


def _legend_below(figure: Figure, **options: Any) -> None:
    """Draws one legend for all axes, with the entries of the first."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4), **options)


if __name__ == "__main__":
    run_main(main)

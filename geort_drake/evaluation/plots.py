"""Plots of an evaluation: where methods stand against each other, and where they put the fingertips."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geort_drake.evaluation.comparison import Judged
from geort_drake.files import atomic_path

STYLE: Any = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "font.size": 9,
    "grid.alpha": 0.3,
}


def write_plots(
    folder: Path, results: Mapping[str, Judged], frames: np.ndarray, finger_names: Sequence[str]
) -> list[Path]:
    """Writes the frontier, and both fingertip spaces as in the paper's figure 2.

    Args:
        folder: of the PNG files; made if it is not there.
        results: name or checkpoint of a method → its figures.
        frames: (T, F, 3) human fingertips in H that the methods were scored on, m.
        finger_names: F names.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        figures = {
            "frontier.png": _frontier(results),
            "fingertips.png": _fingertips(results, frames, finger_names),
        }
        for name, figure in figures.items():
            with atomic_path(folder / name) as draft:
                figure.savefig(draft, dpi=150)
    return [folder / name for name in figures]


def looked_up(metrics: Mapping, path: Sequence[str]) -> float | None:
    """The figure at a path of keys; None where the metric, or a part on the way, is None."""
    value = metrics
    for key in path:
        if value is None:
            return None
        value = value[key]
    return value  # type: ignore[return-value]


def _frontier(results: Mapping[str, Judged]) -> Figure:
    axes_of = {
        "motion preservation": ("motion_preservation",),
        "pinches closed": ("pinch", "closed"),
        "self-collision over 2 mm": ("self_collision",),
        "gain, 95th over 5th percentile": ("gain_p95_p5",),
    }
    figure = Figure(figsize=(3.1 * len(axes_of), 3.4), layout="constrained")
    axes = figure.subplots(1, len(axes_of))
    for ax, (label, path) in zip(axes, axes_of.items(), strict=True):
        for number, (name, judged) in enumerate(results.items()):
            x, y = looked_up(judged.metrics, ("coverage", "10mm")), looked_up(judged.metrics, path)
            if x is not None and y is not None:
                ax.scatter(x, y, color=f"C{number}", label=Path(name).name, s=40, zorder=3)
        ax.set(xlabel="coverage at 10 mm", ylabel=label, xlim=(0, 1))
    # A method that never moves, or steps, has a gain of any size.
    axes[-1].set_yscale("symlog")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _fingertips(results: Mapping[str, Judged], frames: np.ndarray, finger_names: Sequence[str]) -> Figure:
    clouds = {"human": frames, **{Path(name).name: judged.p_BF for name, judged in results.items()}}
    figure = Figure(figsize=(2.4 * len(clouds), 3.2), layout="constrained")
    axes = figure.subplots(1, len(clouds), squeeze=False)
    for ax, (name, points) in zip(axes[0], clouds.items(), strict=True):
        for number, finger in enumerate(finger_names):
            x, z = points[:, number, 0], points[:, number, 2]
            ax.scatter(1000 * x, 1000 * z, s=1, color=f"C{number}", label=finger)
        ax.set(title=name, xlabel="x / mm", aspect="equal")
    axes[0, 0].set_ylabel("z / mm")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, markerscale=6
    )
    return figure

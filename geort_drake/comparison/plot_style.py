"""How all plots look."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure, SubFigure
from matplotlib.rcsetup import cycler

from geort_drake.files import atomic_path

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


def save(figure: Figure, path: Path) -> Path:
    """Writes a figure to a PNG file, atomically."""
    with atomic_path(path) as draft:
        figure.savefig(draft, dpi=200)
    return path


def legend_below(figure: Figure | SubFigure, columns: int = 4, **options: Any) -> None:
    """One legend for all axes, of what the first one shows."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), columns), **options)

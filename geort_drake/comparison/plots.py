"""Plots of an evaluation, as files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl

from geort_drake.comparison import distribution_plots as distribution
from geort_drake.comparison.comparison import Judged
from geort_drake.comparison.fingertip_plots import fingertips
from geort_drake.comparison.frontier_plots import frontier, sweep_frontier
from geort_drake.comparison.metrics import RobotSpace
from geort_drake.comparison.plot_style import STYLE, save


def write_plots(
    folder: Path, results: Mapping[str, Judged], finger_names: Sequence[str], space: RobotSpace
) -> list[Path]:
    """Writes the frontier, the fingertip spaces, and the distributions of motion, gain, coverage and time.

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
    made_of = {name: judged.distributions for name, judged in named.items()}
    clouds = {name: each.p_BF for name, each in made_of.items()}
    with mpl.rc_context(STYLE):
        figures = {
            "frontier.png": frontier({name: judged.metrics for name, judged in named.items()}),
            "fingertips.png": fingertips(human, clouds, finger_names, space.reachable),
            "coverage.png": distribution.coverage(space.reachable, clouds),
            "motion.png": distribution.motion({name: each.cosines for name, each in made_of.items()}),
            "gain.png": distribution.gain({name: each.gains for name, each in made_of.items()}),
            "call_times.png": distribution.call_times(
                {name: each.call_times for name, each in made_of.items()}
            ),
        }
        return [save(figure, folder / name) for name, figure in figures.items()]


def write_sweep_plot(folder: Path, runs: Sequence[Mapping]) -> Path:
    """Writes the frontier of a sweep; see `sweep_frontier`."""
    with mpl.rc_context(STYLE):
        return save(sweep_frontier(runs), folder / "frontier.png")

"""What a mean hides: how motion, gain, coverage and the time of a call are distributed, a method each."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from geort_drake.comparison.plot_style import WIDTH

FARTHEST = 0.03  # m, in the plot of coverage


def motion(cosines: Mapping[str, np.ndarray]) -> Figure:
    """How far the robot fingertip's direction is from the human one's; median and 95th percentile are marked.

    Args:
        cosines: name of a method → (F, N) of `map_figures.motion_cosines`; unanswered steps are at 90°.
    """
    angles = {name: np.degrees(np.arccos(np.clip(values, -1, 1))) for name, values in cosines.items()}
    return _rows(
        angles,
        np.linspace(0, 180, 181),
        (50, 95),
        lambda marks, _: f"median: {marks[0]:.0f}°\n95 %: {marks[1]:.0f}°",
        "angle between the fingertips' motions / °, steps of 1 to 11 mm",
        "linear",
    )


def gain(gains: Mapping[str, np.ndarray]) -> Figure:
    """How far a robot fingertip moves when the human one moves by 2 mm.

    The 5th and 95th percentiles, over all fingers, are marked. Steps that are not answered have no place
    on the logarithmic axis; their share is written beside.

    Args:
        gains: name of a method → (F, N) of `metrics.flatness_and_gain`.
    """
    figure = _rows(
        gains,
        np.geomspace(0.02, 50, 120),
        (5, 95),
        lambda marks, values: (
            f"5 %: {marks[0]:.2g}\n95 %: {marks[1]:.2g}\nunanswered: {(values == 0).mean():.0%}"
        ),
        "robot fingertip's motion / human fingertip's motion, steps of 2 mm",
        "log",
    )
    for ax in figure.axes:
        ax.axvline(1, color="black", lw=0.6, ls=":")
    return figure


def call_times(times: Mapping[str, np.ndarray]) -> Figure:
    """How long a call with one hand takes; median and 99th percentile are marked.

    Args:
        times: name of a method → (N,) of `metrics.call_times`, s.
    """
    return _rows(
        {name: 1e6 * values for name, values in times.items()},
        np.geomspace(5, 1e5, 150),
        (50, 99),
        lambda marks, _: f"median: {marks[0]:,.0f} µs\n99 %: {marks[1]:,.0f} µs",
        "time of a call / µs",
        "log",
    )


def coverage(voxels: Sequence[np.ndarray], clouds: Mapping[str, np.ndarray]) -> Figure:
    """The share of the C-space that is within a distance of where the fingertips went, over the distance.

    Args:
        voxels: F arrays (M, 3) of the hand's reachable places, in the robot hand base B, m.
        clouds: name of a method → (T, F, 3) in B, m.
    """
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    ax = figure.subplots()
    radii = np.linspace(0, FARTHEST, 121)
    for name, cloud in clouds.items():
        shares = []
        for finger, centres in enumerate(voxels):
            distance, _ = cKDTree(cloud[:, finger]).query(centres, distance_upper_bound=FARTHEST)
            shares.append(np.searchsorted(np.sort(distance), radii, side="right") / len(centres))
        ax.plot(1000 * radii, np.mean(shares, axis=0), label=name)
    ax.axvline(10, color="black", lw=0.6, ls=":")
    ax.set(xlim=(0, 1000 * FARTHEST), ylim=(0, 1), xlabel="distance / mm", ylabel="share of the C-space")
    figure.legend(loc="outside right center")
    return figure


def _rows(
    distributions: Mapping[str, np.ndarray],
    bins: np.ndarray,
    percentiles: tuple[float, float],
    note_of: Callable[[np.ndarray, np.ndarray], str],
    label: str,
    scale: str,
) -> Figure:
    """A histogram per method, one below the other, with two percentiles marked and what they are."""
    figure = Figure(figsize=(WIDTH, 0.8 + 0.75 * len(distributions)), layout="constrained")
    axes = figure.subplots(len(distributions), 1, sharex=True, squeeze=False)[:, 0]
    for number, (ax, (name, values)) in enumerate(zip(axes, distributions.items(), strict=True)):
        marks = np.percentile(values, percentiles)
        ax.hist(np.ravel(values), bins, color=f"C{number}", alpha=0.6)
        for mark in marks:
            ax.axvline(mark, color=f"C{number}", lw=1.5)
        ax.set(xscale=scale, xlim=(bins[0], bins[-1]), yticks=[])
        ax.text(1.02, 0.5, note_of(marks, values), transform=ax.transAxes, va="center", fontsize="small")
        ax.spines["left"].set_visible(False)
        ax.set_ylabel(name, rotation=0, ha="right", va="center")
    axes[-1].set_xlabel(label)
    return figure

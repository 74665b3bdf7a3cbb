"""Plots show the numbers they are given, in the right places."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from geort_drake.comparison import plots
from geort_drake.retargeting.training.map_figures import robot_voxels

NAMES = ("thumb", "index")


def figures_of(motion: float, coverage: float, closed: float | None = 0.5) -> dict:
    """The part of a method's metrics that the frontier shows."""
    return {
        "motion_preservation": motion,
        "coverage": {"10mm": coverage},
        "coverage_context_averaged": {"10mm": 0.9 * coverage},
        "pinch": None if closed is None else {"closed": closed},
        "self_collision": 0.01,
    }


def points_of(ax, label: str) -> list:
    """The points of one label in a panel."""
    return [tuple(line.get_xydata()[0]) for line in ax.lines if line.get_label() == label]


def drawn(figure: Figure) -> None:
    """Lays a figure out and draws it; matplotlib finds many faults only then."""
    figure.canvas.draw()


def test_the_frontier_has_a_point_for_every_method_that_has_the_metric():
    """A recording without pinches has no such figure, and its methods no such point."""
    figure = plots.frontier({"ours": figures_of(0.9, 0.6), "theirs": figures_of(0.7, 0.8, closed=None)})
    drawn(figure)
    motion, pinches, _, context = figure.axes
    assert points_of(motion, "ours") == [(0.6, 0.9)] and points_of(motion, "theirs") == [(0.8, 0.7)]
    assert points_of(pinches, "ours") == [(0.6, 0.5)]
    assert np.isnan(points_of(pinches, "theirs")).tolist() == [[False, True]]
    assert points_of(context, "theirs") == [pytest.approx((0.72, 0.7))]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ours", "theirs"]


def test_both_fingertip_spaces_are_shown_from_two_sides(rng):
    """The human's has no C-space behind it; a fifth cloud begins a second band."""
    human, robot = rng.uniform(-0.04, 0.04, (2, 50, 2, 3))
    methods = {f"method {k}": robot for k in range(4)}
    figure = plots.fingertips(human, methods, NAMES, robot_voxels(robot))
    drawn(figure)
    assert [ax.get_title() for ax in figure.axes[::2]] == ["human", *methods]
    assert [len(ax.images) for ax in figure.axes] == [0, 0] + 8 * [2]
    side, front = figure.axes[2:4]
    np.testing.assert_allclose(side.collections[1].get_offsets(), 1000 * robot[:, 1, [0, 2]])
    np.testing.assert_allclose(front.collections[0].get_offsets(), 1000 * robot[:, 0, [1, 2]])

"""Plots show the numbers they are given, in the right places."""

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from geort_drake.comparison import distribution_plots, fingertip_plots, frontier_plots
from geort_drake.retargeting.training.map_figures import ROBOT_VOXEL, coverage, robot_voxels

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


def run_of(changed, value, seed, motion, coverage) -> dict:
    """A run of a sweep in which the default of a_weight is 2 and that of b_weight 3."""
    settings = {"a_weight": 2.0, "b_weight": 3.0} | ({changed: value} if changed else {})
    run = {"method": "geort", "changed": changed, "value": value, "seed": seed, "settings": settings}
    return {**run, "metrics": figures_of(motion, coverage)}


def points_of(ax, label: str) -> list:
    """The points of one label in a panel."""
    return [tuple(line.get_xydata()[0]) for line in ax.lines if line.get_label() == label]


def drawn(figure: Figure) -> None:
    """Lays a figure out and draws it; matplotlib finds many faults only then."""
    figure.canvas.draw()


def test_the_frontier_has_a_point_for_every_method_that_has_the_metric():
    """A recording without pinches has no such figure, and its methods no such point."""
    figure = frontier_plots.frontier(
        {"ours": figures_of(0.9, 0.6), "theirs": figures_of(0.7, 0.8, closed=None)}
    )
    drawn(figure)
    motion, pinches, _, context = figure.axes
    assert points_of(motion, "ours") == [(0.6, 0.9)] and points_of(motion, "theirs") == [(0.8, 0.7)]
    assert points_of(pinches, "ours") == [(0.6, 0.5)]
    assert np.isnan(points_of(pinches, "theirs")).tolist() == [[False, True]]
    assert points_of(context, "theirs") == [pytest.approx((0.72, 0.7))]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ours", "theirs"]


def test_a_sweeps_lines_go_from_the_least_value_through_the_default():
    """Seeds are averaged; the run without a criterion is hollow and on no line; failures are left out."""
    runs = [
        run_of(None, None, 0, 0.90, 0.50),
        run_of(None, None, 1, 0.94, 0.54),
        run_of("a_weight", 4.0, 0, 0.8, 0.7),
        run_of("a_weight", 1.0, 0, 0.95, 0.4),
        run_of("a_weight", 0.0, 0, 0.97, 0.1),
        run_of("b_weight", 0.0, 0, 0.6, 0.6),
        {
            "method": "geort",
            "changed": "b_weight",
            "value": 6.0,
            "seed": 0,
            "settings": {},
            "error": "TrainingError: no",
        },
    ]
    figure = frontier_plots.sweep_frontier(runs)
    drawn(figure)
    ax = figure.axes[0]
    lines = [
        line.get_xydata() for line in ax.lines if line.get_linestyle() == "-" and len(line.get_xydata()) > 1
    ]
    assert any(np.allclose(line, [(0.4, 0.95), (0.52, 0.92), (0.7, 0.8)]) for line in lines)
    assert not any(np.isclose(line, (0.1, 0.97)).all(axis=1).any() for line in lines)
    hollow = [
        tuple(line.get_xydata()[0])
        for line in ax.lines
        if len(line.get_xydata()) == 1 and to_hex(line.get_markerfacecolor()) == "#ffffff"
    ]
    assert sorted(hollow) == [(0.1, 0.97), (0.6, 0.6)]
    labels = [text.get_text() for text in figure.subfigs[0].legends[0].get_texts()]
    assert labels == ["a", "b", "default", "removed"]


def test_the_c_space_is_shaded_where_its_voxels_are(rng):
    """A voxel's square is filled, its neighbour outside is not."""
    points = rng.uniform([0.01, -0.02], [0.05, 0.06], (500, 2))
    centres = (np.unique(np.floor(points / ROBOT_VOXEL), axis=0) + 0.5) * ROBOT_VOXEL
    ax = Figure().subplots()
    fingertip_plots._shade(ax, centres, "C0")
    (image,) = ax.images
    left, right, bottom, top = image.get_extent()
    shown = np.ma.filled(image.get_array(), 0.0)
    rows, columns = np.nonzero(np.nan_to_num(shown))
    height, width = shown.shape
    x = left + (columns + 0.5) * (right - left) / width
    y = bottom + (rows + 0.5) * (top - bottom) / height
    found = np.stack([x, y], axis=1)
    np.testing.assert_allclose(found[np.lexsort(found.T)], 1000 * centres[np.lexsort(centres.T)], atol=1e-9)


def test_both_fingertip_spaces_are_shown_from_two_sides(rng):
    """The human's has no C-space behind it; a fifth cloud begins a second band."""
    human, robot = rng.uniform(-0.04, 0.04, (2, 50, 2, 3))
    methods = {f"method {k}": robot for k in range(4)}
    figure = fingertip_plots.fingertips(human, methods, NAMES, robot_voxels(robot))
    drawn(figure)
    assert [ax.get_title() for ax in figure.axes[::2]] == ["human", *methods]
    assert [len(ax.images) for ax in figure.axes] == [0, 0] + 8 * [2]
    side, front = figure.axes[2:4]
    np.testing.assert_allclose(side.collections[1].get_offsets(), 1000 * robot[:, 1, [0, 2]])
    np.testing.assert_allclose(front.collections[0].get_offsets(), 1000 * robot[:, 0, [1, 2]])


def test_the_gain_is_marked_at_its_percentiles(rng):
    """Unanswered steps have no place on a logarithmic axis, so their share is written."""
    gains = np.exp(rng.normal(0, 0.5, (2, 400)))
    half = gains * (np.arange(400) % 2)
    figure = distribution_plots.gain({"all": gains, "half": half, "none": np.zeros((2, 400))})
    drawn(figure)
    marks = [line.get_xdata()[0] for line in figure.axes[0].lines]
    np.testing.assert_allclose(marks[:2], np.percentile(gains, (5, 95)))
    notes = [ax.texts[0].get_text() for ax in figure.axes]
    assert [note.splitlines()[-1] for note in notes] == [
        f"unanswered: {share}" for share in ("0%", "50%", "100%")
    ]


def test_motion_is_shown_as_an_angle():
    """Unanswered steps, of cosine 0, are at 90°; a perfect method is at 0, and one the wrong way at 180."""
    figure = distribution_plots.motion(
        {"half": np.tile([np.cos(0.5), 0.0], (2, 50)), "best": np.ones((2, 9)), "wrong": -np.ones((2, 9))}
    )
    drawn(figure)
    half, best, wrong = figure.axes
    assert half.texts[0].get_text() == "median: 59°\n95 %: 90°"
    assert best.texts[0].get_text() == "median: 0°\n95 %: 0°"
    heights = [patch.get_height() for patch in half.patches]
    assert heights[28] == heights[90] == 100.0 and sum(heights) == 200.0  # 0.5 rad is 28.6°
    assert wrong.texts[0].get_text() == "median: 180°\n95 %: 180°"
    assert sum(patch.get_height() for patch in wrong.patches) == 18.0


def test_call_times_are_in_microseconds():
    """Median and 99th percentile are written."""
    figure = distribution_plots.call_times({"quick": np.full(100, 15e-6), "slow": np.full(100, 0.012)})
    drawn(figure)
    notes = [ax.texts[0].get_text() for ax in figure.axes]
    assert notes == ["median: 15 µs\n99 %: 15 µs", "median: 12,000 µs\n99 %: 12,000 µs"]


def test_coverage_over_distance_agrees_with_the_figure(rng):
    """At 5, 10 and 15 mm the curve has the metric's values."""
    cloud, reachable = (
        rng.uniform(-0.02, 0.02, (60, 2, 3)),
        robot_voxels(rng.uniform(-0.04, 0.04, (900, 2, 3))),
    )
    figure = distribution_plots.coverage(reachable, {"ours": cloud})
    drawn(figure)
    x, y = figure.axes[0].lines[0].get_data()
    for name, share in coverage(reachable, list(np.moveaxis(cloud, 1, 0))).items():
        assert np.interp(float(name.removesuffix("mm")), x, y) == pytest.approx(share, abs=1e-3)

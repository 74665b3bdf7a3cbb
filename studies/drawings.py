"""Draws the docs' pictures that explain: keypoints and frames, pipeline, criteria, and the main results.

python studies/drawings.py --output docs/images
"""

import argparse
import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch

from geort_drake.people.synthetic.hand import HumanHand

HUMAN, ROBOT, BAD, INK, PALE = "#00897b", "#e64a19", "#c62828", "#37474f", "#cfd8dc"
# Joint angles of an open, spread hand, deg: abduction and three flexions per finger.
SPREAD_HAND = np.deg2rad([10, -5, 0, 0, 12, 0, 4, 4, 2, 0, 4, 4, -8, 0, 4, 4, -18, 0, 4, 4])
FINGERS = ("thumb", "index", "middle", "ring", "little")


def draw_keypoints() -> Figure:
    """The 21 keypoints of an open hand in the wrist frame H, seen onto the palm."""
    p_HK = 1e3 * HumanHand.anatomical().keypoints(SPREAD_HAND[None])[0]  # mm
    figure, axes = plt.subplots(figsize=(5.2, 5.6))
    # The palm faces the reader, so that H's y axis points to the right.
    y, z = p_HK[:, 1], p_HK[:, 2]
    for finger in range(5):
        points = [0, *range(4 * finger + 1, 4 * finger + 5)]
        axes.plot(y[points], z[points], color=PALE, lw=7, solid_capstyle="round", zorder=1)
        x_name, y_name = y[points[-1]], z[points[-1]]
        axes.text(x_name, y_name + 9, FINGERS[finger], ha="center", va="bottom", color=INK, fontsize=10)
    tips = [4, 8, 12, 16, 20]
    axes.scatter(y, z, s=[60 if i in tips else 26 for i in range(21)], color=HUMAN, zorder=3)
    for i in range(21):
        axes.text(y[i] + 3.5, z[i] - 1, str(i), fontsize=8, color=INK, zorder=4)
    for direction, name in (((55, 0), "y"), ((0, 55), "z")):
        arrow(axes, (0, 0), direction, ROBOT)
        axes.text(1.12 * direction[0], 1.12 * direction[1], name, color=ROBOT, ha="center", va="center")
    axes.add_patch(Circle((0, 0), 4.5, fill=False, color=ROBOT, lw=1.6, zorder=5))
    axes.add_patch(Circle((0, 0), 1.2, color=ROBOT, zorder=5))
    axes.text(-9, -9, "x, to the reader", color=ROBOT, ha="right", fontsize=9)
    finish(axes, "Right hand, palm towards you: keypoints in frame H")
    axes.set_aspect("equal")
    axes.margins(0.12)
    return figure


def draw_pipeline() -> Figure:
    """From a hand to the motors: what each part receives and sends."""
    boxes = (
        ("your hand", "glove, headset,\ncamera, recording", HUMAN),
        ("checks", "side, size, stamps,\nlost frames", INK),
        ("map", "universal, GeoRT,\nyour method", ROBOT),
        ("limits", "position, speed,\nacceleration", INK),
        ("correction", "collision guard,\npolicy", INK),
        ("robot hand", "in Drake, or\nyour driver", ROBOT),
    )
    figure, axes = plt.subplots(figsize=(10.4, 2.5))
    for number, (name, text, colour) in enumerate(boxes):
        left = 1.75 * number
        axes.add_patch(
            FancyBboxPatch(
                (left, 0), 1.35, 1, boxstyle="round,pad=0.03,rounding_size=0.12", fc="white", ec=colour, lw=2
            )
        )
        axes.text(
            left + 0.675, 0.74, name, ha="center", va="center", color=colour, fontsize=11, weight="bold"
        )
        axes.text(left + 0.675, 0.3, text, ha="center", va="center", color=INK, fontsize=7.5)
        if number:
            arrow(axes, (left - 0.36, 0.5), (left - 0.04, 0.5), INK)
    labels = ("21 keypoints", "fingertips", "joint angles", "targets", "commands")
    for number, text in enumerate(labels):
        axes.text(1.75 * number + 1.52, 1.22, text, ha="center", color=INK, fontsize=8.5, style="italic")
    axes.plot([9.4, 9.4, 0.65], [-0.04, -0.5, -0.5], color=HUMAN, lw=1.6)
    arrow(axes, (0.65, -0.5), (0.65, -0.04), HUMAN)
    axes.text(
        5.0,
        -0.44,
        "the person sees the robot, and corrects",
        ha="center",
        va="bottom",
        color=HUMAN,
        fontsize=9.5,
    )
    finish(axes)
    axes.set_xlim(-0.1, 10.15)
    axes.set_ylim(-0.62, 1.45)
    return figure


def draw_criteria() -> Figure:
    """The five criteria of GeoRT, one panel each: what the human hand does, and what the robot's should."""
    panels: tuple[tuple[str, Callable[[Axes], None]], ...] = (
        ("I  motion preservation", _direction),
        ("II  coverage", _coverage),
        ("III  flatness", _flatness),
        ("IV  pinch", _pinch),
        ("V  no collision", _collision),
    )
    figure, axes = plt.subplots(1, 5, figsize=(12.5, 2.9))
    for each, (title, draw) in zip(axes, panels, strict=True):
        draw(each)
        finish(each, title)
        each.set_xlim(-0.05, 2.05)
        each.set_ylim(-0.12, 1.15)
        each.set_aspect("equal")
    return figure


def _direction(axes: Axes) -> None:
    for left, colour in ((0.15, HUMAN), (1.2, ROBOT)):
        axes.add_patch(Circle((left + 0.1, 0.3), 0.06, color=colour))
        arrow(axes, (left + 0.1, 0.3), (left + 0.55, 0.85), colour)
    wrong = FancyArrowPatch(
        (1.3, 0.3), (1.85, 0.36), color=BAD, arrowstyle="-|>", mutation_scale=12, lw=1.4, ls=":"
    )
    axes.add_patch(wrong)
    axes.text(1.0, -0.02, "same direction", ha="center", color=INK, fontsize=9)


def _coverage(axes: Axes) -> None:
    rng = np.random.default_rng(1)
    for left, colour, count in ((0.05, HUMAN, 40), (1.05, ROBOT, 60)):
        axes.add_patch(
            FancyBboxPatch(
                (left + 0.08, 0.22),
                0.75,
                0.7,
                boxstyle="round,pad=0.02,rounding_size=0.3",
                fc="none",
                ec=colour,
            )
        )
        angle, radius = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0, 1, count))
        axes.scatter(
            left + 0.46 + 0.34 * radius * np.cos(angle),
            0.57 + 0.32 * radius * np.sin(angle),
            s=5,
            color=colour,
        )
    axes.text(1.0, -0.02, "all that the robot can reach", ha="center", color=INK, fontsize=9)


def _flatness(axes: Axes) -> None:
    for left, colour, slope in ((0.1, HUMAN, 0.35), (1.1, ROBOT, 0.55)):
        t = np.linspace(0, 1, 6)
        x, y = left + 0.8 * t, 0.35 + slope * t
        axes.plot(x, y, color=colour, lw=1.2)
        axes.scatter(x, y, s=22, color=colour)
    axes.text(1.0, -0.02, "equal steps stay equal", ha="center", color=INK, fontsize=9)


def _pinch(axes: Axes) -> None:
    for left, colour in ((0.05, HUMAN), (1.05, ROBOT)):
        axes.plot(
            [left + 0.12, left + 0.2, left + 0.5],
            [0.25, 0.8, 0.66],
            color=colour,
            lw=6,
            solid_capstyle="round",
        )
        axes.plot(
            [left + 0.8, left + 0.78, left + 0.56],
            [0.25, 0.5, 0.62],
            color=colour,
            lw=6,
            solid_capstyle="round",
        )
    axes.text(1.0, -0.02, "tips meet when yours meet", ha="center", color=INK, fontsize=9)


def _collision(axes: Axes) -> None:
    axes.plot([0.25, 0.25, 0.6], [0.25, 0.7, 0.9], color=ROBOT, lw=6, solid_capstyle="round")
    axes.plot([0.6, 0.55, 0.75], [0.25, 0.65, 0.95], color=ROBOT, lw=6, solid_capstyle="round")
    axes.plot([1.25, 1.3, 1.75], [0.25, 0.7, 0.9], color=BAD, lw=6, solid_capstyle="round", alpha=0.55)
    axes.plot([1.7, 1.6, 1.4], [0.25, 0.6, 0.95], color=BAD, lw=6, solid_capstyle="round", alpha=0.55)
    axes.text(1.0, -0.02, "beside, not through", ha="center", color=INK, fontsize=9)


# Method → motion preservation, pinches closed (%), self-collision over 2 mm (%), on the recording of GeoRT's
# authors (docs/results/universal-map.md and open-loop.md). The last column says what the method saw of it.
RESULTS = {
    "universal": (0.973, 97.2, 0.5, "first second"),
    "affine_ik": (0.956, 33.0, 5.1, "fitted to it"),
    "geort": (0.987, 97.4, 26.8, "trained on it"),
    "telekinesis": (0.787, 81.8, 28.9, "trained on it"),
    "anyteleop": (0.827, 81.4, 29.6, "scaled to it"),
    "dexpilot": (0.775, 100.0, 34.5, "scaled to it"),
}


def draw_results() -> Figure:
    """What six methods get right on one recording: directions, pinches, and freedom from collisions."""
    panels = (
        ("motion preservation  (more is better)", (0, 1.18), "{:.3f}"),
        ("pinches closed, %  (more is better)", (0, 118), "{:.0f}"),
        ("self-collision, %  (less is better)", (0, 42), "{:.1f}"),
    )
    figure, axes = plt.subplots(1, 3, figsize=(10.4, 2.6), sharey=True)
    names = [f"{name}\n({row[3]})" for name, row in RESULTS.items()]
    for column, (each, (title, limits, form)) in enumerate(zip(axes, panels, strict=True)):
        values = [float(row[column]) for row in RESULTS.values()]
        colours = [ROBOT if name == "universal" else PALE for name in RESULTS]
        bars = each.barh(names, [value - limits[0] for value in values], left=limits[0], color=colours)
        each.bar_label(bars, [form.format(value) for value in values], padding=3, fontsize=8, color=INK)
        each.set_xlim(*limits)
        each.set_title(title, fontsize=9.5, color=INK)
        each.spines[["top", "right", "bottom", "left"]].set_visible(False)
        each.tick_params(left=False, bottom=False, labelbottom=False, labelsize=8, labelcolor=INK)
    axes[0].invert_yaxis()
    figure.tight_layout()
    return figure


def draw_tasks() -> Figure:
    """Shares of trials in which people succeed through each method, by task, from docs/results/tasks.csv."""
    with open(
        Path(__file__).parents[1] / "docs" / "results" / "tasks.csv", encoding="utf-8", newline=""
    ) as file:
        rows = list(csv.DictReader(file))
    names = {
        "grasp": "grasp",
        "pick_place": "pick and place",
        "peg": "peg in hole",
        "keys": "press keys",
        "cap": "turn a cap",
    }
    methods = sorted(
        {row["method"] for row in rows},
        key=lambda method: -np.mean([row["success"] == "1" for row in rows if row["method"] == method]),
    )
    figure, axes = plt.subplots(1, len(names), figsize=(10.4, 2.4), sharey=True)
    for each, (task, title) in zip(axes, names.items(), strict=True):
        done, number = [], []
        for method in methods:
            trials = [row["success"] == "1" for row in rows if (row["task"], row["method"]) == (task, method)]
            done.append(sum(trials))
            number.append(len(trials))
        shares = np.array(done) / number
        colours = [ROBOT if method == "universal" else PALE for method in methods]
        bars = each.barh(methods, shares, color=colours)
        labels = [f"{a} of {b}" for a, b in zip(done, number, strict=True)]
        each.bar_label(bars, labels, padding=3, fontsize=8, color=INK)
        each.set_xlim(0, 1.45)
        each.set_title(title, fontsize=9.5, color=INK)
        each.spines[["top", "right", "bottom", "left"]].set_visible(False)
        each.tick_params(left=False, bottom=False, labelbottom=False, labelsize=8, labelcolor=INK)
    axes[0].invert_yaxis()
    figure.tight_layout()
    return figure


def arrow(axes: Axes, start: Sequence[float], end: Sequence[float], colour: str) -> None:
    """Draws an arrow between two points of the data's coordinates."""
    patch = FancyArrowPatch(
        tuple(start),
        tuple(end),
        color=colour,
        arrowstyle="-|>",
        mutation_scale=13,
        lw=1.8,
        zorder=4,
        shrinkA=0,
        shrinkB=0,
    )
    axes.add_patch(patch)


def finish(axes: Axes, title: str = "") -> None:
    """Removes the frame and the ticks, and writes the title."""
    axes.set_axis_off()
    if title:
        axes.set_title(title, fontsize=11, color=INK)


DRAWINGS = {
    "keypoints": draw_keypoints,
    "pipeline": draw_pipeline,
    "criteria": draw_criteria,
    "results": draw_results,
    "tasks": draw_tasks,
}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=Path("docs/images"), help="folder for the pictures")
    arguments = parser.parse_args(argv)
    matplotlib.use("Agg")
    # Text stays text, and the same program writes the same file.
    plt.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "drawings", "font.family": "sans-serif"}
    for name, draw in DRAWINGS.items():
        figure = draw()
        figure.savefig(
            arguments.output / f"{name}.svg", bbox_inches="tight", metadata={"Date": None}, facecolor="white"
        )
        plt.close(figure)


if __name__ == "__main__":
    main()

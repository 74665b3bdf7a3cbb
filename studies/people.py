"""Draws people of the population: each person's stretched hand and cloud of fingertips.

python studies/people.py --people 6 --seed 3 --output people.png
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geort_drake.colours import FINGER_COLOURS
from geort_drake.files import atomic_path
from geort_drake.people.keypoints import FINGER_KEYPOINTS, TIP_KEYPOINT, WRIST
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.population import sample_person

POINTS = 800  # number of points per fingertip cloud
GREY = "#7f7f7f"  # readable on white paper and on a dark page; the background is transparent
STYLE: Any = {
    **dict.fromkeys(("axes.labelcolor", "text.color"), GREY),
    **dict.fromkeys(("axes.facecolor", "figure.facecolor", "savefig.facecolor"), "none"),
    "font.size": 9,
}
PLANES = {"from the palm": (1, 2), "from the side": (0, 2)}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of play, s")
    parser.add_argument("--seed", type=int, default=3, help="seed of the population")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args(argv)
    people = [sample_person(arguments.seed, number) for number in range(arguments.people)]
    recordings = [person.record(arguments.seconds) for person in people]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.7 * len(people) + 0.4, 4.7), layout="constrained", dpi=110)
        grid = figure.subplots(2, len(people), sharex=True, sharey=True, squeeze=False)
        for row, (view, plane) in zip(grid, PLANES.items(), strict=True):
            row[0].set_ylabel(view)
            for axes, recording in zip(row, recordings, strict=True):
                draw_hand(axes, recording, plane)
        for axes, recording in zip(grid[0], recordings, strict=True):
            axes.set_title(f"{recording.rate_hz:.0f} Hz", fontsize="small")
        grid[0, 0].plot([-70, -20], [5, 5], color=GREY, lw=2)
        grid[0, 0].text(-45, 0, "50 mm", ha="center", va="top", fontsize="small")
        with atomic_path(arguments.output) as draft:
            figure.savefig(draft)


def draw_hand(axes: Any, recording: Recording, plane: tuple[int, int]) -> None:
    """Draws clouds of the fingertips, and the frame in which they are farthest from the wrist."""
    p_HK = 1e3 * recording.p_HK[recording.valid]
    stretched = p_HK[np.argmax(p_HK[:, list(TIP_KEYPOINT.values()), 2].sum(axis=1))]
    some = p_HK[np.linspace(0, len(p_HK) - 1, min(len(p_HK), POINTS)).astype(int)]
    for finger, keypoints in FINGER_KEYPOINTS.items():
        style: Any = {"color": FINGER_COLOURS[finger]}
        axes.plot(*some[:, keypoints[-1], plane].T, ".", ms=2.0, mew=0, alpha=0.5, **style)
        axes.plot(*stretched[[WRIST, *keypoints]][:, plane].T, "-o", lw=1.6, ms=3, zorder=3, **style)
    axes.plot(0.0, 0.0, "o", color=GREY, ms=5, zorder=4)
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


if __name__ == "__main__":
    main()

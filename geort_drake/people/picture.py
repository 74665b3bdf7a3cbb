"""Draws a person's fingertips over a robot's reachable space."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geort_drake.colours import FINGER_COLOURS
from geort_drake.files import atomic_path
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.recording import Recording

_POINTS = 4000
_GREY = "#7f7f7f"  # readable on white paper and on a dark page; the background is transparent
_GREY_PARTS = ("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color")
_STYLE: Any = {
    **dict.fromkeys(_GREY_PARTS, _GREY),
    **dict.fromkeys(("axes.facecolor", "figure.facecolor", "savefig.facecolor"), "none"),
    **dict.fromkeys(("axes.spines.right", "axes.spines.top"), False),
    "font.size": 9,
}
_PLANES = {
    "from the side": ((0, 2), "x, out of the palm, mm"),
    "from the palm": ((1, 2), "y, to the index side, mm"),
}


def draw_fingertips(
    recording: Recording, robot: Mapping[str, np.ndarray], robot_name: str, path: Path
) -> None:
    """Writes a PNG with one column per robot finger, seen from the side and from the palm.

    Args:
        recording: whose valid frames are drawn, in H.
        robot: finger → p_BF (N, 3), m, sampled fingertips in the hand base, which has H's directions.
        robot_name: of the hand, for the title.
        path: of the picture.
    """
    human = 1e3 * recording.fingertips([TIP_KEYPOINT[finger] for finger in robot])
    reach = 1e3 * np.stack(list(robot.values()), axis=1)
    # Wrist and hand base are at different places, so the clouds are centred on each other as a whole.
    reach += human.mean(axis=(0, 1)) - reach.mean(axis=(0, 1))
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(2.3 * len(robot) + 0.8, 6.2), layout="constrained", dpi=130)
        grid = figure.subplots(2, len(robot), sharey=True, sharex="row", squeeze=False)
        for row, (view, (plane, x_label)) in zip(grid, _PLANES.items(), strict=True):
            for column, (finger, axes) in enumerate(zip(robot, row, strict=True)):
                clouds = ((reach, _GREY, 0.3), (human, FINGER_COLOURS[finger], 0.6))
                for points, colour, alpha in clouds:
                    some = np.linspace(0, len(points) - 1, min(len(points), _POINTS)).astype(int)
                    x, y = points[some, column][:, plane].T
                    axes.plot(x, y, ".", ms=1.6, mew=0, alpha=alpha, color=colour, rasterized=True)
                axes.plot(0.0, 0.0, "+", color=_GREY, ms=9)
                axes.set_aspect("equal")
                axes.set_title(finger if plane[0] == 0 else "", color=FINGER_COLOURS[finger], weight="bold")
            row[0].set_xlabel(x_label)
            row[0].set_ylabel(f"{view}\nz, along the fingers, mm")
        source = recording.metadata.get("source", "recording")
        figure.suptitle(
            f"coloured: fingertips of {source}, measured from the wrist (+)\n"
            f"grey: reach of {robot_name}'s fingertips, the whole hand moved to the person's",
            fontsize="medium",
        )
        with atomic_path(path) as draft:
            figure.savefig(draft)

"""A picture of where a person's fingertips went, against where a robot's can go."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from geort_drake.colours import FINGER_COLOURS
from geort_drake.files import atomic_path
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.recording import Recording

_POINTS = 4000
# A grey that is read on white paper and on a dark page; there is no background of its own.
_GREY = "#7f7f7f"
_STYLE: Any = {
    "axes.edgecolor": _GREY,
    "axes.facecolor": "none",
    "axes.labelcolor": _GREY,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": _GREY,
    "figure.facecolor": "none",
    "font.size": 9,
    "savefig.facecolor": "none",
    "text.color": _GREY,
    "xtick.color": _GREY,
    "ytick.color": _GREY,
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
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(2.3 * len(robot) + 0.8, 6.2), layout="constrained", dpi=130)
        rows = figure.subplots(2, len(robot), sharey=True, sharex="row", squeeze=False)
        human = 1e3 * recording.fingertips([TIP_KEYPOINT[finger] for finger in robot])
        reach = 1e3 * np.stack(list(robot.values()), axis=1)
        # Wrist and hand base are not the same place, so the hands are laid upon each other as a whole.
        reach += human.mean(axis=(0, 1)) - reach.mean(axis=(0, 1))
        for column, finger in enumerate(robot):
            for row, plane in enumerate(((0, 2), (1, 2))):
                axes = rows[row, column]
                _cloud(axes, reach[:, column][:, plane], _GREY, 0.3)
                _cloud(axes, human[:, column][:, plane], FINGER_COLOURS[finger], 0.6)
                axes.set_aspect("equal")
                axes.plot(0.0, 0.0, "+", color=_GREY, ms=9)
            rows[0, column].set_title(finger, color=FINGER_COLOURS[finger], weight="bold")
            rows[0, column].set_xlabel("x, out of the palm, mm")
            rows[1, column].set_xlabel("y, to the index side, mm")
        for row, view in zip(rows, ("from the side", "from the palm"), strict=True):
            row[0].set_ylabel(f"{view}\nz, along the fingers, mm")
        source = recording.metadata.get("source", "recording")
        figure.suptitle(
            f"coloured: fingertips of {source}, measured from the wrist (+)\n"
            f"grey: what the fingertips of {robot_name} reach, the whole hand moved to the person's",
            fontsize="medium",
        )
        with atomic_path(path) as draft:
            figure.savefig(draft)


def _cloud(axes: Axes, points: np.ndarray, colour: str, alpha: float) -> None:
    some = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS)).astype(int)]
    axes.plot(*some.T, ".", ms=1.6, mew=0, alpha=alpha, color=colour, rasterized=True)

"""The fingertip spaces of person and robot, as in the paper's figure 2."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from geort_drake.colours import FINGER_COLOURS
from geort_drake.comparison.plot_style import WIDTH, legend_below
from geort_drake.retargeting.training.map_figures import ROBOT_VOXEL

# What is seen from where: (horizontal, vertical) coordinates in B and H.
VIEWS = {"from the side": (0, 2), "from the front": (1, 2)}


def fingertips(
    human: np.ndarray,
    robot: Mapping[str, np.ndarray],
    finger_names: Sequence[str],
    reachable: Sequence[np.ndarray] = (),
    columns: int = 4,
) -> Figure:
    """Where the person's fingertips were and where each method puts the robot's, in two views.

    Args:
        human: (T, F, 3) fingertips in H, m.
        robot: name of a method → (T, F, 3) fingertips in B, m.
        finger_names: F names.
        reachable: per finger, (M, 3) centres of the voxels of the robot's C-space in B, m.
        columns: clouds beside each other.
    """
    clouds = {"human": human, **robot}
    bands = -(-len(clouds) // columns)
    columns = min(columns, len(clouds))
    every = 1000 * np.concatenate([*(points.reshape(-1, 3) for points in clouds.values()), *reachable])
    low, high = every.min(axis=0) - 5, every.max(axis=0) + 5
    span = high - low
    ratios = [span[up] / span[across] for across, up in VIEWS.values()]
    cell = WIDTH / 4 - 0.3
    height = bands * sum(ratio * cell + 0.5 for ratio in ratios) + 0.5
    figure = Figure(figsize=(cell * columns + 1.2, height), layout="constrained")
    grid = figure.add_gridspec(2 * bands, columns, height_ratios=ratios * bands)
    for number, (name, points) in enumerate(clouds.items()):
        band, column = divmod(number, columns)
        for row, (view, (across, up)) in enumerate(VIEWS.items()):
            ax = figure.add_subplot(grid[2 * band + row, column])
            for finger, voxels in enumerate(reachable if name != "human" else ()):
                _shade(ax, voxels[:, [across, up]], FINGER_COLOURS[finger_names[finger]])
            for finger, finger_name in enumerate(finger_names):
                x, y = 1000 * points[:, finger, across], 1000 * points[:, finger, up]
                ax.scatter(x, y, s=1.5, linewidths=0, color=FINGER_COLOURS[finger_name], label=finger_name)
            ax.set(aspect="equal", xlim=(low[across], high[across]), ylim=(low[up], high[up]))
            ax.set_xlabel(f"{'xyz'[across]} / mm")
            if row == 0:
                ax.set_title(name)
            if column == 0:
                ax.set_ylabel(f"{view}\n{'xyz'[up]} / mm")
            else:
                ax.tick_params(labelleft=False)
    legend_below(figure, markerscale=6)
    return figure


def _shade(ax: Axes, centres: np.ndarray, colour: str) -> None:
    """Tints the squares of the C-space's voxels, centres (M, 2) in m."""
    squares = np.round(centres / ROBOT_VOXEL - 0.5).astype(int)
    corner = squares.min(axis=0)
    width, height = squares.max(axis=0) - corner + 1
    image = np.full((height, width), np.nan)
    image[tuple((squares - corner).T[::-1])] = 1.0
    left, bottom = 1000 * ROBOT_VOXEL * corner
    extent = (left, left + 1000 * ROBOT_VOXEL * width, bottom, bottom + 1000 * ROBOT_VOXEL * height)
    colours = ListedColormap([colour])
    ax.imshow(image, colours, extent=extent, origin="lower", interpolation="nearest", alpha=0.18)

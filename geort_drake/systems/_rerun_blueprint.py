"""How a recording of a grasp is laid out on a screen."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.systems._rerun_scene import WORLD
from geort_drake.systems._rerun_writer import TIMELINE

_BACKGROUND = (38, 41, 48)
# px in the viewer: title and ruler of a view of lanes, a lane, and what a window of 720 px leaves for views.
_RULER, _LANE, _WINDOW = 48, 40, 650


def grasp_blueprint(
    *,
    plots: Mapping[str, Sequence[str]] | None = None,
    states: Sequence[str] = (),
    contact: bool = True,
    cameras: Sequence[str] = (),
    eye: Sequence[float] | np.ndarray = (1.35, -1.05, 0.85),
    target: Sequence[float] | np.ndarray = (0.45, 0.0, 0.2),
    early: bool = False,
) -> rrb.Blueprint:
    """The scene on the left; states, contact forces, cameras and plots on the right; the time line below.

    Args:
        plots: title to entity paths of each plot of time series; two stand side by side.
        states: entity paths of the state lanes.
        contact: whether to plot contact forces.
        cameras: entity paths of the cameras; two stand side by side.
        eye, target: where the camera stands and what it looks at, m, in W.
        early: whether contact forces are strongest at first, so that their legend goes to the right.
    """
    view = scene_view(eye, target)
    right: list[rrb.Container | rrb.View] = []
    shares: list[float] = []
    if contact:
        corner = rrb.Corner2D.RightTop if early else rrb.Corner2D.LeftTop
        right.append(time_series("contact force [N]", ["/contact/**"], corner))
        shares.append(2.0)  # so high that a window of 900 px labels single newtons of a grasp
    if cameras:
        pictures = [rrb.Spatial2DView(origin=path, name=path.rsplit("/", 1)[-1]) for path in cameras]
        right.append(rrb.Grid(contents=pictures, grid_columns=min(2, len(pictures)), name="cameras"))
        shares.append(1.5 * ((len(pictures) + 1) // 2))
    # A legend would cover most of so small a plot; pointing at a line tells its name.
    cells = [time_series(title, paths) for title, paths in (plots or {}).items()]
    for first in range(0, len(cells), 2):
        right.append(rrb.Horizontal(*cells[first : first + 2]))
        shares.append(1.2)
    if states:
        right.insert(0, rrb.StateTimelineView(origin="/", contents=list(states), name="phase"))
        shares.insert(0, lanes_share(len(states), sum(shares)))
    layout: rrb.Container | rrb.View = view
    if right:
        layout = rrb.Horizontal(view, rrb.Vertical(contents=right, row_shares=shares), column_shares=[3, 2])
    return blueprint(layout)


def lanes_share(lanes: int, others: float) -> float:
    """The share of a column that shows all of so many state lanes, beside the shares of the others.

    It is at most half of the column.
    """
    height = _RULER + _LANE * lanes
    return others * height / max(_WINDOW - height, height) if others else 1.0


def blueprint(layout: rrb.Container | rrb.View, timeline: str = TIMELINE, rate: float = 1.0) -> rrb.Blueprint:
    """A layout that begins to play, over and over, with all room for itself.

    Args:
        rate: of playing: seconds per second, or steps per second.
    """
    steps = timeline != TIMELINE
    time_panel = rrb.TimePanel(
        state="collapsed",
        timeline=timeline,
        play_state="playing",
        loop_mode="all",
        fps=rate if steps else None,
        playback_speed=None if steps else rate,
    )
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel,
        auto_layout=False,
        auto_views=False,
    )


def scene_view(
    eye: Sequence[float] | np.ndarray,
    target: Sequence[float] | np.ndarray,
    name: str = "scene",
    contents: Sequence[str] = ("$origin/**",),
) -> rrb.Spatial3DView:
    """The world, or `contents` of it, with a grid on the ground; `eye` looks at `target`, m, in W."""
    return rrb.Spatial3DView(
        origin=f"/{WORLD}",
        contents=list(contents),
        name=name,
        background=_BACKGROUND,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)
        ),
        # A little below z = 0, where many a table has its top.
        line_grid=rrb.LineGrid3D(
            visible=True,
            spacing=0.1,
            stroke_width=0.5,
            color=(62, 67, 78, 255),
            plane=rr.components.Plane3D.XY.with_distance(-0.005),
        ),
    )


def time_series(
    title: str, paths: Sequence[str], legend: rrb.Corner2D | None = None, steps: int | None = None
) -> rrb.TimeSeriesView:
    """A plot whose time axis moves with those of the others, or shows so many steps."""
    axis = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    if steps is not None:
        first, last = rr.TimeRangeBoundary.absolute(seq=0), rr.TimeRangeBoundary.absolute(seq=steps)
        axis = rrb.TimeAxis(view_range=rr.TimeRange(first, last))
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(paths),
        name=title,
        axis_x=axis,
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None),
    )

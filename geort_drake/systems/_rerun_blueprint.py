"""How a recording of a grasp is laid out on a screen."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.systems._rerun_scene import WORLD
from geort_drake.systems._rerun_tracks import TIMELINE

_BACKGROUND = (38, 41, 48)


def grasp_blueprint(
    *,
    plots: Mapping[str, Sequence[str]] | None = None,
    states: Sequence[str] = (),
    contact: bool = True,
    eye: Sequence[float] | np.ndarray = (1.35, -1.05, 0.85),
    target: Sequence[float] | np.ndarray = (0.45, 0.0, 0.2),
) -> rrb.Blueprint:
    """The scene on the left; states, contact forces and plots on the right; the time line below.

    Args:
        plots: title to entity paths of each plot of time series; two stand side by side.
        states: entity paths of the state lanes.
        contact: whether to plot contact forces.
        eye, target: where the camera stands and what it looks at, m, in W.
    """
    view = rrb.Spatial3DView(
        origin=f"/{WORLD}",
        name="scene",
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
    right: list[rrb.Container | rrb.View] = []
    shares: list[float] = []
    if states:
        right.append(rrb.StateTimelineView(origin="/", contents=list(states), name="phase"))
        shares.append(0.4 + 0.2 * len(states))
    if contact:
        right.append(_time_series("contact force [N]", ["/contact/**"]))
        shares.append(1.2)
    # A legend would cover most of so small a plot; pointing at a line tells its name.
    cells = [_time_series(title, paths, legend=False) for title, paths in (plots or {}).items()]
    if cells:
        rows = (len(cells) + 1) // 2
        right.append(rrb.Grid(contents=cells, grid_columns=min(2, len(cells)), name="signals"))
        shares.append(1.2 * rows)
    layout: rrb.Container | rrb.View = view
    if right:
        layout = rrb.Horizontal(view, rrb.Vertical(contents=right, row_shares=shares), column_shares=[3, 2])
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing", loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _time_series(title: str, paths: Sequence[str], legend: bool = True) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(paths),
        name=title,
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )

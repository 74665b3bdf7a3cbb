"""Makes the views of layouts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.rerun.writer import TIMELINE, WORLD

# Black hands, white arms and skin stand out from this grey; the grid is slightly brighter.
_BACKGROUND, _GRID = (70, 76, 88), (92, 99, 112, 255)
# Heights in the viewer, px: title and ruler of a view of lanes; a lane; all views in a window of 720 px.
_RULER, _LANE, _WINDOW = 48, 40, 650
# For layouts in other packages, which do not import Rerun.
Horizontal, Vertical = rrb.Horizontal, rrb.Vertical
TextDocumentView, StateTimelineView = rrb.TextDocumentView, rrb.StateTimelineView
View = rrb.Container | rrb.View
Vector = Sequence[float] | np.ndarray


def blueprint(layout: View, timeline: str = TIMELINE, rate: float = 1.0) -> rrb.Blueprint:
    """Makes a layout that plays in a loop, with the viewer's panels collapsed.

    Args:
        rate: playback rate: recorded seconds, or steps, per second.
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
    eye: Vector,
    target: Vector,
    name: str = "scene",
    contents: Sequence[str] = ("$origin/**",),
    overrides: Mapping[Any, Any] | None = None,
    origin: str = f"/{WORLD}",
    up: Vector = (0.0, 0.0, 1.0),
) -> View:
    """Makes a view of the world with a grid on the ground, or of another entity in its own frame.

    Args:
        eye, target, up: eye point, target point and up direction in the frame of `origin`, m.
        contents: entities to show.
        overrides: entity path → components that the view replaces.
    """
    # The grid is slightly below z = 0, where tables often have their tops.
    plane = rr.components.Plane3D.XY.with_distance(-0.005)
    grid = rrb.LineGrid3D(visible=True, spacing=0.1, stroke_width=0.5, color=_GRID, plane=plane)
    controls = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=up)
    return rrb.Spatial3DView(
        origin=origin,
        contents=list(contents),
        name=name,
        background=_BACKGROUND,
        line_grid=grid if origin == f"/{WORLD}" else False,
        eye_controls=controls,
        overrides=overrides,
    )


def lanes_share(lanes: int, others: float) -> float:
    """Returns the share of a column that fits this many lanes, but at most half of the column.

    Args:
        others: sum of the shares of the other views in the column.
    """
    height = _RULER + _LANE * lanes
    return others * height / max(_WINDOW - height, height)


def time_series(
    title: str,
    paths: Sequence[str],
    legend: str = "",
    steps: int | None = None,
    limits: tuple[float, float] | None = None,
) -> View:
    """Makes a plot whose time axis is linked to those of the others, or shows `steps` steps.

    Args:
        legend: side of the legend, "left" or "right"; empty for none.
        limits: lowest and highest value; by default those of the data.
    """
    axis = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    if steps is not None:
        first, last = rr.TimeRangeBoundary.absolute(seq=0), rr.TimeRangeBoundary.absolute(seq=steps)
        axis = rrb.TimeAxis(view_range=rr.TimeRange(first, last))
    corner = rrb.Corner2D.RightTop if legend == "right" else rrb.Corner2D.LeftTop
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(paths),
        name=title,
        axis_x=axis,
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits, zoom_lock=True),
        plot_legend=rrb.PlotLegend(corner, visible=bool(legend)),
    )

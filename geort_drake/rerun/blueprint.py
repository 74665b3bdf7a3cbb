"""How a recording of a grasp is laid out on a screen."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.rerun.scene import WORLD
from geort_drake.rerun.writer import TIMELINE

# A grey on which black hands, white arms and skin stand out, and lines on it that do not.
_BACKGROUND, _GRID = (70, 76, 88), (92, 99, 112, 255)
# px in the viewer: title and ruler of a view of lanes, a lane, and what a window of 720 px leaves for views.
_RULER, _LANE, _WINDOW = 48, 40, 650


@dataclass(frozen=True)
class Plot:
    """A plot of time series.

    Attributes:
        paths: entity paths of the series.
        page: the tab that it stands on.
        legend: whether it has one, which covers most of a small plot; pointing at a line tells its name, too.
        limits: lowest and highest value shown; by default those of the data.
    """

    paths: Sequence[str]
    page: str = ""
    legend: bool = False
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class CloseUp:
    """One more view of the scene, in the frame of an entity.

    Attributes:
        name: its title.
        origin: path of the entity.
        contents: what of the world is shown.
        eye, target, up: where the eye stands, what it looks at, and what is up, m, in the entity's frame.
        overrides: entity path to how this view shows it differently.
    """

    name: str
    origin: str
    contents: str
    eye: np.ndarray
    target: np.ndarray
    up: np.ndarray
    overrides: Mapping[str, Any] = field(default_factory=dict)


def grasp_blueprint(
    *,
    plots: Mapping[str, Plot | Sequence[str]] | None = None,
    states: Sequence[str] = (),
    contact: bool = True,
    cameras: Sequence[str] = (),
    eye: Sequence[float] | np.ndarray = (1.35, -1.05, 0.85),
    target: Sequence[float] | np.ndarray = (0.45, 0.0, 0.2),
    early: bool = False,
    close_ups: Sequence[CloseUp] = (),
    trails: Mapping[str, float] | None = None,
) -> rrb.Blueprint:
    """The scene on the left; states, contact forces, cameras and plots on the right; the time line below.

    With close-ups, these are on the scene's right; the states are below them, and the rest is at the bottom.

    Args:
        plots: title to each plot of time series, or to the entity paths of its series.
        states: entity paths of the state lanes.
        contact: whether to plot contact forces.
        cameras: entity paths of the cameras.
        eye, target: where the camera stands and what it looks at, m, in W.
        early: whether contact forces are strongest at first, so that their legend goes to the right.
        close_ups: more views.
        trails: entity path to how much of the past is shown with the present, s.
    """
    view = scene_view(eye, target, overrides=_trails(trails or {}))
    corner = rrb.Corner2D.RightTop if early else rrb.Corner2D.LeftTop
    forces = [time_series("contact force [N]", ["/contact/**"], corner)] if contact else []
    pictures = [rrb.Spatial2DView(origin=path, name=path.rsplit("/", 1)[-1]) for path in cameras]
    pages: dict[str, list[rrb.View]] = {}
    for title, plot in (plots or {}).items():
        shown = plot if isinstance(plot, Plot) else Plot(plot)
        legend = rrb.Corner2D.RightTop if shown.legend else None
        pages.setdefault(shown.page, []).append(time_series(title, shown.paths, legend, limits=shown.limits))
    rows: list[rrb.Container | rrb.View] = []
    shares: list[float] = []
    if close_ups:
        if forces or pictures:
            first = next(iter(pages), "")
            pages[first] = [*forces, *pages.get(first, []), *pictures]
        if pages:
            rows.append(_tabs([rrb.Horizontal(*views, name=page) for page, views in pages.items()]))
            shares.append(2.0)
    else:
        rows += forces
        shares += [2.0] * len(forces)  # so high that a window of 900 px labels single newtons of a grasp
        if pictures:
            rows.append(rrb.Grid(contents=pictures, grid_columns=min(2, len(pictures)), name="cameras"))
            shares.append(1.5 * math.ceil(len(pictures) / 2))
        if pages:
            rows.append(_tabs([_in_pairs(views, page) for page, views in pages.items()]))
            shares.append(1.2 * max(math.ceil(len(views) / 2) for views in pages.values()))
    if states:
        rows.insert(0, rrb.StateTimelineView(origin="/", contents=list(states), name="phase"))
        others = sum(shares) if not close_ups else _TOP + sum(shares)
        shares.insert(0, lanes_share(len(states), others))
    if close_ups:
        top = rrb.Horizontal(view, *(_close_view(close_up, trails or {}) for close_up in close_ups))
        return blueprint(rrb.Vertical(top, *rows, row_shares=[_TOP, *shares]))
    if not rows:
        return blueprint(view)
    right = rrb.Vertical(contents=rows, row_shares=shares)
    return blueprint(rrb.Horizontal(view, right, column_shares=[3, 2]))


_TOP = 3.0  # share of the two views of the scene


def _tabs(pages: Sequence[rrb.Container]) -> rrb.Container:
    return pages[0] if len(pages) == 1 else rrb.Tabs(contents=pages, active_tab=0)


def _in_pairs(views: Sequence[rrb.View], name: str) -> rrb.Container:
    pairs = [rrb.Horizontal(*views[first : first + 2]) for first in range(0, len(views), 2)]
    return rrb.Vertical(contents=pairs, name=name)


def _close_view(close_up: CloseUp, trails: Mapping[str, float]) -> rrb.Spatial3DView:
    overrides: dict[Any, Any] = {**close_up.overrides, **_trails(trails)}
    return rrb.Spatial3DView(
        origin=close_up.origin,
        contents=close_up.contents,
        name=close_up.name,
        background=_BACKGROUND,
        line_grid=False,
        eye_controls=_eye(close_up.eye, close_up.target, close_up.up),
        overrides=overrides,
    )


def _trails(trails: Mapping[str, float]) -> dict[str, Any]:
    ranges = {}
    for path, seconds in trails.items():
        present = rrb.TimeRangeBoundary.cursor_relative(seconds=0.0)
        past = rrb.TimeRangeBoundary.infinite()
        if math.isfinite(seconds):
            past = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds)
        ranges[path] = rrb.VisibleTimeRanges(rrb.VisibleTimeRange(TIMELINE, start=past, end=present))
    return ranges


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
    overrides: Mapping | None = None,
) -> rrb.Spatial3DView:
    """The world, or `contents` of it, with a grid on the ground; `eye` looks at `target`, m, in W."""
    return rrb.Spatial3DView(
        origin=f"/{WORLD}",
        contents=list(contents),
        name=name,
        background=_BACKGROUND,
        eye_controls=_eye(eye, target, (0.0, 0.0, 1.0)),
        # A little below z = 0, where many a table has its top.
        line_grid=rrb.LineGrid3D(
            visible=True,
            spacing=0.1,
            stroke_width=0.5,
            color=_GRID,
            plane=rr.components.Plane3D.XY.with_distance(-0.005),
        ),
        overrides=overrides,
    )


def _eye(
    eye: Sequence[float] | np.ndarray,
    target: Sequence[float] | np.ndarray,
    up: Sequence[float] | np.ndarray,
) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=up)


def time_series(
    title: str,
    paths: Sequence[str],
    legend: rrb.Corner2D | None = None,
    steps: int | None = None,
    limits: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    """A plot whose time axis moves with those of the others, or shows so many steps.

    Args:
        limits: lowest and highest value; by default those of the data.
    """
    axis = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    if steps is not None:
        first, last = rr.TimeRangeBoundary.absolute(seq=0), rr.TimeRangeBoundary.absolute(seq=steps)
        axis = rrb.TimeAxis(view_range=rr.TimeRange(first, last))
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(paths),
        name=title,
        axis_x=axis,
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits, zoom_lock=True),
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None),
    )

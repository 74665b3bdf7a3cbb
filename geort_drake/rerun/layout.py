"""The views of layouts, and the default layout of a recording."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.errors import ScenarioError
from geort_drake.people.keypoints import FINGER_NAMES, wrist_pose
from geort_drake.rerun.scene import PlantSpec
from geort_drake.rerun.specs import (
    CloseUpSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    Spec,
    StateSpec,
    body_and_pose,
)
from geort_drake.rerun.writer import ABOUT, HAND_FRAME, TIMELINE, WORLD, entity_path

VIEW_FROM = (0.62, -0.62, 0.48)  # from the scene to the eye: front left, above
_VIEWS, _PLOTS = 3.0, 2.0  # relative heights
# Black hands, white arms and skin stand out from this grey; the grid is slightly brighter.
_BACKGROUND, _GRID = (70, 76, 88), (92, 99, 112, 255)
# Heights in the viewer, px: title and ruler of a view of lanes; a lane; all views in a window of 720 px.
_RULER, _LANE, _WINDOW = 48, 40, 650
# For layouts in other packages, which do not import Rerun.
Horizontal, Vertical = rrb.Horizontal, rrb.Vertical
TextDocumentView, StateTimelineView = rrb.TextDocumentView, rrb.StateTimelineView
View = rrb.Container | rrb.View
Vector = Sequence[float] | np.ndarray


def blueprint(layout: View) -> rrb.Blueprint:
    """Makes a layout that plays in a loop in real time, with the viewer's panels collapsed."""
    return rrb.Blueprint(
        layout,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="playing", loop_mode="all", playback_speed=1.0
        ),
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
    title: str, paths: Sequence[str], legend: bool = False, limits: tuple[float, float] | None = None
) -> View:
    """Makes a plot whose time axis is linked to those of the others.

    Args:
        legend: whether a legend is shown.
        limits: lowest and highest value; by default those of the data.
    """
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(paths),
        name=title,
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits, zoom_lock=True),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )


def _visible_past(seconds: float) -> rrb.VisibleTimeRanges:
    past = rrb.TimeRangeBoundary.infinite()
    if math.isfinite(seconds):
        past = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds)
    present = rrb.TimeRangeBoundary.cursor_relative(seconds=0.0)
    return rrb.VisibleTimeRanges(rrb.VisibleTimeRange(TIMELINE, start=past, end=present))


def default_layout(
    close_ups: Mapping[str, CloseUpSpec],
    view_from: np.ndarray,
    has_text: bool,
    specs: Mapping[str, Spec],
    rows: Mapping[str, Sequence],
) -> rrb.Blueprint:
    """Makes the default layout: views in a row, states below them, plots at the bottom.

    Args:
        close_ups: name → spec of each additional view.
        view_from: direction in W from the scene to the eye.
        has_text: whether a panel shows the recorder's text.
        specs: what is recorded, with one `PlantSpec`.
        rows: key of each spec → the rows that have been sampled.
    """

    def specs_of(kind: type[Spec]) -> dict[str, Any]:
        return {key: spec for key, spec in specs.items() if isinstance(spec, kind)}

    hands = {key: rows[key] for key in specs_of(HandSpec)}
    ((key, scene),) = specs_of(PlantSpec).items()
    poses = rows[key]
    points = {entity_path(WORLD, key): spec for key, spec in specs_of(PointsSpec).items()}
    trails = {path: _visible_past(spec.trail) for path, spec in points.items() if spec.trail}
    target, distance = _target_and_distance(poses, hands, scene.reach)
    eye = target + distance * view_from / np.linalg.norm(view_from)
    top = [scene_view(eye, target, overrides=trails)]
    top += [_close_up(scene, name, spec, poses, hands, trails) for name, spec in close_ups.items()]
    pages = _plots(specs_of(SignalSpec))
    forces = time_series("contact force [N]", ["/contact/**"], legend=True)
    pages.setdefault(next(iter(pages), ""), []).insert(0, forces)
    if has_text:
        top.append(rrb.TextDocumentView(origin=ABOUT, name="what you see"))
    bands: list[View] = [rrb.Horizontal(*top)]
    shares = [_VIEWS]
    if states := [entity_path(key) for key in specs_of(StateSpec)]:
        bands.append(rrb.StateTimelineView(origin="/", contents=states, name="phase"))
        shares.append(lanes_share(len(states), _VIEWS + _PLOTS))
    tabs = [rrb.Horizontal(*plots, name=page) for page, plots in pages.items()]
    bands.append(tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs, active_tab=0))
    return blueprint(rrb.Vertical(*bands, row_shares=[*shares, _PLOTS]))


def _close_up(
    scene: PlantSpec,
    name: str,
    spec: CloseUpSpec,
    poses: Sequence[np.ndarray],
    hands: Mapping[str, Sequence[np.ndarray]],
    trails: Mapping[str, rrb.VisibleTimeRanges],
) -> View:
    # The view turns with the frame that it follows, so it is upright only at the end.
    eye, target, R_WF = np.asarray(spec.eye, float), np.asarray(spec.target, float), np.eye(3)
    if isinstance(spec.follows, str):
        path = entity_path(WORLD, spec.follows)
        origin, contents = f"{path}/{HAND_FRAME}", f"{path}/**"
        tracked_rows = (row for row in reversed(hands[spec.follows]) if np.isfinite(row).all())
        if (row := next(tracked_rows, None)) is not None:
            R_WF = wrist_pose(row)[0]
    else:
        body, X_BF = body_and_pose(spec.follows)
        origin, contents = scene.paths[body], f"/{WORLD}/**"
        eye, target = X_BF @ eye, X_BF @ target
        if body in scene.anchored:
            R_WF = scene.anchored[body].rotation().matrix()
        elif poses:
            R_WF = poses[-1][scene.moving.index(body), :, :3]
        from_target_W = R_WF @ (eye - target)
        if from_target_W[2] < 0:  # a table would hide what is seen from below
            eye = target + R_WF.T @ (from_target_W * [1, 1, -1])
    overrides: dict[str, Any] = dict(trails)
    for body in spec.see_through:
        overrides |= scene.translucent_shapes(int(body.index()))
    return scene_view(eye, target, name, [contents], overrides, origin, R_WF[2])


def _target_and_distance(
    poses: Sequence[np.ndarray], hands: Mapping[str, Sequence[np.ndarray]], reach: float
) -> tuple[np.ndarray, float]:
    """Returns the target in W and the eye's distance from it, m, to see the moving bodies and the hands.

    The outermost two percent of positions are ignored, so that a thrown object does not shrink the rest.
    """
    points = [X_WB[..., 3] for X_WB in poses] + [p_WK for rows in hands.values() for p_WK in rows]
    cloud = np.concatenate([np.empty((0, 3)), *points])
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    low, high = np.percentile(cloud, [2, 98], axis=0) if len(cloud) else np.zeros((2, 3))
    # The second bound shows a single large body whole.
    return (low + high) / 2, max(0.17 + 0.78 * float(np.linalg.norm(high - low)), 2.2 * reach)


def followed_bodies(close_ups: Mapping[str, CloseUpSpec], specs: Mapping[str, Spec]) -> list[int]:
    """Returns the indices of the bodies that close-ups follow.

    Raises:
        ScenarioError: a close-up follows a hand that is not recorded.
    """
    bodies = []
    hands = [key for key, spec in specs.items() if isinstance(spec, HandSpec)]
    for name, spec in close_ups.items():
        if not isinstance(spec.follows, str):
            bodies.append(body_and_pose(spec.follows)[0])
        elif spec.follows not in hands:
            raise ScenarioError(
                f"close-up '{name}' follows the hand '{spec.follows}'; the recorded hands are: "
                f"{', '.join(hands) or 'none'}"
            )
    return bodies


def _plots(signals: Mapping[str, SignalSpec]) -> dict[str, list[View]]:
    """Makes the plots of each page, with fingers in their usual order regardless of the order of joints."""
    # Signals with the same title, such as commanded and measured, share a plot.
    paths: dict[tuple[str, str], list[str]] = {}
    limits: dict[str, tuple[float, float] | None] = {}
    for key, spec in signals.items():
        for path, (title, _) in spec.plots(key).items():
            paths.setdefault((spec.page, title), []).append(path)
            limits.setdefault(title, spec.limits)
    order = {name: number for number, name in enumerate(FINGER_NAMES)}
    pages: dict[str, list[View]] = {page: [] for page, _ in paths}
    for page, title in sorted(paths, key=lambda plot: order.get(plot[1].partition(" ")[0], len(order))):
        pages[page].append(time_series(title, paths[page, title], limits=limits[title]))
    return pages

"""Arrays over time as Rerun entities: poses, time series, states, points, lines and human hands.

Every function sends one row for each of the writer's times, to be called once for a file or once per batch.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from pydrake.math import RigidTransform

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.people.keypoints import (
    BONES,
    INDEX_MCP,
    LITTLE_MCP,
    MIDDLE_MCP,
    RING_MCP,
    THUMB_CMC,
    TIP_KEYPOINT,
    WRIST,
    wrist_pose,
)
from geort_drake.rerun.writer import Writer

WORLD = "world"
HAND_FRAME = "wrist"  # entity below a human hand that holds the pose of its wrist frame
SOLID, CAGE = rr.components.FillMode.Solid, rr.components.FillMode.MajorWireframe
# Matplotlib's "tab10", which colour-blind readers can tell apart, too.
PALETTE: tuple[Color, ...] = (
    (31, 119, 180),
    (255, 127, 14),
    (44, 160, 44),
    (214, 39, 40),
    (148, 103, 189),
    (140, 86, 75),
    (227, 119, 194),
    (127, 127, 127),
    (188, 189, 34),
    (23, 190, 207),
)
# One colour for all items; one for each item of a row; or (k, 3 or 4) for the k items of each row.
Colors = Color | Sequence[Color] | Sequence[np.ndarray]

# Radii of an average hand's bones, base to tip, m. Metacarpals are thin because the palm covers them.
_BONE_RADII = np.tile([0.007, 0.0085, 0.0075, 0.0065], 5)
_PALM = np.array([WRIST, THUMB_CMC, INDEX_MCP, MIDDLE_MCP, RING_MCP, LITTLE_MCP])
_PALM_TRIANGLES = ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5))


def entity_path(*keys: str) -> str:
    """An entity path of keys that may themselves hold slashes; special characters are escaped."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for key in keys for part in key.split("/") if part)


def write_text(writer: Writer, path: str, markdown: str) -> None:
    """Sends a text that holds at all times."""
    writer.static(path, rr.TextDocument(markdown, media_type="text/markdown"))


def write_up_axis(writer: Writer) -> None:
    """Tells the viewer that z is up in the world."""
    writer.static(f"/{WORLD}", rr.ViewCoordinates.RIGHT_HAND_Z_UP)


def transform(X: RigidTransform) -> rr.Transform3D:
    """A pose that holds at all times."""
    return rr.Transform3D(translation=X.translation(), quaternion=rr.Quaternion(xyzw=xyzw(X)))


def xyzw(X: RigidTransform) -> np.ndarray:
    """The rotation as a quaternion in Rerun's order."""
    return np.roll(X.rotation().ToQuaternion().wxyz(), -1)


def write_poses(writer: Writer, paths: Sequence[str], X: np.ndarray) -> None:
    """Sends poses X (T, B, 3, 4) of B entities in their parents' frames; poses with a NaN are left out."""
    finite = np.isfinite(X).all(axis=(2, 3))
    X = np.where(finite[..., None, None], X, np.eye(3, 4))
    translations = X[..., 3].astype(np.float32)
    rotations = quaternions(X[..., :3]).astype(np.float32)
    for k, path in enumerate(paths):
        rows = None if finite[:, k].all() else finite[:, k]
        chosen = slice(None) if rows is None else rows
        columns = rr.Transform3D.columns(translation=translations[chosen, k], quaternion=rotations[chosen, k])
        writer.columns(path, columns, rows)


def quaternions(R: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), xyzw, of valid rotation matrices (..., 3, 3).

    `scipy.spatial.transform.Rotation` takes several times as long, mostly to check the matrices.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(R, (-2, -1), (0, 1))
    # Every row is the quaternion times four times one of its elements; the largest one is exact.
    rows = np.array(
        [
            [1 + xx - yy - zz, xy + yx, zx + xz, zy - yz],
            [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
            [zx + xz, yz + zy, 1 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
        ]
    )
    largest = np.argmax(np.einsum("ii...->i...", rows), axis=0)
    q = np.take_along_axis(rows, largest[None, None], axis=0)[0]
    return np.moveaxis(q / np.linalg.norm(q, axis=0), 0, -1)


def write_series(
    writer: Writer,
    path: str,
    names: Sequence[str],
    values: np.ndarray,
    colors: Sequence[Color] | np.ndarray = PALETTE,
    width: float = 1.75,
) -> None:
    """Sends values (T, n) as n time series of one entity."""
    n = len(names)
    shades = [colors[i % len(colors)] for i in range(n)]
    writer.static(path, rr.SeriesLines(names=list(names), colors=shades, widths=[width] * n))
    writer.columns(path, rr.Scalars.columns(scalars=np.ravel(values)).partition([n] * len(values)))


def write_states(
    writer: Writer,
    path: str,
    codes: Sequence[float],
    labels: Mapping[int, str],
    colors: Sequence[Color] = PALETTE,
) -> None:
    """Sends codes (T,) as a lane of named states, where they change."""
    names = list(labels.values())
    shades = [colors[i % len(colors)] for i in range(len(names))]
    writer.static(path, rr.StateConfiguration(values=names, labels=names, colors=shades))
    states = [labels.get(int(c), f"code {c:g}") if np.isfinite(c) else "nan" for c in codes]
    before = [writer.memory.get(path), *states]
    changes = np.array([i for i, state in enumerate(states) if state != before[i]], dtype=int)
    writer.columns(path, rr.StateChange.columns(state=[states[i] for i in changes]), changes)
    writer.memory[path] = before[-1]


def write_points(
    writer: Writer,
    path: str,
    rows: list[np.ndarray] | np.ndarray,
    radius: float,
    colors: Colors,
    fill: rr.components.FillMode | None = None,
) -> None:
    """Sends points, m.

    Args:
        rows: a list of (k, 3), where k may change from time to time; or an array (k, 3) of fixed points.
        fill: SOLID or CAGE for balls, which can be translucent; by default dots, which are opaque.
    """
    if fill is None:
        _write_items(writer, path, rr.Points3D, "positions", rows, colors, {"radii": [radius]})
    else:
        style = {"fill_mode": fill, "line_radii": [0.0007]}
        _write_items(writer, path, rr.Ellipsoids3D, "centers", rows, colors, style, half_size=radius)


def write_lines(
    writer: Writer, path: str, rows: list[np.ndarray] | np.ndarray, radius: float, colors: Colors
) -> None:
    """Sends line segments, m: a list of (k, 2, 3), or an array (k, 2, 3) of fixed segments."""
    _write_items(writer, path, rr.LineStrips3D, "strips", rows, colors, {"radii": [radius]})


def _write_items(
    writer: Writer,
    path: str,
    archetype: Any,
    name: str,
    rows: list[np.ndarray] | np.ndarray,
    colors: Any,
    style: Mapping[str, Any],
    half_size: float | None = None,
) -> None:
    """Sends items whose places, component `name`, and colours are fixed or change from time to time."""
    fixed, varying = dict(style), {}
    places, items = (fixed, rows) if isinstance(rows, np.ndarray) else (varying, _stack(rows))
    places[name] = items
    if half_size is not None:
        places["half_sizes"] = np.full_like(items, half_size)
    counts = [len(rows)] * len(writer.times) if isinstance(rows, np.ndarray) else [len(row) for row in rows]
    if len(colors) and np.ndim(colors[0]) == 0:
        fixed["colors"] = [colors]
    else:
        shades = list(colors) if not len(colors) or np.ndim(colors[0]) == 2 else [colors] * len(counts)
        varying["colors"] = _stack(shades).astype(np.uint8)
    writer.static(path, archetype.from_fields(**fixed))
    if varying:
        writer.columns(path, archetype.columns(**varying).partition(counts))


def _stack(rows: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate(rows) if len(rows) else np.empty((0, 3))


def write_label(writer: Writer, path: str, text: str, color: Color, position: Sequence[float]) -> None:
    """Sends a text at a position, m, that holds at all times."""
    writer.static(path, rr.Points3D([position], labels=[text], show_labels=True, radii=[0.0], colors=[color]))


def write_human_hand(writer: Writer, path: str, p_WK: np.ndarray, color: Color) -> None:
    """Sends a human hand of keypoints p_WK (T, 21, 3), m; hands with a NaN are not drawn.

    Bones are capsules, joints spheres, fingertips spheres in the colours of the fingers.
    """
    bones, points, palm = (f"{path}/{name}" for name in ("bones", "keypoints", "palm"))
    skin = np.array(color)
    writer.static(bones, rr.Capsules3D.from_fields(radii=_BONE_RADII, colors=[skin], fill_mode=SOLID))
    # Joints stand out from the skin a little, and are darker.
    radii = np.r_[0.011, 1.08 * _BONE_RADII.reshape(5, 4)[:, [1, 2, 3, 3]].ravel()]
    colors = np.tile((0.72 * skin).astype(np.uint8), (21, 1))
    for finger, tip in TIP_KEYPOINT.items():
        colors[tip], radii[tip] = rgb(FINGER_COLOURS[finger]), 1.3 * radii[tip]
    writer.static(points, rr.Points3D.from_fields(radii=radii, colors=colors))
    # Rerun does not shade a mesh without normals; this is the colour of shaded skin.
    shaded = [*(0.8 * skin).astype(int).tolist(), 255]
    writer.static(palm, rr.Mesh3D.from_fields(triangle_indices=_PALM_TRIANGLES, albedo_factor=shaded))

    p_WK = np.reshape(p_WK, (-1, 21, 3))
    R_WH, p_WH = wrist_pose(p_WK)
    write_poses(writer, [f"{path}/{HAND_FRAME}"], np.concatenate([R_WH, p_WH[..., None]], axis=2)[:, None])
    drawn = np.isfinite(p_WK).all(axis=(1, 2))
    p_WK = p_WK[drawn]
    # An empty entry takes a lost hand off the screen.
    count = drawn.astype(int)
    parents, children = np.array(BONES).T
    along = p_WK[:, children] - p_WK[:, parents]
    capsules = rr.Capsules3D.columns(
        lengths=np.linalg.norm(along, axis=2).ravel(),
        translations=p_WK[:, parents].reshape(-1, 3),
        quaternions=_turn_z_to(along.reshape(-1, 3)),
    )
    writer.columns(bones, capsules.partition(20 * count))
    writer.columns(points, rr.Points3D.columns(positions=p_WK.reshape(-1, 3)).partition(21 * count))
    corners = rr.Mesh3D.columns(vertex_positions=p_WK[:, _PALM].reshape(-1, 3))
    writer.columns(palm, corners.partition(len(_PALM) * count))


def _turn_z_to(directions: np.ndarray) -> np.ndarray:
    """Shortest rotations (n, 4), xyzw, that turn the z axis to the directions (n, 3)."""
    length = np.maximum(np.linalg.norm(directions, axis=1), 1e-12)
    x, y, z = (directions / length[:, None]).T
    turns = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=1)
    turns[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # straight down: half a turn about x
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)

"""`Writer` sends arrays over time as Rerun entities: poses, time series, points, human hands and others.

`file_writer` opens one to a file, which is written atomically, and `live_writer` one to viewers.
"""

import contextlib
import os
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from pydrake.math import RigidTransform
from rerun import Points3D
from scipy.spatial.transform import Rotation

from geort_drake.colours import FINGER_COLOURS, SKIN, Color, rgb
from geort_drake.files import atomic_path
from geort_drake.people.keypoints import BONES, TIP_KEYPOINT, wrist_pose

_APPLICATION = "geort_drake"  # recordings of one application share a layout in the viewer
Property = str | int | float | bool
# A listening viewer, or a server to which viewers connect.
Viewer = rr.GrpcSink | rr.GrpcServerSink

TIMELINE = "sim_time"  # s
FLUSH_TIMEOUT = 5.0  # s; a viewer that was closed must not block the simulation
WORLD = "world"
ABOUT = "/about"  # entity of a text that explains the recording
HAND_FRAME = "wrist"  # entity below a human hand with the pose of its wrist frame
SOLID, CAGE = rr.components.FillMode.Solid, rr.components.FillMode.MajorWireframe
# Matplotlib's "tab10", which colour-blind readers can tell apart as well.
PALETTE: tuple[Color, ...] = tuple(
    rgb(f"#{color}")
    for color in "1f77b4 ff7f0e 2ca02c d62728 9467bd 8c564b e377c2 7f7f7f bcbd22 17becf".split()
)
# One colour for all items, or for each row an array (k, 3 or 4) for its k items.
Colors = Color | Sequence[np.ndarray]

# For drawings in other packages, which do not import Rerun.
LineStrips3D = rr.LineStrips3D

_BONE_RADII = np.tile([0.007, 0.0085, 0.0075, 0.0065], 5)  # of an average hand, base to tip, m


def entity_path(*keys: str) -> str:
    """Joins keys, which may contain slashes, to an entity path; escapes special characters."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for key in keys for part in key.split("/") if part)


class Writer:
    """Sends arrays to a recording in one or several batches, with one row for each of `times`.

    Malformed data raise an error instead of being dropped.

    Attributes:
        times: (T,) times of the rows that are sent next, s.
        memory: state that is kept between batches.
    """

    def __init__(self, stream: rr.RecordingStream):
        self.memory: dict[str, Any] = {}
        self._stream = stream
        self._sent: set[tuple[str, type]] = set()
        self.at(np.empty(0))
        self.static(f"/{WORLD}", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    def at(self, times: np.ndarray) -> None:
        """Sets the times (T,), s, of the rows that follow."""
        self.times = np.asarray(times, dtype=float)
        self._all_times = rr.TimeColumn(TIMELINE, duration=self.times)

    def static(self, path: str, archetype: rr.AsComponents) -> None:
        """Sends data without a time; ignores further data of the same kind for the path."""
        if (path, type(archetype)) not in self._sent:
            self._sent.add((path, type(archetype)))
            self._stream.log(path, archetype, static=True, strict=True)

    def columns(self, path: str, columns: rr.ComponentColumnList, rows: np.ndarray | None = None) -> None:
        """Sends one entry per time, or per time that `rows`, a mask or indices, selects."""
        index = self._all_times if rows is None else rr.TimeColumn(TIMELINE, duration=self.times[rows])
        if len(index.as_arrow_array()):
            self._stream.send_columns(path, [index], columns, strict=True)

    def text(self, path: str, markdown: str) -> None:
        """Sends a text without a time."""
        self.static(path, rr.TextDocument(markdown, media_type="text/markdown"))

    def poses(self, paths: Sequence[str], X: np.ndarray) -> None:
        """Sends poses X (T, B, 3, 4) of B entities in their parents' frames, m, except those with a NaN."""
        finite = np.isfinite(X).all(axis=(2, 3))
        X = np.where(finite[..., None, None], X, np.eye(3, 4))
        translations = X[..., 3].astype(np.float32)
        R = Rotation.from_matrix(X[..., :3].reshape(-1, 3, 3))
        rotations = R.as_quat().reshape(*X.shape[:2], 4).astype(np.float32)
        for k, path in enumerate(paths):
            rows = None if finite[:, k].all() else finite[:, k]
            selection = slice(None) if rows is None else rows
            columns = rr.Transform3D.columns(
                translation=translations[selection, k], quaternion=rotations[selection, k]
            )
            self.columns(path, columns, rows)

    def series(
        self,
        path: str,
        names: Sequence[str],
        values: np.ndarray,
        colors: Sequence[Color] | np.ndarray = PALETTE,
        width: float = 1.75,
    ) -> None:
        """Sends values (T, n) as n time series of one entity."""
        n = len(names)
        shades = [colors[i % len(colors)] for i in range(n)]
        self.static(path, rr.SeriesLines(names=list(names), colors=shades, widths=[width] * n))
        self.columns(path, rr.Scalars.columns(scalars=np.ravel(values)).partition([n] * len(values)))

    def states(
        self,
        path: str,
        codes: Sequence[float] | np.ndarray,
        labels: Sequence[str],
        colors: Sequence[Color] = PALETTE,
    ) -> None:
        """Sends the changes of codes (T,) as a lane of states, named by `labels`."""
        names = list(labels)
        shades = [colors[i % len(colors)] for i in range(len(names))]
        self.static(path, rr.StateConfiguration(values=names, labels=names, colors=shades))
        states = state_names(codes, names)
        previous = [self.memory.get(path), *states]
        changes = np.array([i for i, state in enumerate(states) if state != previous[i]], dtype=int)
        self.columns(path, rr.StateChange.columns(state=[states[i] for i in changes]), changes)
        self.memory[path] = previous[-1]

    def points(
        self,
        path: str,
        rows: Sequence[np.ndarray],
        radius: float,
        colors: Colors,
        fill: rr.components.FillMode | None = None,
    ) -> None:
        """Sends rows of points (k, 3), m, where k may vary between rows.

        Args:
            fill: SOLID or CAGE for spheres, which can be translucent; by default opaque dots.
        """
        if fill is None:
            self._items(path, Points3D, {"positions": _stack(rows)}, {"radii": [radius]}, rows, colors)
        else:
            centers = _stack(rows)
            spheres = {"centers": centers, "half_sizes": np.full_like(centers, radius)}
            style = {"fill_mode": fill, "line_radii": [0.0007]}
            self._items(path, rr.Ellipsoids3D, spheres, style, rows, colors)

    def _items(
        self,
        path: str,
        archetype: Any,
        varying: dict[str, Any],
        fixed: dict[str, Any],
        rows: Sequence[np.ndarray],
        colors: Colors,
    ) -> None:
        if len(colors) and np.ndim(colors[0]) == 0:
            fixed["colors"] = [colors]
        else:
            varying["colors"] = _stack(list(colors)).astype(np.uint8)
        self.static(path, archetype.from_fields(**fixed))
        self.columns(path, archetype.columns(**varying).partition([len(row) for row in rows]))

    def label(self, path: str, text: str, color: Color, position: Sequence[float]) -> None:
        """Sends a text at a position, m, for all times."""
        self.static(path, Points3D([position], labels=[text], show_labels=True, radii=[0.0], colors=[color]))

    def human_hand(self, path: str, p_WK: np.ndarray) -> None:
        """Sends a human hand of keypoints p_WK (T, 21, 3), m; hands with a NaN are not drawn.

        Bones are capsules and joints are spheres; fingertips have the colours of the fingers.
        """
        bones, points = f"{path}/bones", f"{path}/keypoints"
        self.static(bones, rr.Capsules3D.from_fields(radii=_BONE_RADII, colors=[SKIN], fill_mode=SOLID))
        # Joints stand out slightly from the skin and are darker.
        radii = np.r_[0.011, 1.08 * _BONE_RADII.reshape(5, 4)[:, [1, 2, 3, 3]].ravel()]
        colors = np.tile((0.72 * np.array(SKIN)).astype(np.uint8), (21, 1))
        for finger, tip in TIP_KEYPOINT.items():
            colors[tip], radii[tip] = rgb(FINGER_COLOURS[finger]), 1.3 * radii[tip]
        self.static(points, Points3D.from_fields(radii=radii, colors=colors))
        p_WK = np.reshape(p_WK, (-1, 21, 3))
        R_WH, p_WH = wrist_pose(p_WK)
        self.poses([f"{path}/{HAND_FRAME}"], np.concatenate([R_WH, p_WH[..., None]], axis=2)[:, None])
        is_drawn = np.isfinite(p_WK).all(axis=(1, 2))
        p_WK = p_WK[is_drawn]
        # An empty entry removes a lost hand from the view.
        count = is_drawn.astype(int)
        parents, children = np.array(BONES).T
        along = p_WK[:, children] - p_WK[:, parents]
        capsules = rr.Capsules3D.columns(
            lengths=np.linalg.norm(along, axis=2).ravel(),
            translations=p_WK[:, parents].reshape(-1, 3),
            quaternions=_rotate_z_to(along.reshape(-1, 3)),
        )
        self.columns(bones, capsules.partition(20 * count))
        self.columns(points, Points3D.columns(positions=p_WK.reshape(-1, 3)).partition(21 * count))

    def close(self) -> None:
        """Ends the recording; a viewer that does not receive the last data in time causes a warning."""
        try:
            self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
        except (RuntimeError, ValueError) as error:
            warnings.warn(f"the viewer did not receive all data: {error}", stacklevel=4)
            # Rerun waits 5 s more for a viewer that is not there.
            threading.Thread(target=self._stream.disconnect, daemon=True).start()
        else:
            self._stream.disconnect()


@contextlib.contextmanager
def file_writer(
    path: str | os.PathLike,
    *,
    name: str = "",
    application_id: str = _APPLICATION,
    recording_id: str | None = None,
    blueprint: rrb.Blueprint | None = None,
    properties: Mapping[str, Property] | None = None,
) -> Iterator[Writer]:
    """Opens a `Writer` to an .rrd file, which appears when the block ends without an error.

    The data stay in memory until then. Equal data give equal columns; log times are left out. With the
    environment variable RERUN=off no file is written, and a warning says so.

    Args:
        name: name of the recording in the viewer; by default that of the file.

    Raises:
        OutputError: the disk is full, or the folder is not writable.
    """
    path = Path(path)
    stream = _stream(application_id, recording_id)
    if not rr.is_enabled(stream):
        warnings.warn(f"{path}: not written, because of the environment variable RERUN=off", stacklevel=4)
        yield Writer(stream)
        return
    # Rerun's own writer to files may hang on a full disk, and reports errors on stderr only.
    recording = stream.memory_recording()
    try:
        if blueprint is not None:
            stream.send_blueprint(blueprint, make_active=False)
        _send_properties(stream, name or path.stem, properties or {})
        yield Writer(stream)
        with atomic_path(path) as draft:
            draft.write_bytes(recording.drain_as_bytes())
    finally:
        stream.disconnect()


def live_writer(
    viewers: Sequence[Viewer],
    *,
    blueprint: rrb.Blueprint,
    name: str,
    properties: Mapping[str, Property],
) -> Writer:
    """Opens a writer that sends data to viewers."""
    stream = _stream(_APPLICATION, None)
    stream.set_sinks(*viewers, default_blueprint=blueprint)
    _send_properties(stream, name, properties)
    return Writer(stream)


def _stream(application_id: str, recording_id: str | None) -> rr.RecordingStream:
    stream = rr.RecordingStream(application_id, recording_id=recording_id, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _send_properties(stream: rr.RecordingStream, name: str, properties: Mapping[str, Property]) -> None:
    stream.send_recording_name(name)
    if properties:
        # Arrays have explicit types, because Rerun keeps the first type of each name in a process.
        stream.send_property(
            "run", rr.AnyValues(**{key: pa.array([value]) for key, value in properties.items()})
        )


def state_names(codes: Sequence[float] | np.ndarray, labels: Sequence[str]) -> list[str]:
    """Returns the labels of codes (T,); a code without one shows as a number."""
    return [labels[int(code)] if 0 <= code < len(labels) else f"code {code:g}" for code in codes]


def transform(X: RigidTransform) -> rr.Transform3D:
    """Converts a pose to Rerun's transform."""
    return rr.Transform3D(translation=X.translation(), quaternion=rr.Quaternion(xyzw=xyzw(X)))


def xyzw(X: RigidTransform) -> np.ndarray:
    """Returns the rotation as a quaternion xyzw, Rerun's order."""
    return np.roll(X.rotation().ToQuaternion().wxyz(), -1)


def _stack(rows: Sequence) -> np.ndarray:
    return np.concatenate(rows) if len(rows) else np.empty((0, 3))


def _rotate_z_to(directions: np.ndarray) -> np.ndarray:
    """Returns the smallest rotations (n, 4), xyzw, from the z axis to the directions (n, 3)."""
    length = np.maximum(np.linalg.norm(directions, axis=1), 1e-12)
    x, y, z = (directions / length[:, None]).T
    turns = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=1)
    turns[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # straight down: half a turn about x
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)

"""The samples of one recording, and the file they become."""

import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.files import atomic_path
from geort_drake.gloves.keypoints import FINGER_NAMES
from geort_drake.systems._rerun_blueprint import grasp_blueprint
from geort_drake.systems._rerun_scene import WORLD, Scene, entity_path, transform
from geort_drake.systems._rerun_tracks import (
    ContactTrack,
    HandTrack,
    PoseTrack,
    SignalTrack,
    StateTrack,
    Track,
    Writer,
)

_VIEW_DIRECTION = np.array([0.62, -0.62, 0.48])  # from the scene to the eye: front left, from above


class Recording:
    """Samples of several tracks at common times; `close` writes them and lets go of them.

    Attributes:
        times: sample times, s, increasing.
        properties: what the recording is about.
        closed: whether the file was written.
    """

    def __init__(
        self,
        path: str | os.PathLike,
        scene: Scene,
        tracks: Sequence[Track],
        *,
        application_id: str,
        recording_id: str | None,
        properties: Mapping[str, str | int | float | bool],
        blueprint: rrb.Blueprint | None,
    ):
        self.path = Path(path)
        self.scene = scene
        self.tracks = list(tracks)
        self.times: list[float] = []
        self.closed = False
        self._application_id = application_id
        self._recording_id = recording_id
        self.properties = dict(properties)
        self._blueprint = blueprint

    def append(self, time: float, rows: Sequence) -> None:
        """Adds one row per track; samples at or after `time` are dropped first."""
        keep = len(self.times)
        while keep and self.times[keep - 1] >= time:
            keep -= 1
        del self.times[keep:]
        self.times.append(time)
        for track, row in zip(self.tracks, rows, strict=True):
            del track.rows[keep:]
            track.rows.append(row)

    def close(self) -> None:
        """Writes the file, once, and lets go of the samples: Drake keeps the system that made them."""
        if self.closed:
            return
        # Without the properties Rerun adds by itself, such as the start time, equal samples give
        # equal recordings.
        stream = rr.RecordingStream(
            self._application_id,
            recording_id=self._recording_id or self._digest(),
            send_properties=False,
        )
        if rr.is_enabled(stream):
            with atomic_path(self.path) as draft:
                try:
                    self._write(stream, draft)
                finally:
                    stream.disconnect()
        else:
            warnings.warn(f"{self.path}: not written, as the environment says RERUN=off", stacklevel=3)
        self.closed = True
        self.tracks.clear()

    def _write(self, stream: rr.RecordingStream, path: Path) -> None:
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        stream.save(path, default_blueprint=self._blueprint or self.default_blueprint())
        stream.send_recording_name(self.path.stem)
        if self.properties:
            # Typed arrays, because Rerun keeps the first type it sees under a name for good.
            typed = {name: pa.array([value]) for name, value in self.properties.items()}
            stream.send_property("run", rr.AnyValues(**typed))
        writer = Writer(stream, np.array(self.times))
        writer.static(f"/{WORLD}", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for index, X_WB in self.scene.anchored.items():
            writer.static(self.scene.paths[index], transform(X_WB))
        for entity, archetype in self.scene.shapes:
            writer.static(entity, archetype)
        for track in self.tracks:
            track.write(writer)

    def _digest(self) -> str:
        """An id made of the contents, so that repeating a simulation repeats the recording."""
        digest = hashlib.sha256(repr(sorted(self.properties.items())).encode())
        digest.update(np.array(self.times).tobytes())
        for track in self.tracks:
            digest.update(repr(track.ports).encode())
            for row in track.rows:
                digest.update(np.asarray(row).tobytes())
        return digest.hexdigest()[:32]

    def default_blueprint(self) -> rrb.Blueprint:
        """`grasp_blueprint` for what was recorded, seen from where the motion fills the view."""
        plots: dict[str, list[str]] = {}
        for track in self._of(SignalTrack):
            for group in track.groups:
                plots.setdefault(group or track.key.rsplit("/", 1)[-1], []).append(track.path(group))
        # Fingers in their usual order, whatever the order of the joints; the rest after them.
        first = [name for name in FINGER_NAMES if name in plots]
        plots = {name: plots[name] for name in [*first, *(n for n in plots if n not in first)]}
        target, eye = self._camera()
        return grasp_blueprint(
            plots=plots,
            states=[entity_path(track.key) for track in self._of(StateTrack)],
            contact=bool(self._of(ContactTrack)),
            eye=eye,
            target=target,
        )

    def _camera(self) -> tuple[np.ndarray, np.ndarray]:
        """Target and eye, m, in W, that take in the moving bodies and the hands.

        The outermost percents are left out: one thrown object must not shrink all the rest.
        """
        points = [track.poses()[..., 3].reshape(-1, 3) for track in self._of(PoseTrack)]
        points += [np.array(track.rows).reshape(-1, 3) for track in self._of(HandTrack)]
        cloud = np.concatenate([np.empty((0, 3)), *points])
        cloud = cloud[np.isfinite(cloud).all(axis=1)]
        low, high = np.percentile(cloud, [2, 98], axis=0) if len(cloud) else np.zeros((2, 3))
        target = (low + high) / 2
        distance = 0.25 + 1.0 * float(np.linalg.norm(high - low))
        return target, target + distance * _VIEW_DIRECTION

    def _of(self, kind):
        return [track for track in self.tracks if isinstance(track, kind)]

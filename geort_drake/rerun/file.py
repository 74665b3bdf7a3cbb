"""The samples of one recording, and where they go: to a file at the end, to viewers meanwhile."""

import hashlib
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue

from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.rerun.blueprint import CloseUp, Plot, grasp_blueprint
from geort_drake.rerun.camera import CameraTrack
from geort_drake.rerun.contact import ContactTrack
from geort_drake.rerun.hand import HandTrack
from geort_drake.rerun.points import PointTrack
from geort_drake.rerun.scene import WORLD, Scene, as_of_glass, entity_path, transform
from geort_drake.rerun.tracks import PoseTrack, SignalTrack, StateTrack, Track
from geort_drake.rerun.writer import LiveSink, LiveWriter, Property, Writer, file_writer

VIEW_FROM = (0.62, -0.62, 0.48)  # from the scene to the eye: front left, from above
_BATCH_S = 0.1  # wall time between two batches for those who look on
_READ_AT_ONCE = 64  # samples
T = TypeVar("T", bound=Track)


@dataclass(frozen=True)
class CloseUpView:
    """See `CloseUpSpec`.

    Attributes:
        name: its title.
        follows: index of a body, or the key of a hand.
        eye, target: m, in the frame of that body or of that hand's wrist.
        see_through: indices of bodies.
    """

    name: str
    follows: int | str
    eye: np.ndarray
    target: np.ndarray
    see_through: Sequence[int]


class Recording:
    """Samples of several tracks at common times.

    Viewers get them in batches. The file gets them all at once, at every `flush`, so that it is whole or
    absent. Without a file, what the viewers have got is forgotten.

    Attributes:
        times: sample times, s, increasing.
        closed: whether the recording is over.
    """

    def __init__(
        self,
        path: str | os.PathLike | None,
        scene: Scene,
        tracks: Sequence[Track],
        *,
        sinks: Sequence[LiveSink] = (),
        application_id: str,
        recording_id: str | None,
        properties: Mapping[str, Property],
        blueprint: rrb.Blueprint | None,
        close_ups: Sequence[CloseUpView] = (),
        view_from: ArrayLike = VIEW_FROM,
    ):
        self.path = None if path is None else Path(path)
        self.scene = scene
        self.tracks = list(tracks)
        self.times: list[float] = []
        self.closed = False
        self._properties = dict(properties)
        self._sinks = list(sinks)
        self._application_id = application_id
        self._recording_id = recording_id
        self._blueprint = blueprint
        self._close_ups = list(close_ups)
        self._view_from = np.asarray(view_from, float) / np.linalg.norm(view_from)
        self._live: LiveWriter | None = None
        self._unread: list[Sequence[tuple | None]] = []  # the newest samples, of which there are no rows yet
        self._sent = 0  # how many samples the viewers have got
        self._sent_at = 0.0  # wall time, s
        self._changed = True  # since the file was written

    def append(self, time_s: float, sample: Sequence[tuple | None]) -> None:
        """Adds for each track copies of its ports' values; samples at or after `time_s` are dropped first."""
        keep = len(self.times)
        while keep and self.times[keep - 1] >= time_s:
            keep -= 1
        if keep < len(self.times):
            self._read()
            del self.times[keep:]
            for track in self.tracks:
                del track.rows[keep:]
        self.times.append(time_s)
        self._unread.append(sample)
        self._changed = True
        self._sent = min(self._sent, keep)
        large = any(track.large and values for track, values in zip(self.tracks, sample, strict=True))
        if large or len(self._unread) == _READ_AT_ONCE:
            self._read()
        if self._sinks and time.monotonic() >= self._sent_at + _BATCH_S:
            self._send()

    def _read(self) -> None:
        """Makes rows of the samples that have none.

        Many at once, because what is done between two steps of a simulation finds the processor's caches
        full of other things, and takes half as long again.
        """
        columns = [
            [None if values is None else track.read(*map(_content, values)) for values in column]
            for track, *column in zip(self.tracks, *self._unread, strict=True)
        ]
        self._unread.clear()
        for track, rows in zip(self.tracks, columns, strict=True):
            track.rows += rows

    def set_properties(self, properties: Mapping[str, Property]) -> None:
        """Adds to what the recording is about; viewers keep what they were told first."""
        self._properties.update(properties)
        self._changed = True

    def flush(self) -> None:
        """Sends what viewers have not got, and writes the file with all samples so far."""
        if self.closed:
            return
        if self._sinks and self._sent < len(self.times):
            self._send()
        if self.path is None or not self._changed:
            return
        self._read()
        file = file_writer(
            self.path,
            application_id=self._application_id,
            recording_id=self._recording_id or self._digest(),
            blueprint=self._blueprint or self.default_blueprint(),
            properties=self._properties,
        )
        with file as writer:
            if writer is not None:
                self._describe(writer)
                writer.at(np.array(self.times))
                for track in self.tracks:
                    track.write(writer, track.rows)
        self._changed = False

    def close(self) -> None:
        """Flushes, and lets go of the samples: Drake keeps the system that made them."""
        if self.closed:
            return
        self.flush()
        self.closed = True
        if self._live is not None:
            self._live.disconnect()
        self.tracks.clear()

    def _send(self) -> None:
        self._read()
        if self._live is None:
            self._live = LiveWriter(
                self._sinks,
                application_id=self._application_id,
                recording_id=self._recording_id,
                blueprint=self._blueprint or self.default_blueprint(),
                name=self.path.stem if self.path else "live",
                properties=self._properties,
            )
            self._describe(self._live)
        self._live.at(np.array(self.times[self._sent :]))
        for track in self.tracks:
            track.write(self._live, track.rows[self._sent :])
        self._sent, self._sent_at = len(self.times), time.monotonic()
        if self.path is None:
            self.times.clear()
            for track in self.tracks:
                track.rows.clear()
            self._sent = 0

    def _describe(self, writer: Writer) -> None:
        writer.static(f"/{WORLD}", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for index, X_WB in self.scene.anchored.items():
            writer.static(self.scene.paths[index], transform(X_WB))
        for entity, archetype in self.scene.shapes:
            writer.static(entity, archetype)
        for track in self.tracks:
            track.describe(writer)

    def _digest(self) -> str:
        """An id made of the contents, so that repeating a simulation repeats the recording."""
        digest = hashlib.sha256(repr(sorted(self._properties.items())).encode())
        digest.update(np.array(self.times).tobytes())
        for track in self.tracks:
            digest.update(repr(track.ports).encode())
            for row in track.rows:
                for part in row if isinstance(row, tuple) else (row,):
                    digest.update(part if isinstance(part, bytes) else np.asarray(part, float).tobytes())
        return digest.hexdigest()[:32]

    def default_blueprint(self) -> rrb.Blueprint:
        """`grasp_blueprint` for what was recorded, seen from where the motion fills the view."""
        plots: dict[str, Plot] = {}
        for track in self._of(SignalTrack):
            for group in track.groups:
                # What was asked for and what was measured share a plot.
                title = track.title(group)
                before = plots.get(title, Plot([], track.page, track.legend, track.limits))
                plots[title] = replace(before, paths=[*before.paths, track.path(group)])
        # Fingers in their usual order, whatever the order of the joints; the rest after them.
        order = {name: number for number, name in enumerate(FINGER_NAMES)}
        pages = list(dict.fromkeys(plot.page for plot in plots.values()))
        titles = sorted(
            plots, key=lambda t: (pages.index(plots[t].page), order.get(t.partition(" ")[0], len(order)))
        )
        target, eye = self._eye()
        contact = self._of(ContactTrack)
        return grasp_blueprint(
            plots={title: plots[title] for title in titles},
            states=[entity_path(track.key) for track in self._of(StateTrack)],
            contact=bool(contact),
            cameras=[track.path() for track in self._of(CameraTrack)],
            eye=eye,
            target=target,
            early=any(track.early() for track in contact),
            close_ups=[self._close_up(view) for view in self._close_ups],
            trails={track.path: track.trail for track in self._of(PointTrack) if track.trail},
        )

    def _close_up(self, view: CloseUpView) -> CloseUp:
        # The view turns with what it follows, so what is up in it is up only at the end.
        if isinstance(view.follows, int):
            path, contents = self.scene.paths[view.follows], f"/{WORLD}/**"
            R_WF = np.eye(3)
            if view.follows in self.scene.anchored:
                R_WF = self.scene.anchored[view.follows].rotation().matrix()
            elif self.times:
                (bodies,) = self._of(PoseTrack)
                R_WF = bodies.poses()[-1, self.scene.moving.index(view.follows), :, :3]
        else:
            path = entity_path(WORLD, view.follows, HandTrack.FRAME)
            contents = f"{entity_path(WORLD, view.follows)}/**"
            (hand,) = (track for track in self._of(HandTrack) if track.key == view.follows)
            R_WF = hand.last_rotation()
        glass: dict[str, rr.AsComponents] = {}
        for body in view.see_through:
            inside = f"{self.scene.paths[body]}/"
            shapes = {
                path: as_of_glass(shape) for path, shape in self.scene.shapes if path.startswith(inside)
            }
            glass |= {path: style for path, style in shapes.items() if style is not None}
        return CloseUp(view.name, path, contents, view.eye, view.target, R_WF[2], glass)

    def _eye(self) -> tuple[np.ndarray, np.ndarray]:
        """What the eye looks at and where it stands, m, in W, to take in the moving bodies and the hands.

        The outermost percents are left out: one thrown object must not shrink all the rest.
        """
        points = [track.poses()[..., 3].reshape(-1, 3) for track in self._of(PoseTrack)]
        points += [np.array(track.rows).reshape(-1, 3) for track in self._of(HandTrack)]
        cloud = np.concatenate([np.empty((0, 3)), *points])
        cloud = cloud[np.isfinite(cloud).all(axis=1)]
        low, high = np.percentile(cloud, [2, 98], axis=0) if len(cloud) else np.zeros((2, 3))
        target = (low + high) / 2
        distance = 0.17 + 0.78 * float(np.linalg.norm(high - low))
        return target, target + distance * self._view_from

    def _of(self, kind: type[T]) -> list[T]:
        return [track for track in self.tracks if isinstance(track, kind)]


def _content(copy: np.ndarray | AbstractValue) -> Any:
    return copy.get_value() if isinstance(copy, AbstractValue) else copy

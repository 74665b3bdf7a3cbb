"""Records the ports of a glove, a tracker and a real robot."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, EventStatus

from geort_drake.people.recording import Recording
from geort_drake.people.recording_log import RecordingLog
from geort_drake.systems.port_values import pose_to_vector
from geort_drake.systems.python_system import PythonSystem

_WRITE_AFTER = 1.0  # s; a crash loses the samples since then


class GloveRecorder(PythonSystem):
    """Samples a glove's ports at a fixed period, for `recording`, or to a log that `switch` gives.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost.
        <key of `robot`> (2n): joint positions, rad, then velocities, which are not recorded.

    Samples are taken in an update event, not a publish event, so they are the values that other systems use
    at that time.

    Attributes:
        robot_signals: names of the columns of `Recording.robot`.

    Args:
        period: time between samples, s.
        robot: name of a robot's port, such as "joints.command" → names of its n joints.
        write_after: time after which samples are written to the log, s.
    """

    def __init__(
        self,
        period: float,
        robot: Mapping[str, Sequence[str]] | None = None,
        write_after: float = _WRITE_AFTER,
    ):
        super().__init__()
        self._log: RecordingLog | None = None
        self._most_samples = max(round(write_after / period), 1)
        self._paused = False
        self._samples: list[tuple[float, np.ndarray, RigidTransform, bool, list[float]]] = []
        self._keypoints = self.DeclareVectorInputPort("keypoints", 63)
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._robot = [
            (self.DeclareVectorInputPort(name, 2 * len(joints)), len(joints))
            for name, joints in (robot or {}).items()
        ]
        self.robot_signals = [f"{key}.{joint}" for key, joints in (robot or {}).items() for joint in joints]
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def _sample(self, context: Context, _state: DiscreteValues) -> EventStatus:
        if self._paused:
            return EventStatus.DidNothing()
        # Copies, because Drake overwrites port values.
        keypoints = self._keypoints.Eval(context).reshape(21, 3).copy()
        X_WH = RigidTransform(self._wrist.Eval(context))
        valid = bool(self._valid.Eval(context)[0] > 0.5)
        q = [position for port, n in self._robot for position in port.Eval(context)[:n].tolist()]
        self._samples.append((context.get_time(), keypoints, X_WH, valid, q))
        if self._log is not None and len(self._samples) >= self._most_samples:
            self._write(self._log)
        return EventStatus.Succeeded()

    def recording(self, metadata: dict | None = None) -> Recording:
        """Returns the samples so far, with tracker poses; only without a log."""
        t, p_HK, valid, X_WH, robot = self._arrays()
        return Recording(t - t[0], p_HK, valid, X_WH, dict(metadata or {}), robot)

    def switch(self, log: RecordingLog | None) -> None:
        """Writes the samples so far to the present log, and later ones to another; None drops them."""
        if self._log is not None and self._samples:
            self._write(self._log)
        self._samples.clear()
        self._log, self._paused = log, log is None

    def _write(self, log: RecordingLog) -> None:
        log.append(*self._arrays())
        self._samples.clear()

    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        t, p_HK, poses, valid, q = zip(*self._samples, strict=True)
        X_WH = np.array([pose_to_vector(X) for X in poses])
        return np.array(t), np.array(p_HK), np.array(valid), X_WH, np.array(q) if self._robot else None

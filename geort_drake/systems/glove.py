"""Replays, mirrors and records the ports of a glove and a tracker."""

import bisect
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from geort_drake.errors import RecordingError
from geort_drake.people.checks import require_hand
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import Recording
from geort_drake.people.recording_log import RecordingLog, recording_of_rows
from geort_drake.systems.port_values import mirrored_pose, pose_to_vector, vector_to_pose
from geort_drake.systems.python_system import PythonSystem

_TIME_TOLERANCE = 1e-9  # s; for rounding errors in recorded times


class GloveReplay(PythonSystem):
    """Plays back a recording and holds each sample until the next one.

    Output ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker; the identity if the recording has none.
        valid (1): 1 tracked, 0 lost.

    Before the recording it outputs the first sample, after it the last one. A left hand appears as its mirror
    image, which retargeters expect; to draw it or to move an arm, `HandMirror` mirrors it back.

    Raises:
        RecordingError, MismatchError: the recording has no frames, or see `people.checks.require_hand`.
    """

    def __init__(self, recording: Recording):
        super().__init__()
        if len(recording.t) == 0:
            raise RecordingError("a recording without frames cannot be replayed")
        if recording.valid.any():
            require_hand(recording)
        # A list, because bisection in it is faster than in an array.
        self._t = (recording.t - recording.t[0]).tolist()
        self._keypoints = np.asarray(recording.p_HK, float).reshape(len(self._t), 63)
        self._valid = np.asarray(recording.valid, float)
        self._wrist_poses = [RigidTransform()] * len(self._t)
        if recording.X_WH is not None:
            self._wrist_poses = [vector_to_pose(row) for row in recording.X_WH]
        self.DeclareVectorOutputPort("keypoints", 63, self._calc_keypoints)
        self.DeclareAbstractOutputPort(
            "wrist_pose", lambda: AbstractValue.Make(RigidTransform()), self._calc_wrist_pose
        )
        self.DeclareVectorOutputPort("valid", 1, self._calc_valid)

    @property
    def duration(self) -> float:
        """Time of the last sample, s."""
        return self._t[-1]

    def _sample(self, context: Context) -> int:
        return max(0, bisect.bisect_right(self._t, context.get_time() + _TIME_TOLERANCE) - 1)

    def _calc_keypoints(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._keypoints[self._sample(context)])

    def _calc_wrist_pose(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._wrist_poses[self._sample(context)])

    def _calc_valid(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._valid[self._sample(context)])


class HandMirror(PythonSystem):
    """Reflects keypoints in the xz-plane of H and the wrist's pose in the xz-plane of W.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m.
        wrist_pose (abstract RigidTransform): X_WH.
    Output ports:
        keypoints (63): the reflected keypoints, same order.
        wrist_pose (abstract RigidTransform): the reflected pose.
    """

    def __init__(self) -> None:
        super().__init__()
        self._keypoints = self.DeclareVectorInputPort("keypoints", 63)
        self._wrist_pose = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorOutputPort("keypoints", 63, self._calc_keypoints, {self._keypoints.ticket()})
        self.DeclareAbstractOutputPort(
            "wrist_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            self._calc_wrist_pose,
            {self._wrist_pose.ticket()},
        )

    def _calc_keypoints(self, context: Context, output: BasicVector) -> None:
        p_HK = np.reshape(self._keypoints.Eval(context), (21, 3))
        output.SetFromVector(mirrored(p_HK).ravel())

    def _calc_wrist_pose(self, context: Context, output: AbstractValue) -> None:
        output.set_value(mirrored_pose(self._wrist_pose.Eval(context)))


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
    """

    def __init__(self, period: float, robot: Mapping[str, Sequence[str]] | None = None):
        super().__init__()
        self._rows: list[np.ndarray] = []
        self._append: Callable[[np.ndarray], None] | None = self._rows.append
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
        if self._append is None:
            return EventStatus.DidNothing()
        X_WH = pose_to_vector(self._wrist.Eval(context))
        robot = [port.Eval(context)[:n] for port, n in self._robot]
        keypoints, valid = self._keypoints.Eval(context), self._valid.Eval(context)
        self._append(np.concatenate([[context.get_time()], keypoints, valid, X_WH, *robot]))
        return EventStatus.Succeeded()

    def recording(self, metadata: dict) -> Recording:
        """Returns the samples so far, with tracker poses; only without a log."""
        return recording_of_rows(np.array(self._rows), metadata)

    def switch(self, log: RecordingLog | None) -> None:
        """Drops the samples so far, and writes later ones to a log; None drops them, too."""
        self._rows.clear()
        self._append = None if log is None else log.append

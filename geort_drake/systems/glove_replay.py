"""Replays a recorded glove and tracker in a diagram."""

import bisect

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context

from geort_drake.errors import RecordingError
from geort_drake.people.recording import Recording
from geort_drake.systems.port_values import vector_to_pose
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
        RecordingError: the recording has no frames.
    """

    def __init__(self, recording: Recording):
        super().__init__()
        if len(recording.t) == 0:
            raise RecordingError("a recording without frames cannot be replayed")
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

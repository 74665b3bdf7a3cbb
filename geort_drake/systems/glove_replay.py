"""A recorded glove and tracker, played back into a diagram."""

import bisect

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from geort_drake.people.recording import Recording
from geort_drake.systems.poses import vector_to_pose

# A sample counts as due when its time is this close: recorded times are sums of binary fractions.
_TIME_TOLERANCE = 1e-9


class GloveReplay(LeafSystem):
    """Plays a recording as a glove delivers it: the newest sample is held until the next one.

    Output ports:
        keypoints (63): p_HK, the 21 keypoints one after the other, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker; the identity where the recording
            has no tracker.
        valid (1): 1 while the hand is tracked, 0 where it was lost.

    Before its first and after its last sample the recording's first and last sample are given.
    """

    def __init__(self, recording: Recording):
        super().__init__()
        # A list, in which a time is found faster than in an array.
        self._t = (recording.t - recording.t[0]).tolist()
        self._keypoints = np.asarray(recording.p_HK, float).reshape(len(self._t), 63)
        self._valid = np.asarray(recording.valid, float)
        self._wrist_poses = _wrist_poses(recording)
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
        output.set_value(self._wrist_poses[self._sample(context) if len(self._wrist_poses) > 1 else 0])

    def _calc_valid(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._valid[self._sample(context)])


def _wrist_poses(recording: Recording) -> list[RigidTransform]:
    if recording.X_WH is None:
        return [RigidTransform()]
    return [vector_to_pose(row) for row in recording.X_WH]

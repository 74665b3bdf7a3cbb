"""Keeps what a glove and a tracker gave, as a recording that can be played again."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from geort_drake.gloves.recording import Recording
from geort_drake.systems.poses import pose_to_vector


class GloveRecorder(LeafSystem):
    """Samples a glove's ports at a fixed period.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost.

    It samples in its update, not in a publish, so that it keeps what the other systems act on at the
    same instant.
    """

    def __init__(self, period: float):
        super().__init__()
        self._samples: list[tuple[float, np.ndarray, np.ndarray, bool]] = []
        self.DeclareVectorInputPort("keypoints", 63)
        self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("valid", 1)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def _sample(self, context: Context, _state) -> EventStatus:
        pose = pose_to_vector(self.GetInputPort("wrist_pose").Eval(context))
        keypoints = self.GetInputPort("keypoints").Eval(context).reshape(21, 3).copy()
        valid = bool(self.GetInputPort("valid").Eval(context)[0] > 0.5)
        self._samples.append((context.get_time(), keypoints, pose, valid))
        return EventStatus.Succeeded()

    def recording(self, metadata: dict | None = None) -> Recording:
        """What was sampled so far, as a `Recording` with tracker poses."""
        t, p_HK, X_WH, valid = (np.array(column) for column in zip(*self._samples, strict=True))
        return Recording(t=t - t[0], p_HK=p_HK, valid=valid, X_WH=X_WH, metadata=dict(metadata or {}))

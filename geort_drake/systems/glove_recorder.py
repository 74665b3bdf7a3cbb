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
        self._samples: list[tuple[float, np.ndarray, RigidTransform, bool]] = []
        self._keypoints = self.DeclareVectorInputPort("keypoints", 63)
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def _sample(self, context: Context, _state) -> EventStatus:
        # Copies, because ports are written over.
        keypoints = self._keypoints.Eval(context).reshape(21, 3).copy()
        X_WH = RigidTransform(self._wrist.Eval(context))
        valid = bool(self._valid.Eval(context)[0] > 0.5)
        self._samples.append((context.get_time(), keypoints, X_WH, valid))
        return EventStatus.Succeeded()

    def recording(self, metadata: dict | None = None) -> Recording:
        """What was sampled so far, as a `Recording` with tracker poses."""
        t, p_HK, poses, valid = zip(*self._samples, strict=True)
        return Recording(
            t=np.array(t) - t[0],
            p_HK=np.array(p_HK),
            valid=np.array(valid),
            X_WH=np.array([pose_to_vector(X) for X in poses]),
            metadata=dict(metadata or {}),
        )

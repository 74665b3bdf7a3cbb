"""Keeps what a glove and a tracker gave, as a recording that can be played again."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.people.recording import Recording
from geort_drake.people.recording_parts import RecordingParts
from geort_drake.systems.poses import pose_to_vector

# A part of a recording that is kept on the disk while it is made, s.
_PART_S = 5.0


class GloveRecorder(LeafSystem):
    """Samples a glove's ports at a fixed period.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost.

    It samples in its update, not in a publish, so that it keeps what the other systems act on at the
    same instant.

    Args:
        period: between samples, s.
        parts: where samples go every `part` seconds, so that memory stays bounded and a kill loses little;
            without it, all are kept until `recording` is asked for.
    """

    def __init__(self, period: float, parts: RecordingParts | None = None, part: float = _PART_S):
        super().__init__()
        self._parts, self._part_samples = parts, max(round(part / period), 1)
        self._samples: list[tuple[float, np.ndarray, RigidTransform, bool]] = []
        self._keypoints = self.DeclareVectorInputPort("keypoints", 63)
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def _sample(self, context: Context, _state: DiscreteValues) -> EventStatus:
        # Copies, because ports are written over.
        keypoints = self._keypoints.Eval(context).reshape(21, 3).copy()
        X_WH = RigidTransform(self._wrist.Eval(context))
        valid = bool(self._valid.Eval(context)[0] > 0.5)
        self._samples.append((context.get_time(), keypoints, X_WH, valid))
        if self._parts is not None and len(self._samples) >= self._part_samples:
            self._hand_over(self._parts)
        return EventStatus.Succeeded()

    def recording(self, metadata: dict | None = None) -> Recording:
        """What was sampled so far, as a `Recording` with tracker poses; only without `parts`."""
        t, p_HK, valid, X_WH = self._arrays()
        return Recording(t - t[0], p_HK, valid, X_WH, dict(metadata or {}))

    def finish(self) -> bool:
        """Joins the parts to a file, as `RecordingParts.finish`, whose result and errors these are."""
        if self._parts is None:
            raise ValueError("this recorder keeps no parts; ask for its recording")
        if self._samples:
            self._hand_over(self._parts)
        return self._parts.finish()

    def _hand_over(self, parts: RecordingParts) -> None:
        parts.append(*self._arrays())
        self._samples.clear()

    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        t, p_HK, poses, valid = zip(*self._samples, strict=True)
        return np.array(t), np.array(p_HK), np.array(valid), np.array([pose_to_vector(X) for X in poses])

"""Hands without a camera: one that the mouse moves, and a recorded one."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.live.messages import GloveFrame
from geort_drake.live.web.messages import Pointer
from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand

# Reach of the wrist from the middle to each edge, m: forward, left, up.
_REACH_M = np.array([0.25, 0.3, 0.25])
_WRIST_SPEED, _GRIP_SPEED = 0.6, 1.6  # m/s; closings per second
# Fingers point forward and the palm faces down, as over a table: axes of H in W.
_R_WH = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
FINGERS = tuple(FINGER_KEYPOINTS)
_PAD_M = 0.0005  # depth of a keypoint under the pad's skin
# Degrees of abduction and three flexions, from the thumb to the little finger: a hand that is about to grasp.
_OPEN = np.radians([[35, -5, 5, 5], [2, 20, 25, 15], [0, 20, 25, 15], [-2, 20, 25, 15], [-4, 20, 25, 15]])


class PointerHand:
    """A hand whose wrist follows the mouse, and which closes a grip smoothly while a button is held."""

    def __init__(self) -> None:
        self._hand = HumanHand.anatomical()
        self._open = np.clip(_OPEN.ravel(), self._hand.lower, self._hand.upper)
        self._closed = {name: self._close([name]) for name in FINGERS[1:]} | {
            "hand": self._close(FINGERS[1:])
        }
        self._time = math.nan
        self._p_WH, self._theta = np.zeros(3), self._open

    def frame(self, pointer: Pointer, side: str) -> GloveFrame:
        """Returns the hand at the pointer's time; a left hand as its mirror image."""
        step = 0.0 if math.isnan(self._time) else min(max(pointer.t - self._time, 0.0), 0.1)
        self._time = pointer.t
        mirror = -1.0 if side == "left" else 1.0
        aim = _REACH_M * [pointer.z, -mirror * pointer.x, -pointer.y]
        way = aim - self._p_WH
        self._p_WH = self._p_WH + way * min(1.0, _WRIST_SPEED * step / max(float(np.linalg.norm(way)), 1e-9))
        goal = self._closed[pointer.grip] if pointer.closed else self._open
        fastest = _GRIP_SPEED * step * np.abs(self._closed["hand"] - self._open).max()
        self._theta = self._theta + np.clip(goal - self._theta, -fastest, fastest)
        quaternion = Rotation.from_matrix(_R_WH).as_quat(scalar_first=True)
        p_HK = self._hand.keypoints(self._theta)
        return GloveFrame(side, pointer.t, p_HK, np.concatenate([quaternion, self._p_WH]))

    def _close(self, fingers: list[str] | tuple[str, ...]) -> np.ndarray:
        """Returns joint angles (20,), rad, at which the thumb's pad meets those of the fingers."""
        tips = self._hand.fingertips(self._open)
        chosen = [FINGERS.index(name) for name in fingers]
        meeting = 0.5 * (tips[0] + tips[chosen].mean(axis=0))
        targets, weights = tips.copy(), np.zeros(5)
        apart = tips[chosen].mean(axis=0) - tips[0]
        apart *= _PAD_M / np.linalg.norm(apart)
        targets[0], weights[0] = meeting - apart, 1.0
        for finger in chosen:
            # Fingers close side by side, each in its own plane.
            sideways = np.array([0.0, tips[finger, 1] - tips[chosen].mean(axis=0)[1], 0.0])
            targets[finger], weights[finger] = meeting + apart + sideways, 1.0
        return self._hand.solve_fingertips(targets, self._open, weights, iterations=40)


class RecordedHand:
    """A recording that is played over and over."""

    def __init__(self, recording: Recording):
        self._recording = recording
        self._period = float(recording.t[-1] - recording.t[0]) + 1.0 / 30.0

    def frame(self, time: float) -> GloveFrame:
        """Returns the hand at `time`, s."""
        recording = self._recording
        place = recording.t[0] + time % self._period
        i = min(int(np.searchsorted(recording.t, place)), len(recording.t) - 1)
        p_HK = recording.p_HK[i].astype(float) if recording.valid[i] else None
        X_WH = np.array([1.0, *np.zeros(6)]) if recording.X_WH is None else recording.X_WH[i]
        return GloveFrame(recording.side, time, p_HK, X_WH)

"""The hands of a page as glove frames: seen by a camera or a headset, moved by the mouse, or recorded."""

import math

import numpy as np

from geort_drake.errors import LiveError
from geort_drake.live.messages import GloveFrame, frame_of_points
from geort_drake.live.web.messages import Camera, Headset, Pointer
from geort_drake.people.formats import KEYPOINTS_OF_25
from geort_drake.people.keypoints import FINGER_KEYPOINTS, FINGER_NAMES, WRIST, bone_lengths
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand

# The camera's angle of view along the picture's longer side; laptops and phones have 60° to 75°.
_VIEW_RAD = math.radians(66.0)
_MIN_DISTANCE_M, _MAX_DISTANCE_M = 0.05, 5.0  # of the hand from the camera
_MIN_BONE_M = 1e-3  # least length of a bone
# One Euro filter: the jitter of a resting hand disappears, and a pinch at 0.3 m/s lags by 20 ms.
_CUTOFF_HZ, _SLOPE = 2.0, 20.0  # at rest; and its growth with speed, Hz per m/s
_SPEED_CUTOFF_HZ = 1.0  # of the low-pass on the speed; the paper's value
_STRAIGHT = (WRIST, *FINGER_KEYPOINTS["middle"])

# A person at a desk faces the camera C (x right in the picture, y down, z away from the camera); reaching
# towards the camera moves the robot forward.
_R_WC = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# A headset's space S has y up and looks along -z.
_R_WS = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

# Reach of the wrist from the middle to each edge, m: forward, left, up.
_REACH_M = np.array([0.25, 0.3, 0.25])
_WRIST_SPEED, _GRIP_SPEED = 0.6, 1.6  # m/s; closings per second
# Fingers point forward and the palm faces down, as over a table: H is W turned by 90° about y.
_Q_WH = np.array([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])
_PAD_M = 0.0005  # depth of a keypoint under the pad's skin
# Degrees of abduction and three flexions, from the thumb to the little finger: a hand that is about to grasp.
_OPEN = np.radians([[35, -5, 5, 5], [2, 20, 25, 15], [0, 20, 25, 15], [-2, 20, 25, 15], [-4, 20, 25, 15]])


class HandReader:
    """Reads one person's hands.

    Args:
        side: "right" or "left".
        hand_length: distance from wrist to straight middle fingertip, m; None keeps the device's scale.
    """

    def __init__(self, side: str, hand_length: float | None = None):
        self._side, self._length = side, hand_length
        self._filter = OneEuroFilter()

    def read(self, message: Camera | Headset) -> GloveFrame:
        """Returns the frame of a hand.

        Raises:
            LiveError: the joints are no hand, or not where a camera sees one.
        """
        if isinstance(message, Headset):
            p_SK = self._scale(np.array(message.joints)[KEYPOINTS_OF_25,])
            return self._frame(p_SK @ _R_WS.T, message.t)
        world = self._scale(np.array(message.world))
        p_CM = hand_translation(world, np.array(message.image), message.aspect)
        filtered = self._filter(message.t, np.vstack([world, p_CM]))
        return self._frame((filtered[:-1] + filtered[-1]) @ _R_WC.T, message.t)

    def lost(self, time: float) -> GloveFrame:
        """Returns the frame of a lost hand, and resets the filter."""
        self._filter.reset()
        return GloveFrame(self._side, time)

    def _frame(self, p_WK: np.ndarray, time: float) -> GloveFrame:
        if bone_lengths(p_WK).min() < _MIN_BONE_M:
            raise LiveError("hand: two joints of a bone coincide")
        return frame_of_points(p_WK, self._side, time)

    def _scale(self, points: np.ndarray) -> np.ndarray:
        """Scales points (21, 3), m, about the wrist to the person's hand length, if it is known."""
        if self._length is None:
            return points
        length = float(np.linalg.norm(np.diff(points[_STRAIGHT,], axis=0), axis=1).sum())
        if length < _MIN_BONE_M:
            raise LiveError("hand: wrist and middle finger coincide")
        wrist = points[WRIST]
        return wrist + (points - wrist) * (self._length / length)


def hand_translation(world: np.ndarray, image: np.ndarray, aspect: float) -> np.ndarray:
    """Computes the origin of the world landmarks in a pinhole camera's frame, by least squares.

    With u, v from the picture's middle in units of the focal length, a landmark (x, y, z) at the translation
    (a, b, c) projects to u = (x + a) / (z + c), v = (y + b) / (z + c), which is linear in a, b, c.

    Args:
        world: (21, 3) p_MK, m, in axes parallel to C.
        image: (21, 2) as fractions of the picture's width and height.
        aspect: the picture's width divided by its height.

    Returns:
        p_CM, (3,), m.

    Raises:
        LiveError: the hand would be behind the camera, too near or too far.
    """
    focal = 0.5 * max(aspect, 1.0) / math.tan(0.5 * _VIEW_RAD)  # in units of the picture's height
    u, v = ((image - 0.5) * [aspect, 1.0] / focal).T
    one, zero = np.ones_like(u), np.zeros_like(u)
    A = np.vstack([np.stack([one, zero, -u], axis=1), np.stack([zero, one, -v], axis=1)])
    b = np.concatenate([u * world[:, 2] - world[:, 0], v * world[:, 2] - world[:, 1]])
    p_CM = np.linalg.lstsq(A, b)[0]
    if not _MIN_DISTANCE_M <= p_CM[2] <= _MAX_DISTANCE_M:
        raise LiveError(
            f"the hand is {p_CM[2]:.2f} m from the camera; hold it {_MIN_DISTANCE_M} to {_MAX_DISTANCE_M} m "
            "away"
        )
    return p_CM


class OneEuroFilter:
    """The One Euro filter: smooths slow motion and follows fast motion.

    Each point's cutoff grows with its speed. Source: G. Casiez, N. Roussel, D. Vogel, "1 € Filter: A Simple
    Speed-based Low-pass Filter for Noisy Input in Interactive Systems", CHI 2012,
    https://doi.org/10.1145/2207676.2208639
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets all points."""
        self._time: float | None = None

    def __call__(self, time: float, p: np.ndarray) -> np.ndarray:
        """Returns filtered points p (n, 3), m; resets the filter unless `time`, s, is later than the last."""
        if self._time is None or time <= self._time:
            self._p, self._v = p, np.zeros_like(p)
        else:
            step = time - self._time
            self._v = self._v + _weight(np.array(_SPEED_CUTOFF_HZ), step) * ((p - self._p) / step - self._v)
            speed = np.linalg.norm(self._v, axis=-1, keepdims=True)
            cutoff = _CUTOFF_HZ + _SLOPE * speed
            self._p = self._p + _weight(cutoff, step) * (p - self._p)
        self._time = time
        return self._p


def _weight(cutoff: np.ndarray, step: float) -> np.ndarray:
    """Returns the weight of a new value in a first-order low-pass."""
    return 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff * step))


class PointerHand:
    """A hand whose wrist follows the mouse, and which closes a grip smoothly while a button is held."""

    def __init__(self) -> None:
        self._hand = HumanHand.anatomical()
        self._open = np.clip(_OPEN.ravel(), self._hand.lower, self._hand.upper)
        self._closed = {name: self._close([name]) for name in FINGER_NAMES[1:]} | {
            "hand": self._close(FINGER_NAMES[1:])
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
        p_HK = self._hand.keypoints(self._theta)
        return GloveFrame(side, pointer.t, p_HK, np.concatenate([_Q_WH, self._p_WH]))

    def _close(self, fingers: list[str] | tuple[str, ...]) -> np.ndarray:
        """Returns joint angles (20,), rad, at which the thumb's pad meets those of the fingers."""
        tips = self._hand.fingertips(self._open)
        chosen = [FINGER_NAMES.index(name) for name in fingers]
        meeting = 0.5 * (tips[0] + tips[chosen].mean(axis=0))
        targets, weights = tips.copy(), np.zeros(5)
        direction = tips[chosen].mean(axis=0) - tips[0]
        direction *= _PAD_M / np.linalg.norm(direction)
        targets[0], weights[0] = meeting - direction, 1.0
        for finger in chosen:
            # Fingers close side by side, each in its own plane.
            sideways = np.array([0.0, tips[finger, 1] - tips[chosen].mean(axis=0)[1], 0.0])
            targets[finger], weights[finger] = meeting + direction + sideways, 1.0
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

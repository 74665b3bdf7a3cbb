"""Converts hands from the page, seen by a camera or a headset, to glove frames."""

import math

import numpy as np

from geort_drake.errors import LiveError
from geort_drake.live.messages import GloveFrame, frame_of_points
from geort_drake.live.web.messages import Camera, Headset
from geort_drake.live.web.one_euro import OneEuroFilter
from geort_drake.people.formats import KEYPOINTS_OF_25
from geort_drake.people.keypoints import FINGER_KEYPOINTS, WRIST, bone_lengths

# The camera's angle of view along the picture's longer side; laptops and phones have 60° to 75°.
_VIEW_RAD = math.radians(66.0)
_MIN_DISTANCE_M, _MAX_DISTANCE_M = 0.05, 5.0  # of the hand from the camera
_MIN_BONE_M = 1e-3  # least length of a bone
# One Euro filter: the jitter of a resting hand disappears, and a pinch at 0.3 m/s lags by 20 ms.
_CUTOFF_HZ, _SLOPE = 2.0, 20.0
_STRAIGHT = (WRIST, *FINGER_KEYPOINTS["middle"])

# A person at a desk faces the camera C (x right in the picture, y down, z away from the camera); reaching
# towards the camera moves the robot forward.
_R_WC = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# A headset's space S has y up and looks along -z.
_R_WS = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


class HandReader:
    """Reads one person's hands.

    Args:
        side: "right" or "left".
        hand_length: distance from wrist to straight middle fingertip, m; None keeps the device's scale.
    """

    def __init__(self, side: str, hand_length: float | None = None):
        self._side, self._length = side, hand_length
        self._filter = OneEuroFilter(_CUTOFF_HZ, _SLOPE)

    @property
    def delay(self) -> float:
        """Mean delay of the filter at the last hand, s."""
        return self._filter.delay

    def read(self, message: Camera | Headset) -> GloveFrame:
        """Returns the frame of a hand.

        Raises:
            LiveError: the joints are no hand, or not where a camera sees one.
        """
        if isinstance(message, Headset):
            p_SK = self._scaled(np.array(message.joints)[KEYPOINTS_OF_25,])
            return self._frame(p_SK @ _R_WS.T, message.t)
        world = self._scaled(np.array(message.world))
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

    def _scaled(self, points: np.ndarray) -> np.ndarray:
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
            f"hand: {p_CM[2]:.2f} m from the camera; {_MIN_DISTANCE_M} to {_MAX_DISTANCE_M} m are read"
        )
    return p_CM

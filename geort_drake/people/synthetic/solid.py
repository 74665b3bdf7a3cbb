"""Keeps the digits of a human hand from passing through one another.

Thumb and fingers are capsules about their bones. All radii are assumptions. That of the index finger's first
bone, 7.9 mm, is half of a thickness of 17.5 mm at the PIP, less 0.8 mm by which skin yields before one feels
a force. By the same rule, the thumb's 8.6 mm stand for 18.8 mm at the IP joint. The other radii decrease
towards the tips. The thicknesses were chosen with the hand tables of Pheasant & Haslegrave (Bodyspace, 2006)
in mind and have not been checked against them. Radii scale with hand breadth, which explains 6 to 74 % of the
variance of the depth of a segment (Buchholz & Armstrong 1991, "An ellipsoidal representation of human hand
anthropometry", Hum. Factors 33:429). Two digits may interpenetrate by 2 mm, a millimetre of flesh each
(assumption; Serina et al. 1997, J. Biomech. 30:1035, measure how pulps yield to a force).

The fingertip keypoint of gloves and cameras is a point of the skin between the very tip and the middle of the
pad, where two digits meet in a pinch: the outward normal there is 30° from the bone (assumption). All other
keypoints are joints, on the axes of the capsules. Neighbouring fingers share a web, so the capsule of the
first bone begins at its middle. The thumb's metacarpal has no capsule, for it lies in the palm.

Gloves misplace the base of the thumb by several millimetres (see `device`). After a shift of the thumb by
(2.7, 5.0, −4.5) mm in GeoRT's recording and (−3.4, 7.0, −1.1) mm in that of MANUS subject 000, fitted to this
model, digits interpenetrate by at most 2 mm in 99 % of the frames of both (`tests/test_people_solid.py`).
"""

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from geort_drake.people.synthetic.hand import BEND_RATIO, HumanHand, bone_directions, joint_angles

MAX_INTERPENETRATION = 2e-3  # m
# Pairs of digits, thumb 0 to little finger 4; those with the thumb come first.
DIGIT_PAIRS = tuple(combinations(range(5), 2))

# Radii, m, about the first, middle and last bone of a hand of average breadth, a row per digit.
_RADII = 1e-3 * np.array(
    [[0.0, 8.6, 6.6], [7.9, 6.9, 5.7], [7.9, 6.9, 5.7], [7.6, 6.7, 5.4], [6.9, 6.0, 5.0]]
)
_TIP_ANGLE = np.deg2rad(30.0)  # between the last bone and the outward normal at the tip's keypoint
_FIT = 0.43  # largest ratio of a finger's radius to the distance of its knuckle from the next one
_WEB = 0.5  # part of a finger's first bone that lies in the web

_STEP_M = 4e-3  # points at which a path is checked are at most this far apart, less than a digit's thickness
_AT_REST_M = 1e-3  # least progress of a step after which a pressing hand tries another one
_AIM_M = 1.5e-3  # depth to which a posture that interpenetrates is corrected
_DAMPING = (1e-3) ** 2  # corrections are damped where a radian moves less than 1 mm
# Coefficient between skin and skin (assumption); it is 0.9 between finger pads and rubber, on average (Seo et
# al. 2009, Ergonomics 52:609).
_FRICTION = 1.0
_CORRECTIONS, _SEPARATIONS = 4, 20  # iterations

# Capsules are numbered 3 · digit + bone. All pairs of capsules of two digits, in the order of `DIGIT_PAIRS`;
# the thumb's metacarpal has no capsule.
_FIRST, _SECOND = np.array(
    [(3 * i + a, 3 * j + b) for i, j in DIGIT_PAIRS for a in range(i == 0, 3) for b in range(3)]
).T
_PAIR_BOUNDS = np.append(np.flatnonzero(np.diff(5 * (_FIRST // 3) + _SECOND // 3, prepend=-1)), len(_FIRST))


class SolidHand:
    """A human hand whose digits do not pass through one another.

    Attributes:
        hand: its joints and bones.
        radii: (5, 3) radii of the capsules about each digit's bones, m.
    """

    def __init__(self, hand: HumanHand):
        self.hand = hand
        average = HumanHand.anatomical().p_HB
        breadth = np.linalg.norm(hand.p_HB[1] - hand.p_HB[4]) / np.linalg.norm(average[1] - average[4])
        # Closed fingers fit between their knuckles, also where a device shows two knuckles too close.
        gaps = np.linalg.norm(np.diff(hand.p_HB[1:], axis=0), axis=1)
        gap = np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps))
        scale = np.append(breadth, np.minimum(breadth, _FIT * gap / _RADII[1:, 0]))
        self.radii = scale[:, None] * _RADII
        self._touching_distance = self.radii.ravel()[_FIRST] + self.radii.ravel()[_SECOND]
        self._R_BH = hand.R_HB.transpose(0, 2, 1)
        # End of the last capsule's axis relative to the DIP, along the bone and towards the palm.
        self._end = (
            (hand.lengths[:, 2] - np.cos(_TIP_ANGLE) * self.radii[:, 2])[:, None],
            (-np.sin(_TIP_ANGLE) * self.radii[:, 2])[:, None],
        )
        # (5, 20) bounds of each digit's motion, m/rad, by the joints.
        to_tip = np.cumsum(hand.lengths[:, ::-1], axis=1)[:, ::-1]
        self._reach = np.kron(np.eye(5), np.ones(4)) * to_tip[:, [0, 0, 1, 2]].ravel()

    def depths(self, theta: np.ndarray) -> np.ndarray:
        """Computes how deep the digits interpenetrate at joint angles theta (..., 20), rad.

        Returns:
            Depths (..., 10), m, by `DIGIT_PAIRS`; the negative distance where two digits are apart.
        """
        return self._proximity(theta).pair_depths()

    def keypoint_depths(self, p_HK: np.ndarray) -> np.ndarray:
        """Computes depths (..., 10), m, as `depths` does, from this hand's keypoints p_HK (..., 21, 3), m."""
        directions = bone_directions(p_HK)
        theta = joint_angles(directions, self.hand.R_HB, self.hand.twist)
        x, _, z, bend = self.hand.first_bone(theta)
        palmar = np.cos(bend[..., 1, None]) * x - np.sin(bend[..., 1, None]) * z
        palmar = (self.hand.R_HB @ palmar[..., None])[..., 0]
        chain = np.array(p_HK[..., 1:, :], dtype=float).reshape(*p_HK.shape[:-2], 5, 4, 3)
        outward = np.cos(_TIP_ANGLE) * directions[..., 2, :] + np.sin(_TIP_ANGLE) * palmar
        chain[..., 3, :] -= self.radii[:, 2:] * outward
        chain[..., 0, :] += _WEB * (chain[..., 1, :] - chain[..., 0, :])
        return _Proximity.between(*_ends(chain), self._touching_distance).pair_depths()

    def move(self, theta: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Moves the hand towards a posture until digits touch; they slide along each other unless pressed.

        Args:
            theta: (20,) present joint angles, rad, which interpenetrate by at most `MAX_INTERPENETRATION`.
            target: (20,) joint angles to reach, rad.

        Returns:
            The reached joint angles (20,), rad, and which digits touch another one, (5,) bool. If nothing is
            in the way, the angles are `target` itself. Where digits meet on the way, they slide on if
            they move along each other by more than into each other, or else stop; the others go on.
        """
        steps_left = math.ceil((self._reach @ np.abs(target - theta)).max() / _STEP_M)
        while True:
            change = target - theta
            steps = max(1, math.ceil((self._reach @ np.abs(change)).max() / _STEP_M))
            path = theta + np.arange(steps + 1)[:, None] / steps * change
            path[-1] = target
            proximities = self._proximity(path[1:])
            blocked = proximities.pair_depths().max(axis=1) > MAX_INTERPENETRATION
            if not blocked.any():
                return path[-1], proximities.at(-1).touching()
            last_free = int(np.argmax(blocked))
            proximity = proximities.at(last_free)
            start, (theta, touching) = theta, self._stop(path[last_free], path[last_free + 1], proximity)
            steps_left -= last_free + 1
            if steps_left <= 0 or (self._reach @ np.abs(theta - start)).max() < _AT_REST_M:
                return theta, touching
            target = np.where(np.repeat(self._pressed(theta, target), 4), theta, target)

    def separate(self, theta: np.ndarray) -> np.ndarray:
        """Returns the posture (20,), rad, near theta (20,) in which no digits interpenetrate.

        It is theta itself if none do. Digits move apart by the shortest way, which may lead through one
        another. Where joint limits leave no way, the result interpenetrates by more than
        `MAX_INTERPENETRATION`, but no more than theta does.
        """
        smallest, best = math.inf, theta
        for _ in range(_SEPARATIONS):
            proximity = self._proximity(theta)
            depth = proximity.depth.max()
            if depth < smallest:
                smallest, best = depth, theta
            if depth <= MAX_INTERPENETRATION:
                break
            theta = self._correct(theta, proximity)
        return best

    def _stop(
        self, free: np.ndarray, theta: np.ndarray, proximity: "_Proximity"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns a posture near theta (20,) in which digits touch, and which; `free` is just before it."""
        friction: tuple[np.ndarray, np.ndarray] | None = self._capsules(free)
        for _ in range(_CORRECTIONS):
            theta = self._correct(theta, proximity, friction)
            proximity = self._proximity(theta)
            if proximity.depth.max() <= MAX_INTERPENETRATION:
                return theta, proximity.touching()
            friction = None
        # Where joint limits or several digits leave no common way out, one digit after another goes on as far
        # as it can. Those that the thumb was wedged between can so leave it.
        posture = free.copy()
        limit = max(MAX_INTERPENETRATION, self.depths(free).max())
        for digit in range(5):
            joints = slice(4 * digit, 4 * digit + 4)
            path = np.tile(posture, (9, 1))
            path[:, joints] += np.linspace(1.0, 0.0, 9)[:, None] * (theta - posture)[joints]
            passable = self.depths(path[:-1]).max(axis=1) <= limit
            posture = path[int(np.argmax(np.append(passable, True)))]
        return posture, self._proximity(posture).touching()

    def _pressed(self, theta: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Returns which digits (5,) touch another one, and would stick to it on their way to `target` (20,).

        Skin sticks where the way, linearised, leads into the other digit by more than along it.
        """
        proximity = self._proximity(theta)
        contacts, is_pressed = proximity.deepest(0.0), np.zeros(5, bool)
        change = (target - theta).reshape(5, 4)[:, :3].ravel()
        way = self._contact_jacobian(theta, proximity, contacts) @ change
        normal = proximity.normals(contacts)
        into = -np.sum(way * normal, axis=1)
        along = np.linalg.norm(way + into[:, None] * normal, axis=1)
        stuck = np.array(contacts, dtype=int)[_FRICTION * into > along]
        is_pressed[_FIRST[stuck] // 3] = is_pressed[_SECOND[stuck] // 3] = True
        return is_pressed

    def _correct(
        self,
        theta: np.ndarray,
        proximity: "_Proximity",
        free_ends: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Returns theta (20,) after the least joint motion that brings all depths to `_AIM_M`, linearised.

        With the capsules' `free_ends` before the motion, friction also holds skin on skin as it is pressed.
        """
        contacts = proximity.deepest(_AIM_M)
        separation, normal = proximity.separation(contacts), proximity.normals(contacts)
        J = self._contact_jacobian(theta, proximity, contacts)
        push = proximity.depth[contacts] - _AIM_M
        if free_ends is None:
            J, correction = (normal[:, None] @ J)[:, 0], push
        else:
            slip = separation - proximity._replace(start=free_ends[0], end=free_ends[1]).separation(contacts)
            slip -= np.sum(slip * normal, axis=1, keepdims=True) * normal
            distance = np.maximum(np.sqrt(np.sum(slip**2, axis=1)), 1e-9)
            friction = np.minimum(1.0, _FRICTION * push / distance)[:, None] * slip
            J, correction = J.reshape(-1, 15), (push[:, None] * normal - friction).ravel()
        change = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(len(J)), correction)
        change = change.reshape(5, 3)
        theta = theta + np.column_stack([change, BEND_RATIO * change[:, 2]]).ravel()
        return np.minimum(np.maximum(theta, self.hand.lower), self.hand.upper)

    def _proximity(self, theta: np.ndarray) -> "_Proximity":
        return _Proximity.between(*self._capsules(theta), self._touching_distance)

    def _capsules(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns both ends (..., 15, 3), m, in H, of the capsules' axes."""
        x, _, z, bend = self.hand.first_bone(theta)
        c, s = np.cos(bend)[..., None], np.sin(bend)[..., None]
        c1, c2, s1, s2 = c[..., 0, :], c[..., 1, :], s[..., 0, :], s[..., 1, :]
        along, across = self._end
        chain = np.empty((*z.shape[:-1], 4, 3))
        chain[..., 1, :] = self.hand.lengths[:, :1] * z
        chain[..., 0, :] = _WEB * chain[..., 1, :]
        chain[..., 2, :] = chain[..., 1, :] + self.hand.lengths[:, 1:2] * (c1 * z + s1 * x)
        chain[..., 3, :] = chain[..., 2, :] + (along * c2 - across * s2) * z + (along * s2 + across * c2) * x
        return _ends(chain @ self._R_BH + self.hand.p_HB[:, None])

    def _contact_jacobian(
        self, theta: np.ndarray, proximity: "_Proximity", contacts: Sequence[int]
    ) -> np.ndarray:
        """Returns ∂p/∂x (n, 3, 15), m/rad, of the first capsule's closest point p relative to the second's.

        x are abduction, flexion and bend of each digit, as in `FingerMotion`.
        """
        _, y, _, _ = self.hand.first_bone(theta)
        x = np.zeros((5, 3))
        x[:, 0], x[:, 2] = np.cos(theta[1::4]), -np.sin(theta[1::4])
        axes = np.empty((5, 3, 3))
        axes[:, 0], axes[:, 1] = -x, (0.0, 1.0, 0.0)
        axes[:, 2] = np.cos(self.hand.twist)[:, None] * y - np.sin(self.hand.twist)[:, None] * x
        axes = axes @ self._R_BH
        J = np.zeros((len(contacts), 5, 3, 3))
        for motion, contact in zip(J, contacts, strict=True):
            for points, pair, sign in ((proximity.s, _FIRST, 1.0), (proximity.t, _SECOND, -1.0)):
                start, end = proximity.start[pair[contact]], proximity.end[pair[contact]]
                p = start + points[contact] * (end - start)
                digit, bone = divmod(int(pair[contact]), 3)
                motion[digit, :2] = axes[digit, :2] @ _cross_matrix(sign * (p - self.hand.p_HB[digit]))
                if bone:
                    arm = p - proximity.end[3 * digit]
                    if bone == 2:
                        arm = arm + BEND_RATIO[digit] * (p - proximity.end[3 * digit + 1])
                    motion[digit, 2] = axes[digit, 2] @ _cross_matrix(sign * arm)
        return J.reshape(len(contacts), 15, 3).transpose(0, 2, 1)


class _Proximity(NamedTuple):
    """Capsules and how near all pairs of them are.

    Attributes:
        start, end: (..., 15, 3) ends of the capsules' axes, m.
        s, t: (..., n) closest point of the pair's first and second axis, from 0 at its start to 1.
        depth: (..., n) depth to which the two interpenetrate, m; negative where they are apart.
    """

    start: np.ndarray
    end: np.ndarray
    s: np.ndarray
    t: np.ndarray
    depth: np.ndarray

    @classmethod
    def between(cls, start: np.ndarray, end: np.ndarray, touching_distance: np.ndarray) -> "_Proximity":
        """Returns how near all pairs of capsules are that touch at these distances (n,) of their axes, m."""
        # Ericson, Real-Time Collision Detection (2005), section 5.1.9.
        along = end - start
        squared = np.einsum("...i,...i", along, along)
        u, v = along[..., _FIRST, :], along[..., _SECOND, :]
        w = start[..., _FIRST, :] - start[..., _SECOND, :]
        a, e = squared[..., _FIRST], squared[..., _SECOND]
        b, c, f = (np.einsum("...i,...i", *pair) for pair in ((u, v), (u, w), (v, w)))
        s = np.minimum(np.maximum((b * f - c * e) / np.maximum(a * e - b * b, 1e-6 * a * e), 0.0), 1.0)
        t = np.minimum(np.maximum((b * s + f) / e, 0.0), 1.0)
        s = np.minimum(np.maximum((b * t - c) / a, 0.0), 1.0)
        separation = w + s[..., None] * u - t[..., None] * v
        return cls(
            start, end, s, t, touching_distance - np.sqrt(np.einsum("...i,...i", separation, separation))
        )

    def at(self, number: int) -> "_Proximity":
        """Returns one of several postures' proximities."""
        return _Proximity(*(values[number] for values in self))

    def pair_depths(self) -> np.ndarray:
        """Returns the deepest depth (..., 10), m, of each pair of digits."""
        return np.maximum.reduceat(self.depth, _PAIR_BOUNDS[:-1], axis=-1)

    def deepest(self, depth: float) -> list[int]:
        """Returns the deepest pair of capsules of all two digits that interpenetrate by more than `depth`."""
        pairs = [start + int(np.argmax(self.depth[start:end])) for start, end in pairwise(_PAIR_BOUNDS)]
        return [pair for pair in pairs if self.depth[pair] > depth]

    def separation(self, contacts: Sequence[int]) -> np.ndarray:
        """Returns vectors (n, 3), m, from the second to the first capsule's closest point, of some pairs."""
        first, second = _FIRST[contacts], _SECOND[contacts]
        p_first = self.start[first] + self.s[contacts, None] * (self.end[first] - self.start[first])
        p_second = self.start[second] + self.t[contacts, None] * (self.end[second] - self.start[second])
        return p_first - p_second

    def normals(self, contacts: Sequence[int]) -> np.ndarray:
        """Returns the directions (n, 3) of `separation`."""
        separation = self.separation(contacts)
        return separation / np.maximum(np.sqrt(np.sum(separation**2, axis=1, keepdims=True)), 1e-9)

    def touching(self) -> np.ndarray:
        """Returns which digits (5,) touch another one."""
        touching = np.zeros(5, bool)
        contacts = self.depth > 0
        touching[_FIRST[contacts] // 3] = touching[_SECOND[contacts] // 3] = True
        return touching


def _ends(chain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns starts and ends (..., 15, 3) of the segments of chains (..., 5, 4, 3)."""
    shape = (*chain.shape[:-3], 15, 3)
    return chain[..., :3, :].reshape(shape), chain[..., 1:, :].reshape(shape)


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    """Returns the matrix (3, 3) with a × v = a @ matrix."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

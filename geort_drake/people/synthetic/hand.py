"""Kinematic model of a human hand: 20 joints, four per finger, with forward and inverse kinematics.

All fingers, including the thumb, are the same chain. Its base frame B sits in the palm with z along the
straight finger and x towards the side to which the finger closes. A universal joint (MCP; the thumb's CMC)
flexes about y of B and then abducts about the rotated −x, as in the ISB's joint coordinate system (Wu et al.
2005, J. Biomech. 38:981). Two parallel hinges follow (PIP and DIP; the thumb's MCP and IP), rotated about
the bone by a fixed twist. A finger thus bends in a plane, and its forward kinematics has a closed form.
"""

import dataclasses
import json
from collections.abc import Sequence
from importlib.resources import files

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError
from geort_drake.people.checks import require_hand
from geort_drake.people.keypoints import (
    BASE_KEYPOINT,
    FINGER_NAMES,
    KEYPOINT_COUNT,
    bone_lengths,
    wrist_pose,
)
from geort_drake.people.recording import Recording

_JOINT_SUFFIXES = {
    "thumb": ("cmc_abduction", "cmc_flexion", "mcp_flexion", "ip_flexion"),
    **dict.fromkeys(FINGER_NAMES[1:], ("mcp_abduction", "mcp_flexion", "pip_flexion", "dip_flexion")),
}

# Bend of the outermost joint relative to that of the joint before it: two thirds in fingers (textbook; 0.4 to
# 0.85 in recorded play), one in the thumb (recorded play).
BEND_RATIO = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 2 / 3])

_MAX_STEP = 0.4  # rad per iteration of the inverse kinematics
_DAMPING_M = 2e-3  # steps are damped where a radian moves the tip by less than this

# The straight thumb points 25° from z towards y; it flexes across the palm (−y) about +x.
_THUMB_AZIMUTH = np.deg2rad(25.0)

# Anatomy of an adult, a row per finger from thumb to little.
#
# Bases: y and z from An et al. 1979 and Buchholz et al. 1992 (Ergonomics 35:261), relative to hand breadth
# and length; x and the thumb's CMC are means of two calibrated MANUS gloves.
_BASE_BREADTH = np.array([[0.167, 0.240], [0.043, 0.252], [0.0, 0.0], [0.043, -0.206], [0.097, -0.402]])
_BASE_LENGTH = np.array([0.101, 0.447, 0.446, 0.409, 0.368])
# Bones relative to hand length: Buchholz et al. 1992. The last ones end at the skin: the middle finger's base
# and bones add up to one.
_BONE_LENGTH = np.array(
    [
        [0.251, 0.196, 0.158],
        [0.265, 0.143, 0.097],
        [0.277, 0.170, 0.108],
        [0.259, 0.165, 0.107],
        [0.206, 0.117, 0.093],
    ]
)
# Convergence of the fingers' bending planes towards the thumb, and pronation of the thumb: rounded means of
# fits to two glove recordings (GeoRT's and MANUS).
_CONVERGENCE_DEG = np.array([0.0, 3.0, 6.0, 9.0, 9.0])
_THUMB_TWIST_DEG = 10.0
# Limits, deg, as (lower, upper) of abduction and three flexions. Flexions and the thumb: clinical norms,
# limited to active motion, with 30° of MCP hyperextension and slight hyperextension of the DIP. Finger
# abduction: ranges of a MANUS recording (0.5th to 99.5th percentile), which exceed clinical spreads of
# straight fingers.
_LIMITS_DEG = np.array(
    [
        [(-10, 60), (-25, 35), (-10, 60), (-15, 80)],
        [(-20, 20), (-30, 90), (0, 100), (-10, 80)],
        [(-20, 20), (-30, 90), (0, 100), (-10, 80)],
        [(-22, 22), (-30, 90), (0, 100), (-10, 80)],
        [(-35, 22), (-30, 90), (0, 100), (-10, 80)],
    ]
)


@dataclasses.dataclass(frozen=True, eq=False)
class HumanHand:
    """Geometry and joint limits of one human hand. A left hand is represented by its mirror image.

    Joints are ordered by finger from the thumb, each with abduction and three flexions (`joint_names`).
    Abduction is positive towards the index side (+y), for the thumb away from the palm (+x). Flexion is
    positive as the finger bends. Angles are in rad, lengths in m, points in the wrist frame H.

    Attributes:
        p_HB: (5, 3) the fingers' base points (thumb CMC, the other fingers' MCP).
        R_HB: (5, 3, 3) orientations of the fingers' base frames.
        twist: (5,) rotation of the hinge axes about the first bone.
        lengths: (5, 3) lengths of each finger's three bones, the last up to the tip of the pulp.
        lower, upper: (20,) joint limits.
    """

    p_HB: np.ndarray
    R_HB: np.ndarray
    twist: np.ndarray
    lengths: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    joint_names = tuple(f"{finger}_{suffix}" for finger in FINGER_NAMES for suffix in _JOINT_SUFFIXES[finger])

    def keypoints(self, theta: np.ndarray) -> np.ndarray:
        """Computes keypoints p_HK (..., 21, 3), m, at joint angles theta (..., 20), rad."""
        theta = np.asarray(theta, dtype=float)
        x, _, z, bend = self.first_bone(theta)
        L = self.lengths
        c, s = np.cos(bend), np.sin(bend)
        p = np.zeros((*theta.shape[:-1], KEYPOINT_COUNT, 3))
        chain = np.zeros((*z.shape[:-1], 4, 3))
        chain[..., 1, :] = L[:, :1] * z
        for i in (0, 1):
            along, across = L[:, i + 1] * c[..., i], L[:, i + 1] * s[..., i]
            chain[..., i + 2, :] = chain[..., i + 1, :] + along[..., None] * z + across[..., None] * x
        p_HK = chain @ self.R_HB.transpose(0, 2, 1) + self.p_HB[:, None]
        p[..., 1:, :] = p_HK.reshape(*p_HK.shape[:-3], 20, 3)
        return p

    def in_wrist_frame(self) -> "HumanHand":
        """Returns the hand in the frame H of its own wrist and knuckles; anatomical variation turns it."""
        R_DH, p_DH = wrist_pose(self.keypoints(np.zeros(20)))
        R_HD = R_DH.T
        return dataclasses.replace(self, p_HB=(self.p_HB - p_DH) @ R_DH, R_HB=R_HD @ self.R_HB)

    def fingertips(self, theta: np.ndarray) -> np.ndarray:
        """Computes fingertips p_HF (..., 5, 3), m, thumb to little, at joint angles theta (..., 20), rad."""
        x, _, z, bend = self.first_bone(np.asarray(theta, dtype=float))
        along, across = self._in_plane(bend)
        p_BF = along[..., None] * z + across[..., None] * x
        return (self.R_HB @ p_BF[..., None])[..., 0] + self.p_HB

    def fingertip_jacobians(self, theta: np.ndarray) -> np.ndarray:
        """Computes ∂p_HF/∂θ (..., 5, 3, 4), m/rad: each tip's by the four joints of its finger."""
        theta = np.asarray(theta, dtype=float)
        x, y, z, bend = self.first_bone(theta)
        along, across = self._in_plane(bend)
        tip = along[..., None] * z + across[..., None] * x
        last = self.lengths[:, 2] * np.array([np.cos(bend[..., 1]), np.sin(bend[..., 1])])
        J = np.empty((*tip.shape, 4))
        # Flexion rotates about y of the base frame, abduction rotates z towards y; the hinges rotate
        # z towards x.
        J[..., 0] = along[..., None] * y - (across * np.sin(self.twist))[..., None] * z
        J[..., 0, 1], J[..., 1, 1], J[..., 2, 1] = tip[..., 2], 0.0, -tip[..., 0]
        J[..., 2] = -across[..., None] * z + (along - self.lengths[:, 0])[..., None] * x
        J[..., 3] = -last[1][..., None] * z + last[0][..., None] * x
        return self.R_HB @ J

    def solve_fingertips(
        self,
        p_target: np.ndarray,
        theta0: np.ndarray,
        weights: Sequence[float] | np.ndarray | None = None,
        iterations: int = 20,
    ) -> np.ndarray:
        """Finds joint angles (..., 20) within the limits that bring the tips nearest p_target (..., 5, 3), m.

        Solves each finger by damped least squares with fixed damping; redundant motion stays as in theta0.

        Args:
            p_target: targets of the tips in H, m.
            theta0: (..., 20) initial angles, rad.
            weights: (5,) weight of each target; a finger of weight 0 stays at theta0.
            iterations: number of steps.
        """
        theta = np.clip(np.asarray(theta0, dtype=float), self.lower, self.upper)
        weight = np.ones(5) if weights is None else np.asarray(weights, dtype=float)
        lower, upper = self.lower.reshape(5, 4), self.upper.reshape(5, 4)
        damping = _DAMPING_M**2 * np.eye(3)
        for _ in range(iterations):
            error = weight[:, None] * (p_target - self.fingertips(theta))
            J = weight[:, None, None] * self.fingertip_jacobians(theta)
            angles = theta.reshape(*theta.shape[:-1], 5, 4)
            free = np.ones_like(angles)
            # A joint that would leave its range is fixed, and the others compensate.
            for _ in range(2):
                Jf = J * free[..., None, :]
                Jt = np.swapaxes(Jf, -1, -2)
                step = (Jt @ np.linalg.solve(Jf @ Jt + damping, error[..., None]))[..., 0]
                # Far targets and straight fingers give steps for which the linearisation does not hold.
                step /= np.maximum(np.abs(step).max(axis=-1, keepdims=True) / _MAX_STEP, 1.0)
                trial = angles + step
                free = free * ((trial >= lower) & (trial <= upper))
            theta = np.clip(trial, lower, upper).reshape(theta.shape)
        return theta

    @classmethod
    def anatomical(cls, length_m: float = 0.19, breadth_m: float = 0.085) -> "HumanHand":
        """Makes a hand of average adult proportions.

        Args:
            length_m: wrist crease to the tip of the middle finger.
            breadth_m: breadth of the palm across the knuckles of index to little finger.
        """
        convergence = Rotation.from_euler("z", _CONVERGENCE_DEG[:, None], degrees=True).as_matrix()
        return cls(
            p_HB=np.column_stack([breadth_m * _BASE_BREADTH, length_m * _BASE_LENGTH]),
            R_HB=_nominal_base_frames() @ convergence,
            twist=np.deg2rad([_THUMB_TWIST_DEG, 0.0, 0.0, 0.0, 0.0]),
            lengths=length_m * _BONE_LENGTH,
            lower=np.deg2rad(_LIMITS_DEG[..., 0]).reshape(20),
            upper=np.deg2rad(_LIMITS_DEG[..., 1]).reshape(20),
        )

    @classmethod
    def measured_adult(cls) -> "HumanHand":
        """Returns an average adult's hand as it is measured from a recording.

        This is the `fit` to `synthesize_play(seed=0)`, stored because the play takes many seconds and because
        a stored hand has the same last digits on every machine.
        """
        values_of = json.loads(files(__package__).joinpath("adult.json").read_text())
        return cls(**{name: np.array(values) for name, values in values_of.items()})

    @classmethod
    def fit(cls, recording: Recording) -> "HumanHand":
        """Fits a hand to the recorded person.

        Palm and bone lengths are medians over the valid frames. Base frames and twists minimise the recorded
        bones' deviation from their bending planes. Joint limits are the observed ranges (0.5th to 99.5th
        percentile) widened by 2°.

        Raises:
            RecordingError, MismatchError: fewer than ten valid frames, or see `require_hand`.
        """
        p_HK = recording.p_HK[recording.valid].astype(float)
        if len(p_HK) < 10:
            raise RecordingError(f"fitting a hand needs at least 10 valid frames, {len(p_HK)} given")
        require_hand(recording)
        directions = bone_directions(p_HK)
        sample = directions[np.linspace(0, len(p_HK) - 1, min(len(p_HK), 400)).astype(int)]
        frames = [_fit_base_frame(sample[:, i], R) for i, R in enumerate(_nominal_base_frames())]
        R_HB, twist = np.stack([R for R, _ in frames]), np.array([angle for _, angle in frames])
        theta = joint_angles(directions, R_HB, twist)
        margin = np.deg2rad(2.0)
        return cls(
            p_HB=np.median(p_HK[:, list(BASE_KEYPOINT.values())], axis=0),
            R_HB=R_HB,
            twist=twist,
            lengths=np.median(bone_lengths(p_HK), axis=0).reshape(5, 4)[:, 1:],
            lower=np.percentile(theta, 0.5, axis=0) - margin,
            upper=np.percentile(theta, 99.5, axis=0) + margin,
        )

    def with_range_of(self, other: "HumanHand") -> "HumanHand":
        """Returns this hand with joints that also move as far as another's.

        In a recording, a person need not move as far as they can.
        """
        lower, upper = np.minimum(self.lower, other.lower), np.maximum(self.upper, other.upper)
        return dataclasses.replace(self, lower=lower, upper=upper)

    def first_bone(self, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        """Returns the axes of the fingers' first bones, and the bends of the other two.

        Returns:
            Unit vectors x, y and z (..., 5, 3) in B of bending, of abduction and along the first bone; and
            angles (..., 5, 2), rad, of the second and third bone to the first.
        """
        angles = theta.reshape(*theta.shape[:-1], 5, 4)
        x, y, z = bone_axes(angles[..., 0], angles[..., 1], self.twist)
        bend = angles[..., 2:].copy()
        bend[..., 1] += bend[..., 0]
        return x, y, z, bend

    def _in_plane(self, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the tips' coordinates (..., 5), m, along and across the first bone in the bending plane."""
        first, middle, last = self.lengths.T
        c, s = np.cos(bend), np.sin(bend)
        along = first + (middle * c[..., 0] + last * c[..., 1])
        return along, middle * s[..., 0] + last * s[..., 1]


def _nominal_base_frames() -> np.ndarray:
    c, s = np.cos(_THUMB_AZIMUTH), np.sin(_THUMB_AZIMUTH)
    thumb = np.array([[0.0, 1.0, 0.0], [-c, 0.0, s], [s, 0.0, c]])
    return np.stack([thumb, *[np.eye(3)] * 4])


def bone_directions(p_HK: np.ndarray) -> np.ndarray:
    """Returns unit vectors (..., 5, 3, 3) along the three bones of each finger."""
    chain = p_HK[..., 1:, :].reshape(*p_HK.shape[:-2], 5, 4, 3)
    bones = np.diff(chain, axis=-2)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def joint_angles(directions: np.ndarray, R_HB: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Computes joint angles (..., 20), rad, from bone directions (..., 5, 3, 3), projected to the plane."""
    first, middle, last = np.moveaxis(directions @ R_HB, -2, 0)
    abduction = np.arcsin(np.clip(first[..., 1], -1.0, 1.0))
    flexion = np.arctan2(first[..., 0], first[..., 2])
    x, _, _ = bone_axes(abduction, flexion, twist)
    bends = [np.arctan2(np.sum(bone * x, -1), np.sum(bone * first, -1)) for bone in (middle, last)]
    # The last hinge is measured from the middle bone, and wrapped because a fist may pass 180°.
    last_bend = (bends[1] - bends[0] + np.pi) % (2 * np.pi) - np.pi
    theta = np.stack([abduction, flexion, bends[0], last_bend], axis=-1)
    return theta.reshape(*theta.shape[:-2], 20)


def bone_axes(abduction: np.ndarray, flexion: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, ...]:
    """Returns unit vectors (..., 3) in B: direction x of bending, y of abduction, and the first bone z."""
    ca, sa, cf, sf = np.cos(abduction), np.sin(abduction), np.cos(flexion), np.sin(flexion)
    x, y, z = np.empty((3, *ca.shape, 3))
    x[..., 0], x[..., 1], x[..., 2] = cf, 0.0, -sf
    y[..., 0], y[..., 1], y[..., 2] = -sf * sa, ca, -cf * sa
    z[..., 0], z[..., 1], z[..., 2] = sf * ca, sa, cf * ca
    return np.cos(twist)[..., None] * x + np.sin(twist)[..., None] * y, y, z


def _fit_base_frame(directions: np.ndarray, R_nominal: np.ndarray) -> tuple[np.ndarray, float]:
    """Fits the base frame R_HB and twist, rad, in which bone directions (T, 3, 3) best bend in a plane."""

    def frame(parameters: np.ndarray) -> np.ndarray:
        # A rotation about y would only shift the zero of flexion.
        turn = np.array([parameters[0], 0.0, parameters[1]])
        return R_nominal @ Rotation.from_rotvec(turn).as_matrix()

    def out_of_plane(parameters: np.ndarray) -> np.ndarray:
        first, middle, last = np.moveaxis(directions @ frame(parameters), -2, 0)
        x, _, _ = bone_axes(
            np.arcsin(np.clip(first[:, 1], -1, 1)), np.arctan2(first[:, 0], first[:, 2]), parameters[2]
        )
        normal = np.cross(first, x)
        # A weak regularisation towards the nominal frame determines what the recording does not.
        return np.concatenate(
            [np.sum(middle * normal, -1), np.sum(last * normal, -1), 0.3 * np.sqrt(len(first)) * parameters]
        )

    solution = least_squares(out_of_plane, np.zeros(3)).x
    return frame(solution), float(solution[2])

"""The interface of all retargeters: human fingertips in, joint angles of a robot hand out."""

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from safetensors.numpy import save

from geort_drake.errors import FrameError, GeortError, HandError, MapError, UnknownNameError
from geort_drake.files import atomic_path
from geort_drake.people.keypoints import BASE_KEYPOINT, KEYPOINT_COUNT, MIDDLE_MCP, TIP_KEYPOINT, WRIST

MAX_REACH = 0.5  # m; no fingertip is farther from its wrist
# Of files, see `geort_drake.retargeting.store`.
FORMAT, HEADER, TRAINED_POINTS = 2, "geort_drake", "trained_points"
_STEP = 1e-6  # m, of numerical derivatives; their error is below 1e-6 rad/m
_OFF_FRAME = 0.02  # m, more than by any rounding or noise
_BEHIND_PALM = 0.05  # m; right hands' fingertips were measured up to 30 mm behind the palm on average
_TIPS = [keypoint for name, keypoint in TIP_KEYPOINT.items() if name != "thumb"]

# Maps fingertips or keypoints of one or many hands to joint angles; a `Retargeter`, or a user's own function.
Retarget = Callable[[np.ndarray], np.ndarray]


class Retargeter(ABC):
    """Maps the fingertips of human hands to joint angles of a robot hand.

    Human hands are right ones: left hands are mirrored in the plane y = 0 of the wrist frame H.

    Attributes:
        finger_names: F fingers, in the order of the inputs.
        joint_names: n joints, in the order of the outputs.
        human_keypoints: (F,) numbers of the keypoints that are the fingertips.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
        robot_hands: names of the robot hands for which the map was made.
        trained_points: (F, M, 3) thinned positions of each fingertip in the recording of the training, m,
            from `clouds.trained_points`; None if there was no such recording.
        info: method, config, provenance and figures of a trained map, see `store`; in JSON types.
        arrays: the weights of a trained map.
    """

    kind: ClassVar[str] = ""  # of the weights, in files

    def __init__(
        self,
        finger_names: Sequence[str],
        joint_names: Sequence[str],
        human_keypoints: Sequence[int] | None,
        lower: np.ndarray,
        upper: np.ndarray,
        arrays: Mapping[str, np.ndarray] | None = None,
    ):
        """Without `human_keypoints`, the names of the fingers determine them.

        Args:
            finger_names, joint_names, human_keypoints, lower, upper: see the attributes.
            arrays: the weights; None for a method that has none.

        Raises:
            UnknownNameError: a finger's name has no keypoint.
            MapError: an array is missing, has a wrong shape or is not finite.
        """
        if human_keypoints is None:
            for name in finger_names:
                if name not in TIP_KEYPOINT:
                    raise UnknownNameError("finger", name, TIP_KEYPOINT)
            human_keypoints = [TIP_KEYPOINT[name] for name in finger_names]
        self.finger_names, self.joint_names = tuple(finger_names), tuple(joint_names)
        self.human_keypoints = np.array(human_keypoints, dtype=int)
        self.lower, self.upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        self.robot_hands: tuple[str, ...] = ()
        self.trained_points: np.ndarray | None = None
        self.info: dict[str, Any] = {}
        self.arrays: Mapping[str, np.ndarray] = arrays or {}
        if arrays is not None:
            self._prepare(arrays)

    def _prepare(self, arrays: Mapping[str, np.ndarray]) -> None:  # noqa: B027 (methods without weights)
        """Checks the weights and converts them for `_angles`; raises MapError."""

    @abstractmethod
    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        """Computes joint angles (N, n), rad, of N fingertips (N, F, 3), m."""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Computes joint angles, rad, of one or many human hands.

        Args:
            points: fingertips p_HF (F, 3) or (N, F, 3), or keypoints p_HK (21, 3) or (N, 21, 3), in the
                wrist frame H, m.

        Returns:
            Joint angles (n,) or (N, n), rad, which belong to the caller.

        Raises:
            ValueError: points have another shape.
            FrameError: keypoints are clearly not in H, or of a left hand.
            GeortError: a coordinate is not finite, or a fingertip is farther from the wrist than any hand's.
        """
        p_HF = self.fingertips(points)
        return self._angles(p_HF) if p_HF.ndim == 3 else self._angles(p_HF[None])[0]

    @property
    def motor_columns(self) -> np.ndarray:
        """(n,) columns of q in the order of the manufacturer's software: send it `q[..., motor_columns]`.

        The order is that of q where the software takes joints by name, and where the map does not tell.
        """
        order = self.info.get("motor_order") or self.joint_names
        return np.array([self.joint_names.index(joint) for joint in order])

    def reset(self) -> None:  # noqa: B027 (most have nothing to forget)
        """Forgets earlier calls; only methods that optimise from frame to frame remember any."""

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Computes distances (F,), m, of a hand's fingertips to the nearest positions in training.

        A fingertip far from all of them is outside of the training. The converse does not hold: fingertips
        near them may form a hand that was never seen. Thinning adds at most √3 voxels, and 2 mm on average.

        Args:
            points: fingertips (F, 3) or keypoints (21, 3), m.

        Returns:
            The distances; NaN if the positions are unknown.
        """
        p_HF = self.fingertips(points)
        if self.trained_points is None:
            return np.full(len(p_HF), np.nan)
        return np.linalg.norm(self.trained_points - p_HF[:, None], axis=-1).min(axis=1)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """Computes ∂q/∂p_HF (n, F, 3), rad/m, of one hand (F, 3) or (21, 3), by central differences.

        Raises:
            ValueError: points are more than one hand.
        """
        p_HF = self.fingertips(points)
        if p_HF.ndim != 2:
            raise ValueError(f"jacobian takes one hand, ({len(self.finger_names)}, 3), not {p_HF.shape}")
        steps = _STEP * np.eye(p_HF.size).reshape(-1, *p_HF.shape)
        change = self._angles(p_HF + steps) - self._angles(p_HF - steps)
        return (change / (2.0 * _STEP)).T.reshape(-1, *p_HF.shape)

    def save(self, path: str | os.PathLike) -> None:
        """Writes a trained map to a file, atomically; its weights get single precision.

        `geort_drake.retargeting.store` describes the file, and loads it.

        Raises:
            GeortError: there are no weights.
            OutputError: the file cannot be written.
            ValueError: `info` has a value that JSON lacks, such as NaN.
        """
        if not self.arrays:
            raise GeortError(f"a {type(self).__name__} has no weights that could be saved")
        arrays = {
            name: np.ascontiguousarray(array, dtype=np.int64 if name == "columns" else np.float32)
            for name, array in self.arrays.items()
        }
        if self.trained_points is not None:
            arrays[TRAINED_POINTS] = self.trained_points.astype(np.float32)
        header = {
            "format": FORMAT,
            "kind": self.kind,
            "robot_hands": self.robot_hands,
            "finger_names": self.finger_names,
            "joint_names": self.joint_names,
            "human_keypoints": self.human_keypoints.tolist(),
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
            "info": self.info,
        }
        # save_file would raise no OSError when the disk is full.
        contents = save(arrays, {HEADER: json.dumps(header, allow_nan=False)})
        with atomic_path(path) as draft:
            draft.write_bytes(contents)

    def fingertips(self, points: np.ndarray) -> np.ndarray:
        """Returns the fingertips (F, 3) or (N, F, 3) of `points`; see `__call__`."""
        points = np.asarray(points, dtype=float)
        fingers = len(self.finger_names)
        if (
            points.ndim not in (2, 3)
            or points.shape[-1] != 3
            or points.shape[-2] not in (fingers, KEYPOINT_COUNT)
        ):
            raise ValueError(
                f"human points must be fingertips ({fingers}, 3) or (N, {fingers}, 3) for "
                f"{', '.join(self.finger_names)}, or whole hands ({KEYPOINT_COUNT}, 3) or "
                f"(N, {KEYPOINT_COUNT}, 3); they have shape {points.shape}"
            )
        if points.shape[-2] != fingers:
            _require_wrist_frame(points)
            points = points.take(self.human_keypoints, axis=-2)
        # NaN fails the comparison, too.
        if not (np.abs(points) <= MAX_REACH).all():
            if not np.isfinite(points).all():
                raise GeortError("human points must be finite; at least one coordinate is NaN or infinite")
            raise GeortError(
                f"human points must be in metres from the wrist; a coordinate is {np.abs(points).max():g}, "
                f"and at most {MAX_REACH:g} is possible. Are they in another unit or frame?"
            )
        return points


def _require_wrist_frame(p_HK: np.ndarray) -> None:
    """Refuses whole hands (..., 21, 3), m, that are clearly not in H, or mirrored; NaN passes.

    `people.checks.require_wrist_frame_hand` finds more, but takes longer than a call.
    """
    p = p_HK.reshape(-1, KEYPOINT_COUNT, 3)
    # The wrist is at the origin, the middle knuckle on the z axis.
    off = max(np.abs(p[:, WRIST]).max(initial=0.0), np.abs(p[:, MIDDLE_MCP, :2]).max(initial=0.0))
    turned_around = p[:, BASE_KEYPOINT["little"], 1] - p[:, BASE_KEYPOINT["index"], 1] > _OFF_FRAME
    bent_back = p[:, _TIPS, 0].mean(axis=1) < -_BEHIND_PALM  # where only a left hand bends them
    if off > _OFF_FRAME or (turned_around | bent_back).any():
        what = f"are off by {1e3 * off:.0f} mm" if off > _OFF_FRAME else "are mirrored, as of a left hand"
        raise FrameError(
            "human points must be those of a right hand in the wrist frame H (origin at the wrist, z to the "
            f"middle knuckle, y to the index side), but {what}; Recording.from_keypoints transforms them"
        )


def thumb_and_others(finger_names: Sequence[str]) -> tuple[int, list[int]]:
    """Returns the number of the thumb and those of the other fingers.

    Raises:
        HandError: there is no thumb, or no other finger.
    """
    names = list(finger_names)
    if "thumb" not in names or len(names) < 2:
        raise HandError(f"the hand needs a thumb and another finger, it has {', '.join(names)}")
    return names.index("thumb"), [number for number, name in enumerate(names) if name != "thumb"]


def forget(retarget: Any) -> None:
    """Makes a method with a memory start anew, by its own `reset`; others are left alone."""
    if callable(reset := getattr(retarget, "reset", None)):
        reset()


def kinematics_of(hand: Any) -> Any:
    """Returns the `HandKinematics` of a hand model, mirrored for a left hand, or `hand` if it is one."""
    if not hasattr(hand, "description"):
        return hand
    return hand.kinematics().mirrored() if hand.description.side == "left" else hand.kinematics()


def interface_of(
    hand: Any,
) -> tuple[Sequence[str], Sequence[str], Sequence[int] | None, np.ndarray, np.ndarray]:
    """Returns the arguments of `Retargeter` for a hand model or kinematics, without the weights."""
    robot = kinematics_of(hand)
    keypoints = hand.description.human_keypoints if hasattr(hand, "description") else None
    return robot.finger_names, robot.joint_names, keypoints, robot.lower, robot.upper


def shape_of(axes: str, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Returns the shape of an array, given its axes such as "F 3 h" and the lengths of the named ones."""
    return tuple(int(axis) if axis.isdigit() else sizes[axis] for axis in axes.split())


def require_arrays(
    arrays: Mapping[str, np.ndarray], shapes: Mapping[str, str], sizes: Mapping[str, int]
) -> dict[str, np.ndarray]:
    """Returns the arrays that are named in `shapes`, in double precision.

    Args:
        arrays: arrays by name.
        shapes: name → axes, see `shape_of`.
        sizes: known lengths of named axes; the first array with another named axis determines its length.

    Raises:
        MapError: an array is missing, has another shape or no elements, or is not finite.
    """
    if missing := [name for name in shapes if name not in arrays]:
        raise MapError(f"weights: '{missing[0]}' is missing; there are {', '.join(sorted(arrays))}")
    result, sizes = {}, dict(sizes)
    for name, axes in shapes.items():
        value = np.asarray(arrays[name])
        for axis, length in zip(axes.split(), (*value.shape, *[1] * len(axes)), strict=False):
            sizes.setdefault(axis, length)
        shape = shape_of(axes, sizes)
        usable = value.size > 0 and value.shape == shape and value.dtype.kind in "fiu"
        if usable:
            with np.errstate(over="ignore"):  # products of numbers in single precision stay finite in double
                usable = bool(np.isfinite(value.astype(np.float32)).all())
        if not usable:
            raise MapError(
                f"weights: '{name}' must be finite and of shape {shape}; it is of shape {value.shape} and "
                f"type {value.dtype}"
            )
        result[name] = value.astype(float)
    return result

"""What the universal map knows of a person, and the map in NumPy.

A person is the shape of their hand: knuckles and finger lengths, medians over a few frames. The shape acts
through affine functions that precede the network's activations, so it folds once into the weights of an
ordinary map of fingertips, which never changes.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from geort_drake.errors import MapError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.people.checks import good_frames, require_wrist_frame_hand
from geort_drake.people.keypoints import BASE_KEYPOINT, FINGER_KEYPOINTS, KEYPOINT_COUNT, TIP_KEYPOINT
from geort_drake.retargeting.base import Retargeter, require_arrays
from geort_drake.retargeting.mlp import FINGERS, RESIDUAL, MlpRetargeter
from geort_drake.retargeting.numpy_kinematics import match_joints

MEASURED_FRAMES = 30  # different good frames that measure a hand: 0.3 s of a glove, 1 s of a camera
PAIR_UNIT = 0.05  # m; unit of the vectors between the thumb's tip and the others
MAX_DEVIATION = 3.0  # standard deviations of the training's people to which a shape is clamped
# Axes of the arrays in files, see `require_arrays`. The residual sees fingertips, and differences from the
# thumb's. Layers of m units process the shape of the hand.
WEIGHTS = {
    **FINGERS, **RESIDUAL,
    "shape_weight0": "shape m", "shape_weight1": "m m",
    "shape_bias0": "m", "shape_bias1": "m",
    # The affine map of the inputs; gain and offset of layers 0 and 1; gain and offset of the residual.
    "input_weight": "m affine", "modulation_weight": "4 F m h", "residual_modulation_weight": "2 m r",
    "input_bias": "affine", "modulation_bias": "4 F h", "residual_modulation_bias": "2 r",
}  # fmt: skip
STATISTICS = {
    "shape_mean": "shape", "shape_deviation": "shape", "input_mean": "F 3", "input_scale": "F 3",
}  # fmt: skip
_ALONE = "fingertips alone and Jacobians need the map that `for_person(frames)` returns"


def sizes_of(F: int) -> dict[str, int]:
    """Returns the lengths of the axes of `WEIGHTS` and `STATISTICS` that follow from F fingers."""
    return {"F": F, "inputs": 3 * F + 3 * (F - 1), "shape": 4 * F, "affine": 12 * F}


def hand_shape(p_HK: np.ndarray, finger_names: Sequence[str]) -> np.ndarray:
    """Computes the shape (4F,), m, of a hand from its keypoints p_HK (T, 21, 3), m.

    The shape has the knuckles' positions in H (the thumb's is the CMC joint), then the fingers' lengths from
    knuckle to tip along the bones; both are medians over the frames.
    """
    chains = np.array([FINGER_KEYPOINTS[name] for name in finger_names])
    bones = np.linalg.norm(np.diff(p_HK[:, chains], axis=2), axis=-1)
    knuckles = np.median(p_HK[:, [BASE_KEYPOINT[name] for name in finger_names]], axis=0)
    return np.concatenate([knuckles.ravel(), np.median(bones, axis=0).sum(axis=1)]).astype(np.float32)


class UniversalRetargeter(Retargeter):
    """Makes maps from the hands of any person to robot joint angles; needs only NumPy.

    A call takes whole hands, and measures the shape of the hand on them.

    The weights are `WEIGHTS`, `STATISTICS` and `columns`. One finger must be the thumb.
    """

    kind = "universal"

    def _prepare(self, arrays: Mapping[str, np.ndarray]) -> None:
        names = self.finger_names
        if unknown := [name for name in names if name not in TIP_KEYPOINT]:
            raise MapError(f"finger_names: unknown {unknown[0]!r}; known are {', '.join(TIP_KEYPOINT)}")
        if "thumb" not in names:
            raise MapError(f"finger_names: 'thumb' is missing; there are {', '.join(names)}")
        self._thumb = names.index("thumb")
        sizes = sizes_of(len(names)) | {"n": len(self.joint_names)}
        shapes = WEIGHTS | STATISTICS | {"columns": "n"}
        self._weights = weights = dict(arrays) | require_arrays(arrays, shapes, sizes)
        for name in ("shape_deviation", "input_scale"):
            if not (weights[name] > 0).all():
                raise MapError(f"weights: '{name}' must be positive")
        self._folded(weights["shape_mean"])  # checks `columns`

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Computes joint angles (n,) or (N, n), rad, of the person in keypoints (21, 3) or (N, 21, 3), m.

        The shape of the hand is that of these frames. A map that stays the same from call to call, and also
        takes fingertips alone, is `for_person`.

        Raises:
            ValueError: points have another shape.
            RecordingError, MismatchError: see `require_wrist_frame_hand`.
        """
        return self._folded(self.shape(points))(points)

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        raise ValueError(f"the shape of the hand is unknown: {_ALONE}")

    def for_person(self, p_HK: np.ndarray) -> MlpRetargeter:
        """Returns the map of the person in keypoints p_HK (21, 3) or (T, 21, 3), m; it never changes.

        `MEASURED_FRAMES` frames are enough; bad ones are left out, see `checks.good_frames`.

        Raises:
            ValueError: points have another shape.
            RecordingError, MismatchError: see `require_wrist_frame_hand`.
        """
        return self._folded(self.shape(p_HK))

    def shape(self, p_HK: np.ndarray) -> np.ndarray:
        """Computes the shape (4F,), m, of the hand in keypoints p_HK (21, 3) or (T, 21, 3), m.

        Raises:
            ValueError: points have another shape.
            RecordingError, MismatchError: see `require_wrist_frame_hand`.
        """
        p_HK = np.asarray(p_HK, dtype=float)
        if p_HK.ndim not in (2, 3) or p_HK.shape[-2:] != (KEYPOINT_COUNT, 3):
            raise ValueError(
                f"the hand's shape is measured on whole hands, (T, {KEYPOINT_COUNT}, 3), not on points of "
                f"shape {p_HK.shape}; {_ALONE}"
            )
        require_wrist_frame_hand(p_HK)
        p_HK = p_HK.reshape(-1, KEYPOINT_COUNT, 3)
        return hand_shape(p_HK[good_frames(p_HK)], self.finger_names)

    def unusual(self, shape: np.ndarray) -> str:
        """Names the part of a hand's shape (4F,), m, that is clamped for being unlike all training; or ""."""
        z = np.abs((shape - self._weights["shape_mean"]) / self._weights["shape_deviation"])
        number = int(np.argmax(z))
        if z[number] <= MAX_DEVIATION:
            return ""
        knuckles = 3 * len(self.finger_names)
        part, finger = ("base", number // 3) if number < knuckles else ("length", number - knuckles)
        return (
            f"{part} of the {self.finger_names[finger]}: {z[number]:.1f} deviations from the average person; "
            f"the map is for up to {MAX_DEVIATION:g}"
        )

    def mirrored(self, hand: HandKinematics, mirrored_hand: HandKinematics) -> "UniversalRetargeter | None":
        """Returns the map of the mirror image, whose joints may have other names, senses and zeros.

        Args:
            hand: kinematics of this map's hand.
            mirrored_hand: kinematics of the other hand, mirrored; see `HandKinematics.mirrored`.

        Returns:
            The map; None if the other hand is no mirror image, see `match_joints`.
        """
        if (match := match_joints(hand, mirrored_hand)) is None:
            return None
        rows, signs = match
        columns = self.arrays["columns"]
        arrays = dict(self.arrays) | {"columns": columns[rows]}
        outputs = np.ones(arrays["bias2"].size, dtype=np.float32)
        outputs[columns[rows]] = signs
        for name in ("weight2", "bias2", "residual_weight2", "residual_bias2"):
            of_fingers = arrays[name].ndim == 3
            arrays[name] = arrays[name] * outputs.reshape((len(hand.fingers), 1, -1) if of_fingers else -1)
        names = self.finger_names, mirrored_hand.joint_names, self.human_keypoints.tolist()
        result = UniversalRetargeter(*names, mirrored_hand.lower, mirrored_hand.upper, arrays)
        result.info = self.info
        return result

    def _folded(self, shape: np.ndarray) -> MlpRetargeter:
        names = self.finger_names, self.joint_names, self.human_keypoints.tolist()
        retargeter = MlpRetargeter(*names, self.lower, self.upper, self._folded_arrays(shape))
        retargeter.robot_hands, retargeter.info = self.robot_hands, self.info
        return retargeter

    def _folded_arrays(self, shape: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the weights of the map of the person with a hand of this shape (4F,), m."""
        arrays, fingers, shape = self._weights, len(self.finger_names), np.asarray(shape, dtype=float)
        z = (shape - arrays["shape_mean"]) / arrays["shape_deviation"]
        z = np.clip(z, -MAX_DEVIATION, MAX_DEVIATION)
        for k in range(2):
            z = z @ arrays[f"shape_weight{k}"] + arrays[f"shape_bias{k}"]
            z = 0.5 * z * (1.0 + np.tanh(0.5 * z))  # silu
        inputs = z @ arrays["input_weight"] + arrays["input_bias"]
        modulation = z @ arrays["modulation_weight"] + arrays["modulation_bias"]
        gain0, offset0, gain1, offset1 = modulation[:, :, None]  # each (F, 1, h)
        gain, offset = z @ arrays["residual_modulation_weight"] + arrays["residual_modulation_bias"]

        # x' = p M + v of each finger.
        knuckles = shape[: 3 * fingers].reshape(fingers, 3)
        lengths = shape[3 * fingers :, None]
        affine = np.eye(3) + inputs[: 9 * fingers].reshape(fingers, 3, 3)
        M = affine / (lengths * arrays["input_scale"])[:, :, None]
        origin = (knuckles / lengths + arrays["input_mean"]) / arrays["input_scale"]
        v = inputs[9 * fingers :].reshape(fingers, 1, 3) - origin[:, None] @ affine

        shared, pairs = np.split(arrays["residual_weight0"], [3 * fingers])
        shared = shared.reshape(fingers, 3, -1)
        residual = M @ shared
        pairs = pairs.reshape(fingers - 1, 3, -1) / PAIR_UNIT
        residual[self._thumb] += pairs.sum(axis=0)
        residual[np.arange(fingers) != self._thumb] -= pairs
        bias = (v @ shared).sum(axis=0)[0] + arrays["residual_bias0"]
        return arrays | {
            "weight0": (M @ arrays["weight0"]) * (1.0 + gain0),
            "bias0": (v @ arrays["weight0"] + arrays["bias0"]) * (1.0 + gain0) + offset0,
            "weight1": arrays["weight1"] * (1.0 + gain1),
            "bias1": arrays["bias1"] * (1.0 + gain1) + offset1,
            "residual_weight0": residual.reshape(3 * fingers, -1) * (1.0 + gain),
            "residual_bias0": bias * (1.0 + gain) + offset,
        }

"""The universal map in NumPy: a network that takes fingertips and a code of the person."""

from collections.abc import Mapping, Sequence

import numpy as np

from geort_drake.errors import CheckpointError, GeortError
from geort_drake.people.checks import require_wrist_frame_hand
from geort_drake.people.keypoints import KEYPOINT_COUNT, TIP_KEYPOINT
from geort_drake.retargeting.base import Retargeter, require_array
from geort_drake.retargeting.mlp import MlpRetargeter
from geort_drake.retargeting.person_code import CODE_PARTS, CODE_SIZE, AveragePerson, observe
from geort_drake.retargeting.person_observer import MIN_BONE
from geort_drake.retargeting.trained_space import TrainedSpace

PINCH_UNIT = 0.05  # m; unit of the vectors between the thumb's tip and the others
MAX_DEVIATION = 3.0  # standard deviations from the average person to which a code is clamped
_UNUSUAL = 4.0  # standard deviations beyond which a code is reported


class UniversalRetargeter(Retargeter):
    """Maps the hands of any person to robot joint angles; needs only NumPy.

    A call computes the person's code from the given frames. `for_person` makes a map for one person, which is
    faster and also accepts fingertips alone.

    Attributes:
        finger_names: F fingers, in the order of the map's inputs.
        joint_names: n joints, in the order of the outputs.
        human_keypoints: numbers of the F keypoints that are the human fingertips.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
        average: the average person, the prior of the codes.
    """

    kind = "universal"

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        finger_names: Sequence[str],
        joint_names: Sequence[str],
        human_keypoints: Sequence[int],
        lower: np.ndarray,
        upper: np.ndarray,
    ):
        """Builds the map from its weights.

        Args:
            arrays: reach_mean (F, 3), reach_covariance (F, 3, 3) and reach_weights (2,) of the average
                person; code_mean, code_deviation (15 F,); code_weight0 (15 F, m), code_bias0 (m,),
                code_weight1 (m, m), code_bias1 (m,); input_mean and input_scale (F, 3) of the inputs;
                input_weight (m, 12 F), input_bias (12 F,);
                modulation_weight (4, F, m, h), modulation_bias (4, F, h); residual_modulation_weight
                (2, m, r), residual_modulation_bias (2, r); and those of `MlpRetargeter`, whose
                residual_weight0 is (3 F + 3 (F − 1), r).
            finger_names, joint_names, human_keypoints, lower, upper: as in `Retargeter`; one finger must be
                the thumb.

        Raises:
            CheckpointError: as in `Retargeter`, or a finger is unknown, or there is no thumb.
        """
        super().__init__(finger_names, joint_names, human_keypoints, lower, upper)
        self.arrays = arrays
        if unknown := [name for name in finger_names if name not in TIP_KEYPOINT]:
            raise CheckpointError(
                f"finger_names: unknown {unknown[0]!r}; known are {', '.join(TIP_KEYPOINT)}"
            )
        if "thumb" not in finger_names:
            raise CheckpointError(f"finger_names: 'thumb' is missing; there are {', '.join(finger_names)}")
        self._thumb = self.finger_names.index("thumb")
        self._arrays = {name: np.asarray(value, dtype=float) for name, value in arrays.items()}
        if "columns" in arrays:
            self._arrays["columns"] = arrays["columns"]
        self._check()
        self.average = AveragePerson.from_arrays(self._arrays)
        self.folded(np.asarray(self._arrays["code_mean"]))  # also checks the arrays of the fingers

    def _check(self) -> None:
        fingers, numbers = len(self.finger_names), CODE_SIZE * len(self.finger_names)
        units = require_array(self._arrays, "code_weight0", (numbers, -1)).shape[1]
        hidden = require_array(self._arrays, "weight0", (fingers, 3, -1)).shape[2]
        inputs = 3 * fingers + 3 * (fingers - 1)
        residual = require_array(self._arrays, "residual_weight0", (inputs, -1)).shape[1]
        shapes: dict[str, tuple[int, ...]] = {
            "reach_mean": (fingers, 3),
            "reach_covariance": (fingers, 3, 3),
            "reach_weights": (2,),
            "code_mean": (numbers,),
            "code_deviation": (numbers,),
            "code_bias0": (units,),
            "code_weight1": (units, units),
            "code_bias1": (units,),
            "input_mean": (fingers, 3),
            "input_scale": (fingers, 3),
            "input_weight": (units, 12 * fingers),
            "input_bias": (12 * fingers,),
            "modulation_weight": (4, fingers, units, hidden),
            "modulation_bias": (4, fingers, hidden),
            "residual_modulation_weight": (2, units, residual),
            "residual_modulation_bias": (2, residual),
            "bias0": (fingers, 1, hidden),
            "weight1": (fingers, hidden, hidden),
            "bias1": (fingers, 1, hidden),
            "residual_bias0": (residual,),
        }
        for name, shape in shapes.items():
            require_array(self._arrays, name, shape)
        for name in ("code_deviation", "input_scale", "reach_weights"):
            if not (self._arrays[name] > 0).all():
                raise CheckpointError(f"weights: '{name}' must be positive")
        covariance = self._arrays["reach_covariance"]
        if not (np.linalg.eigvalsh(covariance) > 0).all():
            raise CheckpointError("weights: 'reach_covariance' must be positive definite")

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        """Computes joint angles of one person, whose code is that of the given frames.

        Args:
            p_HK: keypoints (21, 3) or (N, 21, 3), in the wrist frame H, m.

        Returns:
            Joint angles (n,) or (N, n), rad.

        Raises:
            ValueError: p_HK has another shape.
            GeortError: a coordinate is not finite, or the fingers have no length.
        """
        p_HK = np.asarray(p_HK, dtype=float)
        return self.folded(self.code(p_HK))(p_HK)

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        raise NotImplementedError  # a call needs whole hands

    def for_person(self, p_HK: np.ndarray) -> MlpRetargeter:
        """Returns the map of the person in keypoints p_HK (21, 3) or (T, 21, 3), m.

        Its `trained_space` contains the positions of the fingertips in these frames.

        Raises:
            ValueError, GeortError: as in a call, and for keypoints that are no hand in m in the wrist frame.
        """
        p_HK = np.asarray(p_HK, dtype=float)
        if p_HK.shape[-2:] == (KEYPOINT_COUNT, 3) and np.isfinite(p_HK).all():
            require_wrist_frame_hand(p_HK)
        retargeter = self.folded(self.code(p_HK))
        keypoints = list(self.human_keypoints)
        p_HF = p_HK.reshape(-1, KEYPOINT_COUNT, 3)[:, keypoints]
        retargeter.trained_space = TrainedSpace.of_recording(p_HF, keypoints)
        return retargeter

    def code(self, p_HK: np.ndarray) -> np.ndarray:
        """Computes the code (15 F,) of the person in keypoints p_HK (21, 3) or (T, 21, 3), m.

        Raises:
            ValueError, GeortError: as in a call.
        """
        p_HK = np.asarray(p_HK, dtype=float)
        given = p_HK.shape
        p_HK = p_HK[None] if p_HK.ndim == 2 else p_HK
        if p_HK.ndim != 3 or p_HK.shape[1:] != (KEYPOINT_COUNT, 3) or len(p_HK) == 0:
            hands = f"({KEYPOINT_COUNT}, 3) or (N, {KEYPOINT_COUNT}, 3) with N > 0"
            raise ValueError(
                f"the hand's shape is estimated from whole hands, {hands}, not from points of shape "
                f"{given}; for fingertips alone, call the map that `for_person` returns"
            )
        if not np.isfinite(p_HK).all():
            raise GeortError("human points must be finite; at least one coordinate is NaN or infinite")
        with np.errstate(divide="ignore", invalid="ignore"):
            observation = observe(p_HK, self.finger_names)
        if not (observation.lengths > 3 * MIN_BONE).all():
            raise GeortError("human points must be a hand in metres: a finger has hardly any length")
        return self.average.code(observation)

    def deviations(self, code: np.ndarray) -> np.ndarray:
        """Returns the code (15 F,) in standard deviations from the average person."""
        return (code - self._arrays["code_mean"]) / self._arrays["code_deviation"]

    def unusual(self, code: np.ndarray) -> str:
        """Names the part of the hand's shape that is farthest from the training's people; "" if none is far.

        The reach is left out, because it depends on what and how long a person has played.
        """
        rows = np.cumsum([0, *(CODE_PARTS[part] * len(self.finger_names) for part in ("base", "length"))])
        z = np.abs(self.deviations(code))[: rows[-1]]
        number = int(np.argmax(z))
        if z[number] <= _UNUSUAL:
            return ""
        part = int(np.searchsorted(rows, number, side="right")) - 1
        name, size = list(CODE_PARTS.items())[part]
        finger = self.finger_names[(number - rows[part]) // size]
        return (
            f"{name} of the {finger}: {z[number]:.1f} deviations from the average person; the map is for up "
            f"to {MAX_DEVIATION:g}"
        )

    def folded(self, code: np.ndarray) -> MlpRetargeter:
        """Returns the map of the person with this code (15 F,).

        The code acts through affine functions before the activations, so it folds into the weights.
        """
        retargeter = MlpRetargeter(
            self.folded_arrays(code),
            self.finger_names,
            self.joint_names,
            self.human_keypoints,
            self.lower,
            self.upper,
        )
        retargeter.robot_hands = self.robot_hands
        return retargeter

    def folded_arrays(self, code: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the weights of the map of the person with this code (15 F,)."""
        arrays, fingers, code = self._arrays, len(self.finger_names), np.asarray(code, dtype=float)
        z = np.clip(self.deviations(code), -MAX_DEVIATION, MAX_DEVIATION)
        for k in range(2):
            z = z @ arrays[f"code_weight{k}"] + arrays[f"code_bias{k}"]
            z = 0.5 * z * (1.0 + np.tanh(0.5 * z))  # silu
        inputs = z @ arrays["input_weight"] + arrays["input_bias"]
        modulation = z @ arrays["modulation_weight"] + arrays["modulation_bias"]
        gain0, offset0, gain1, offset1 = modulation[:, :, None]  # each (F, 1, h)
        gain, offset = z @ arrays["residual_modulation_weight"] + arrays["residual_modulation_bias"]

        # x' = p M + v of each finger.
        knuckles = code[: 3 * fingers].reshape(fingers, 3)
        lengths = code[3 * fingers : 4 * fingers, None]
        own = np.eye(3) + inputs[: 9 * fingers].reshape(fingers, 3, 3)
        M = own / (lengths * arrays["input_scale"])[:, :, None]
        origin = (knuckles / lengths + arrays["input_mean"]) / arrays["input_scale"]
        v = inputs[9 * fingers :].reshape(fingers, 1, 3) - origin[:, None] @ own

        shared, pairs = np.split(arrays["residual_weight0"], [3 * fingers])
        shared = shared.reshape(fingers, 3, -1)
        residual = M @ shared
        pairs = pairs.reshape(fingers - 1, 3, -1) / PINCH_UNIT
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

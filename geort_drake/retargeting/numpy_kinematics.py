"""Exact fingertip kinematics and Jacobians of a hand in NumPy, batched.

The counterpart of `HandKinematics` for methods that optimise at run time, where torch is not wanted.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from geort_drake.errors import HandError

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics

_FIELDS = ("finger_names", "joint_names", "lower", "upper", "tip_radius", "p_BW", "fingers")


class NumpyKinematics:
    """Fingertips p_BF and their Jacobians of serial fingers with revolute joints.

    Attributes:
        finger_names: F names.
        joint_names: n names in the order of q.
        lower, upper: (n,) joint limits, rad.
        tip_radius: radius of the fingertip spheres, m.
        p_BW: (3,) the hand's wrist in its base, m.
    """

    def __init__(self, data: Mapping):
        """Takes what `to_json` returns.

        Raises:
            HandError: a field is missing, or an array has a wrong shape or is not finite.
        """
        missing = [name for name in _FIELDS if name not in data]
        if missing:
            raise HandError(f"kinematics: {', '.join(missing)} missing; wanted are {', '.join(_FIELDS)}")
        self._data = dict(data)
        self.finger_names, self.joint_names = tuple(data["finger_names"]), tuple(data["joint_names"])
        n, fingers = len(self.joint_names), len(self.finger_names)
        self.lower, self.upper = (_array(name, data[name], (n,)) for name in ("lower", "upper"))
        if not (self.lower < self.upper).all():
            raise HandError("kinematics: every lower joint limit must be under its upper limit")
        self.tip_radius = float(data["tip_radius"])
        self.p_BW = _array("p_BW", data["p_BW"], (3,))
        # Joints that follow others come after q: (N, n); absent where there are none.
        self._coupling = None
        if "coupling" in data:
            self._coupling = _array("coupling", data["coupling"], (len(data["coupling"]), n))
            n = len(self._coupling)
        chains = data["fingers"]
        if len(chains) != fingers:
            raise HandError(f"kinematics: {len(chains)} chains for {fingers} fingers")
        k = max(len(chain["joint_indices"]) for chain in chains)
        # A finger with fewer joints gets fixed ones at its base, which read the unused angle n.
        indices = np.full((fingers, k), n)
        X = np.tile(np.eye(4), (fingers, k, 1, 1))
        axes = np.zeros((fingers, k, 3))
        p_tip = np.zeros((fingers, 3, 1))
        for f, (name, chain) in enumerate(zip(self.finger_names, chains, strict=True)):
            own = len(chain["joint_indices"])
            indices[f, k - own :] = chain["joint_indices"]
            X[f, k - own :] = _array(f"{name}: X_PJ", chain["X_PJ"], (own, 4, 4))
            axes[f, k - own :] = _array(f"{name}: axes", chain["axes"], (own, 3))
            p_tip[f, :, 0] = _array(f"{name}: p_tip", chain["p_tip"], (3,))
        if indices.min() < 0 or indices.max() > n:
            raise HandError(f"kinematics: joint indices must be 0 to {n - 1}")
        K = np.zeros((fingers, k, 3, 3))
        K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -axes[..., 2], axes[..., 1], -axes[..., 0]
        K -= np.swapaxes(K, -1, -2)
        # Rodrigues: R_PJ Rot(a, θ) = R_PJ + sin θ · R_PJ K + (1 − cos θ) · R_PJ K²
        self._R = X[..., :3, :3]
        self._RK = self._R @ K
        self._RKK = self._RK @ K
        self._offset = X[..., :3, 3:]
        self._p_tip, self._indices = p_tip, indices

    @classmethod
    def of(cls, kinematics: "HandKinematics | NumpyKinematics") -> "NumpyKinematics":
        """The same hand as `kinematics`, from `HandModel.kinematics()` for example."""
        if isinstance(kinematics, NumpyKinematics):
            return kinematics
        free, coupling = kinematics.uncoupled()
        return cls(
            {
                "finger_names": list(kinematics.finger_names),
                "joint_names": list(kinematics.joint_names),
                "lower": kinematics.lower.tolist(),
                "upper": kinematics.upper.tolist(),
                "tip_radius": float(kinematics.tip_radius),
                "p_BW": kinematics.p_BW.tolist(),
                "fingers": [
                    {
                        "joint_indices": list(map(int, finger.joint_indices)),
                        "X_PJ": finger.X_PJ.tolist(),
                        "axes": finger.axes.tolist(),
                        "p_tip": finger.p_tip.tolist(),
                    }
                    for finger in free.fingers
                ],
            }
            | ({} if len(coupling) == len(kinematics.joint_names) else {"coupling": coupling.tolist()})
        )

    def to_json(self) -> dict:
        """Names and plain lists of numbers that describe the hand."""
        return self._data

    def fingertips(self, q: np.ndarray) -> np.ndarray:
        """Fingertip points p_BF, (N, F, 3) in m, for joint angles (N, n) in rad."""
        return self.fingertips_and_jacobians(q)[0]

    def fingertips_and_jacobians(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """p_BF (N, F, 3) in m and ∂p_BF/∂q (N, F, 3, n) in m/rad, for joint angles (N, n) in rad."""
        if self._coupling is not None:
            q = q @ self._coupling.T
        count, n = q.shape
        fingers, k = self._indices.shape
        angles = np.concatenate([q, np.zeros((count, 1))], axis=1)[:, self._indices][..., None, None]
        sine, cosine = np.sin(angles), np.cos(angles)
        M = self._R + sine * self._RK + (1.0 - cosine) * self._RKK
        dM = cosine * self._RK + sine * self._RKK
        p = np.broadcast_to(self._p_tip, (count, fingers, 3, 1))
        J = np.empty((count, fingers, 3, k))
        # From the tip to the base: each joint turns the point and what the joints beyond it do to it.
        for j in reversed(range(k)):
            J[..., j + 1 :] = M[:, :, j] @ J[..., j + 1 :]
            J[..., j : j + 1] = dM[:, :, j] @ p
            p = M[:, :, j] @ p + self._offset[:, j]
        full = np.zeros((count, fingers, n + 1, 3))
        full[:, np.arange(fingers)[:, None], self._indices] = np.swapaxes(J, -1, -2)
        J = np.swapaxes(full[:, :, :n], -1, -2)
        return p[..., 0], J if self._coupling is None else J @ self._coupling


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise HandError(f"kinematics: {name} must be finite and of shape {shape}, it has {array.shape}")
    return array

"""AnyTeleop and DexPilot: Eq. 1 of the GeoRT paper, solved at every frame.

min over q of  Σ_i w_i h(|v_R^i(q) − v*^i|) / V  +  NORM_DELTA · |q − q_previous|²,  lower ≤ q ≤ upper

with h the Huber function of PyTorch's SmoothL1 (x² / 2δ below δ, x − δ/2 above). A task vector goes from the
wrist or a fingertip to a fingertip; its target is the person's, scaled by hand-tuned settings. The
regularisation towards the previous joint angles makes results depend on the past.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from geort_drake.errors import HandError, naming
from geort_drake.retargeting.base import Retargeter, interface_of, kinematics_of, thumb_and_others
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

SCALE = 1.6  # α, robot over human, from dex-retargeting's settings for the Allegro hand
NORM_DELTA = 4e-3  # 1/rad², regularisation towards the previous joint angles
# DexPilot projects thumb-finger vectors shorter than PROJECT to contact, until they exceed ESCAPE, m.
PROJECT, ESCAPE = 0.03, 0.05
PINCH_DISTANCE, APART_DISTANCE = 1e-4, 3e-2  # m, η1 and η2: lengths of projected vectors to thumb and fingers
PINCH_WEIGHT, APART_WEIGHT = 200.0, 400.0  # of projected vectors
WRIST = -1  # origin of a task vector that starts at the wrist
TOLERANCE, ITERATIONS = 1e-4, 60  # rad, largest last step; maximum number of steps


class AnyTeleop(Retargeter):
    """AnyTeleop's retargeting (Qin et al. 2023): scaled vectors from the wrist to every fingertip.

    Stateful: a call continues from the previous one, and a batch is a sequence of frames. Not thread-safe.
    """

    huber_delta = 0.02  # m

    def __init__(self, hand: Any, p_HF: np.ndarray | None = None, **_options: Any):
        """Makes a retargeter at rest; see `Method.fit`.

        Raises:
            UnknownNameError: a finger's name has no keypoint.
            HandError: the hand lacks fingers that the method needs.
        """
        super().__init__(*interface_of(hand))
        self.kinematics = NumpyKinematics(kinematics_of(hand))
        # Task vectors from an origin, which may be WRIST, to a tip: v = difference · tips − origin.
        self._vectors = self._pairs()
        self._difference = np.zeros((len(self._vectors), len(self.finger_names)))
        self._origin = np.zeros((len(self._vectors), 3))
        for row, (origin, tip) in enumerate(self._vectors):
            self._difference[row, tip] = 1.0
            if origin == WRIST:
                self._origin[row] = kinematics_of(hand).p_BW
            else:
                self._difference[row, origin] = -1.0
        self.reset()

    def reset(self) -> None:
        """Resets the state: joints in the middle of their ranges, no vector projected."""
        self._q = 0.5 * (self.lower + self.upper)
        self._projected = np.zeros(len(self._vectors), dtype=bool)

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        return np.array([self._step(row) for row in p_HF]).reshape(len(p_HF), len(self.joint_names))

    def settled_map(self, frames: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Returns the stationary results for hands that are held still, as a stateless function.

        Hands should be near recorded ones. Each is held until the joint angles no longer change, starting
        from the method's state at the nearest recorded frame.

        Args:
            frames: (T, F, 3) successive human fingertips, m; they also set the state of this retargeter.

        Returns:
            A function from (N, F, 3) to joint angles (N, n).
        """
        from scipy.spatial import cKDTree  # the robot's computer may lack SciPy

        frames = self.fingertips(frames)
        self.reset()
        q, projected = [], []
        for frame in frames:
            self._step(frame)
            q.append(self._q)
            projected.append(self._projected)
        states, switched = np.array(q), np.array(projected)
        tree = cKDTree(frames.reshape(len(frames), -1))

        def settled(p_HF: np.ndarray) -> np.ndarray:
            _, nearest = tree.query(p_HF.reshape(len(p_HF), -1))
            targets, weights, _ = self._targets(p_HF, switched[nearest])
            # The regularisation towards previous angles vanishes at rest.
            return self._solve(targets, weights, states[nearest], None)

        return settled

    def _step(self, p_HF: np.ndarray) -> np.ndarray:
        targets, weights, projected = self._targets(p_HF[None], self._projected[None])
        previous = self._q[None]
        self._q = self._solve(targets, weights, previous, previous)[0]
        self._projected = projected[0]
        return self._q

    def _pairs(self) -> list[tuple[int, int]]:
        return [(WRIST, finger) for finger in range(len(self.finger_names))]

    def _targets(self, p_HF: np.ndarray, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns target vectors (N, V, 3), m, weights (N, V) and new `projected` (N, V); p_HF (N, F, 3)."""
        targets = SCALE * self._difference @ p_HF
        return targets, np.ones(targets.shape[:2]), projected

    def _solve(
        self,
        targets: np.ndarray,
        weights: np.ndarray,
        start: np.ndarray,
        previous: np.ndarray | None,
    ) -> np.ndarray:
        """Finds joint angles (N, n), rad, that minimise the objective of each of N frames.

        Args:
            targets: (N, V, 3) target task vectors, m.
            weights: (N, V) weights of the vectors.
            start: (N, n) initial joint angles inside the limits, rad.
            previous: (N, n) joint angles of the regulariser, rad; None omits it.
        """
        lower, upper = self.lower, self.upper
        q = np.clip(start, lower, upper)
        rows = np.arange(len(q))  # unfinished frames
        damping = np.full(len(q), 1e-3)
        loss, gradient, H = self._objective(q, targets, weights, previous)
        for _ in range(ITERATIONS):
            # Joints that the gradient presses against a limit are fixed.
            free = ~(((q[rows] <= lower) & (gradient > 0)) | ((q[rows] >= upper) & (gradient < 0)))
            # Damping relative to the mean curvature leaves redundant directions unchanged.
            scale = np.einsum("nii->n", H) / H.shape[-1] + 1e-12
            A = H * (free[:, :, None] & free[:, None, :])
            diagonal = np.einsum("nii->ni", A)
            diagonal += np.where(free, (damping[rows] * scale)[:, None], 1.0)
            step = np.linalg.solve(A, -(gradient * free)[..., None])[..., 0]
            trial = np.clip(q[rows] + step, lower, upper)
            regulariser = None if previous is None else previous[rows]
            trial_terms = self._objective(trial, targets[rows], weights[rows], regulariser)
            improves = trial_terms[0] <= loss
            moved = np.abs(trial - q[rows]).max(axis=1)
            q[rows[improves]] = trial[improves]
            damping[rows] = np.clip(damping[rows] * np.where(improves, 0.2, 10.0), 1e-6, 1e6)
            loss = np.where(improves, trial_terms[0], loss)
            gradient = np.where(improves[:, None], trial_terms[1], gradient)
            H = np.where(improves[:, None, None], trial_terms[2], H)
            going = moved > TOLERANCE
            if not going.any():
                break
            rows, loss, gradient, H = rows[going], loss[going], gradient[going], H[going]
        return q

    def _objective(
        self, q: np.ndarray, targets: np.ndarray, weights: np.ndarray, previous: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns loss (N,), gradient (N, n) and Gauss–Newton Hessian (N, n, n) at q (N, n), rad.
        Other arguments are those of `_solve`.
        """
        tips, J = self.kinematics.fingertips_and_jacobians(q)
        count, fingers, _, n = J.shape
        residual = self._difference @ tips - self._origin - targets
        J = (self._difference @ J.reshape(count, fingers, 3 * n)).reshape(count, -1, n)
        distance = np.sqrt((residual**2).sum(-1))
        delta = self.huber_delta
        huber = np.where(distance < delta, 0.5 * distance**2 / delta, distance - 0.5 * delta)
        weights = weights / len(self._vectors)
        loss = (weights * huber).sum(-1)
        # h'(d)/d is the weight with which half the squared residual has the same gradient.
        w = np.repeat(weights / np.maximum(distance, delta), 3, axis=-1)
        weighted = J * w[..., None]
        gradient = (residual.reshape(count, 1, -1) @ weighted)[:, 0]
        H = np.swapaxes(J, -1, -2) @ weighted
        if previous is not None:
            away = q - previous
            loss = loss + NORM_DELTA * (away**2).sum(-1)
            gradient = gradient + 2.0 * NORM_DELTA * away
            H += 2.0 * NORM_DELTA * np.eye(n)
        return loss, gradient, H


class DexPilot(AnyTeleop):
    """DexPilot's retargeting (Handa et al. 2020), which gives priority to distances between fingertips.

    It uses vectors between the thumb and each finger (S1), between these fingers (S2) and from the wrist.
    When the person's thumb comes near a finger, the target of their vector is projected to contact and gets a
    larger weight, with hysteresis. While two fingers pinch, the target between them keeps them apart.
    """

    huber_delta = 0.03  # m

    def _pairs(self) -> list[tuple[int, int]]:
        with naming("DexPilot", HandError):
            thumb, others = thumb_and_others(self.finger_names)
        pinches = [(thumb, finger) for finger in others]
        between = [(a, b) for k, a in enumerate(others) for b in others[k + 1 :]]
        # For each finger-finger vector, the two thumb-finger vectors that switch its projection.
        self._switching = np.array([(others.index(a), others.index(b)) for a, b in between], dtype=int)
        return pinches + between + super()._pairs()

    def _targets(self, p_HF: np.ndarray, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        fingers = len(self.finger_names)
        pinches, pairs = fingers - 1, len(self._vectors) - fingers
        human = self._difference @ p_HF
        distance = np.sqrt((human[:, :pairs] ** 2).sum(-1))
        near = projected.copy()
        first = distance[:, :pinches]
        near[:, :pinches] = np.where(first < PROJECT, True, near[:, :pinches] & (first <= ESCAPE))
        if len(self._switching):
            both = near[:, self._switching[:, 0]] & near[:, self._switching[:, 1]]
            near[:, pinches:pairs] = both & (distance[:, pinches:] <= PROJECT)
        length = np.full(pairs, PINCH_DISTANCE)
        length[pinches:] = APART_DISTANCE
        projected_weight = np.full(pairs, PINCH_WEIGHT)
        projected_weight[pinches:] = APART_WEIGHT
        switched = near[:, :pairs]
        targets = SCALE * human
        direction = human[:, :pairs] / (distance[..., None] + 1e-6)
        targets[:, :pairs] = np.where(switched[..., None], direction * length[:, None], targets[:, :pairs])
        # Without projection the vectors from the wrist dominate, as in dex-retargeting.
        weights = np.full(human.shape[:2], float(pairs + fingers))
        weights[:, :pairs] = np.where(switched, projected_weight, 1.0)
        return targets, weights, near

"""Methods that optimise joint angles at every frame: AnyTeleop's vectors and DexPilot.

Both solve Eq. 1 of the GeoRT paper with hand-tuned scale, weights and task vectors. They start from the joint
angles of the previous frame and are regularised towards them, so results depend on the past.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.errors import HandError
from geort_drake.retargeting.human_points import HumanPoints
from geort_drake.retargeting.method import UntrainedMethod
from geort_drake.retargeting.methods.task_vectors import WRIST, TaskVectors
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics

SCALE = 1.6  # α, robot over human, from dex-retargeting's settings for the Allegro hand
NORM_DELTA = 4e-3  # 1/rad², regularisation towards the previous joint angles
# DexPilot projects thumb-finger vectors shorter than PROJECT to contact, until they exceed ESCAPE, m.
PROJECT, ESCAPE = 0.03, 0.05
PINCH_DISTANCE, APART_DISTANCE = 1e-4, 3e-2  # m, η1 and η2: lengths of projected vectors to thumb and fingers
PINCH_WEIGHT, APART_WEIGHT = 200.0, 400.0  # of projected vectors
CHUNK = 1024  # hands that are evaluated at a time, so that their data fit the cache


class VectorOnline:
    """AnyTeleop's retargeting (Qin et al. 2023): scaled vectors from the wrist to every fingertip.

    Stateful: a call continues from the previous one, and a batch is a sequence of frames. Not thread-safe.

    Attributes:
        finger_names: F fingers, in the order of the inputs.
        joint_names: n joints, in the order of the outputs.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
    """

    huber_delta = 0.02  # m

    def __init__(
        self,
        kinematics: "HandKinematics",
        human_keypoints: Sequence[int] | None = None,
    ):
        """Makes a retargeter at rest.

        Args:
            kinematics: kinematics of the robot hand, mirrored for a left hand.
            human_keypoints: keypoint of each fingertip; by default the fingers' names determine it.

        Raises:
            UnknownNameError: a finger's name has no keypoint.
            HandError: the hand lacks fingers that the method needs.
        """
        self.kinematics = NumpyKinematics(kinematics)
        self.finger_names, self.joint_names = self.kinematics.finger_names, self.kinematics.joint_names
        self.lower, self.upper = self.kinematics.lower, self.kinematics.upper
        self._points = HumanPoints(self.finger_names, human_keypoints)
        self._vectors = TaskVectors(self.kinematics, self._pairs(), self.huber_delta, NORM_DELTA)
        self.reset()

    def reset(self) -> None:
        """Resets the state: joints in the middle of their ranges, no vector projected."""
        self._q = 0.5 * (self.lower + self.upper)
        self._answer: np.ndarray | None = None
        self._projected = np.zeros(len(self._vectors.pairs), dtype=bool)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Computes joint angles, rad, for successive hands; arguments and errors as for `Retargeter`."""
        p_HF = self._points(points)
        if p_HF.ndim == 2:
            return self._step(p_HF)
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
        from scipy.spatial import cKDTree

        frames = self._points(frames)
        self.reset()
        q, projected = [], []
        for frame in frames:
            self._step(frame)
            q.append(self._q)
            projected.append(self._projected)
        states = np.array(q), np.array(projected)
        tree = cKDTree(frames.reshape(len(frames), -1))

        def settled(p_HF: np.ndarray) -> np.ndarray:
            answers = np.empty((len(p_HF), len(self.joint_names)))
            for first in range(0, len(p_HF), CHUNK):
                hands = p_HF[first : first + CHUNK]
                _, nearest = tree.query(hands.reshape(len(hands), -1))
                answers[first : first + CHUNK] = self.settle(hands, *(state[nearest] for state in states))
            return answers

        return settled

    def settle(
        self, p_HF: np.ndarray, start: np.ndarray | None = None, projected: np.ndarray | None = None
    ) -> np.ndarray:
        """Computes the stationary joint angles (N, n), rad, for hands (N, F, 3), m, that are held still.

        `start` (N, n), rad, are initial joint angles, `projected` (N, V) marks projected vectors; both are by
        default those after `reset`. The regularisation towards previous angles vanishes at rest.
        """
        count = len(p_HF)
        if start is None:
            start = np.tile(0.5 * (self.lower + self.upper), (count, 1))
        if projected is None:
            projected = np.zeros((count, len(self._vectors.pairs)), dtype=bool)
        targets, weights, _ = self._targets(p_HF, projected)
        return self._vectors.solve(targets, weights, start, None)

    def _step(self, p_HF: np.ndarray) -> np.ndarray:
        targets, weights, projected = self._targets(p_HF[None], self._projected[None])
        previous = self._q[None]
        self._q = self._vectors.solve(targets, weights, previous, previous)[0]
        self._projected = projected[0]
        # a + (q − a) instead of q reproduces published figures bit for bit.
        self._answer = self._q if self._answer is None else self._answer + (self._q - self._answer)
        return np.clip(self._answer, self.lower, self.upper)

    def _pairs(self) -> list[tuple[int, int]]:
        return [(WRIST, finger) for finger in range(len(self.finger_names))]

    def _targets(self, p_HF: np.ndarray, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns target vectors (N, V, 3), m, weights (N, V) and new `projected` (N, V); p_HF (N, F, 3)."""
        targets = SCALE * self._vectors.human(p_HF)
        return targets, np.ones(targets.shape[:2]), projected


class DexPilotOnline(VectorOnline):
    """DexPilot's retargeting (Handa et al. 2020), which gives priority to distances between fingertips.

    It uses vectors between the thumb and each finger (S1), between these fingers (S2) and from the wrist.
    When the person's thumb comes near a finger, the target of their vector is projected to contact and gets a
    larger weight, with hysteresis. While two fingers pinch, the target between them keeps them apart.
    """

    huber_delta = 0.03  # m

    def _pairs(self) -> list[tuple[int, int]]:
        if "thumb" not in self.finger_names or len(self.finger_names) < 2:
            raise HandError(
                f"DexPilot needs a thumb and another finger, this hand has {', '.join(self.finger_names)}"
            )
        thumb = self.finger_names.index("thumb")
        others = [finger for finger in range(len(self.finger_names)) if finger != thumb]
        pinches = [(thumb, finger) for finger in others]
        between = [(a, b) for k, a in enumerate(others) for b in others[k + 1 :]]
        # For each finger-finger vector, the two thumb-finger vectors that switch its projection.
        self._switching = np.array([(others.index(a), others.index(b)) for a, b in between], dtype=int)
        return pinches + between + super()._pairs()

    def _targets(self, p_HF: np.ndarray, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        fingers = len(self.finger_names)
        pinches, pairs = fingers - 1, len(self._vectors.pairs) - fingers
        human = self._vectors.human(p_HF)
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


def _make(method: type[VectorOnline]) -> Callable:
    return lambda kinematics, human_keypoints, _frames, _seed: method(kinematics, human_keypoints)


METHODS = (
    UntrainedMethod("vector_online", "AnyTeleop's vectors, optimised at every frame", _make(VectorOnline)),
    UntrainedMethod("dexpilot_online", "DexPilot's vectors, optimised at every frame", _make(DexPilotOnline)),
)

"""Retargeters that optimise joint angles at every frame: AnyTeleop's vectors and DexPilot.

Both follow Eq. 1 of the GeoRT paper with hand-made scale, weights and task vectors, start from the
joint angles of the frame before and are pulled towards them, so what they answer depends on the past.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.errors import GeortError, HandError
from geort_drake.retargeting.human_points import HumanPoints
from geort_drake.retargeting.method import UntrainedMethod
from geort_drake.retargeting.methods.task_vectors import WRIST, TaskVectors
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics

# Metrics ask for many frames at once; more than this side by side would not fit the cache.
CHUNK = 1024


@dataclass(frozen=True)
class VectorConfig:
    """Settings of `VectorOnline`; the defaults are dex-retargeting's for the Allegro hand."""

    scale: float = 1.6  # α, robot over human
    huber_delta: float = 0.02  # m
    norm_delta: float = 4e-3  # 1/rad², pull towards the previous joint angles
    low_pass: float = 1.0  # share of the new answer, 1 is off; 0.2 is shipped: a lag of 4 frames

    def validate(self) -> None:
        """Raises GeortError where a value makes no sense."""
        for name in ("scale", "huber_delta", "norm_delta", "low_pass"):
            value = getattr(self, name)
            if not (np.isfinite(value) and (value > 0 or (name == "norm_delta" and value == 0))):
                raise GeortError(f"online retargeting: {name} must be positive, it is {value}")
        if self.low_pass > 1:
            raise GeortError(f"online retargeting: low_pass must be at most 1, it is {self.low_pass}")


@dataclass(frozen=True)
class DexPilotConfig(VectorConfig):
    """Settings of `DexPilotOnline`; weights and distances are Handa et al.'s."""

    huber_delta: float = 0.03  # m
    project: float = 0.03  # m, a thumb-finger distance under this is projected
    escape: float = 0.05  # m, until it is over this
    pinch_distance: float = 1e-4  # m, η1: length of a projected thumb-finger vector
    apart_distance: float = 3e-2  # m, η2: length of a projected finger-finger vector
    pinch_weight: float = 200.0
    apart_weight: float = 400.0

    def validate(self) -> None:
        super().validate()
        if not 0 < self.project <= self.escape:
            raise GeortError(
                f"online retargeting: 0 < project <= escape is wanted, "
                f"they are {self.project} and {self.escape} m"
            )


class VectorOnline:
    """AnyTeleop's retargeting (Qin et al. 2023): scaled vectors from the wrist to every fingertip.

    Stateful: a call continues where the previous one ended, and a batch is a sequence of frames.
    Not safe to share between threads.

    Attributes:
        finger_names: F fingers, in the order of the inputs.
        joint_names: n joints, in the order of the outputs.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
    """

    config_type: type[VectorConfig] = VectorConfig

    def __init__(
        self,
        kinematics: "HandKinematics | NumpyKinematics",
        config: VectorConfig | None = None,
        human_keypoints: Sequence[int] | None = None,
    ):
        """Makes a retargeter at rest.

        Args:
            kinematics: `HandKinematics` or `NumpyKinematics` of the robot hand, mirrored for a left one.
            config: settings; None takes the defaults.
            human_keypoints: keypoint of each finger's tip; None goes by the fingers' names.

        Raises:
            GeortError: a setting makes no sense, or a finger's name has no keypoint.
        """
        self.config = config or self.config_type()
        self.config.validate()
        self.kinematics = NumpyKinematics.of(kinematics)
        self.finger_names, self.joint_names = self.kinematics.finger_names, self.kinematics.joint_names
        self.lower, self.upper = self.kinematics.lower, self.kinematics.upper
        self._points = HumanPoints(self.finger_names, human_keypoints)
        self._vectors = TaskVectors(
            self.kinematics,
            self._pairs(),
            self.config.huber_delta,
            self.config.norm_delta,
        )
        self.reset()

    def reset(self) -> None:
        """Forgets the past: joints in the middle of their ranges, nothing projected."""
        self._q = 0.5 * (self.lower + self.upper)
        self._filtered: np.ndarray | None = None
        self._projected = np.zeros(len(self._vectors.pairs), dtype=bool)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Joint angles in rad for human hands, one after the other.

        Args:
            points: fingertips p_HF (F, 3) or (N, F, 3), or whole hands p_HK (21, 3) or (N, 21, 3),
                in the wrist frame H, m.

        Returns:
            (n,) or (N, n).

        Raises:
            ValueError: points have another shape.
            GeortError: a coordinate is not finite.
        """
        p_HF = self._points(points)
        if p_HF.ndim == 2:
            return self._step(p_HF)
        return np.array([self._step(row) for row in p_HF]).reshape(len(p_HF), len(self.joint_names))

    def settled_map(self, frames: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The answers to hands that are held still, as a function without memory.

        A method that optimises answers one frame depending on the frames before it. To ask what it
        does with a hand that differs a little from a recorded one, the hand is held until the answer
        no longer changes, starting from the state that the method had at the nearest recorded frame.

        Args:
            frames: (T, F, 3) successive human fingertips, m; the retargeter is left as after them.

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
        """Joint angles (N, n) at which the method comes to rest for hands (N, F, 3) that are held still.

        `start` (N, n) are joint angles to begin with, `projected` (N, V) the vectors projected so far;
        by default those after `reset`. At rest the pull towards the previous angles vanishes.
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
        if self._filtered is None:
            self._filtered = self._q
        self._filtered = self._filtered + self.config.low_pass * (self._q - self._filtered)
        return np.clip(self._filtered, self.lower, self.upper)

    def _pairs(self) -> list[tuple[int, int]]:
        return [(WRIST, finger) for finger in range(len(self.finger_names))]

    def _targets(self, p_HF: np.ndarray, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wanted vectors (N, V, 3), weights (N, V) and the switches (N, V) after these frames."""
        targets = self.config.scale * self._vectors.human(p_HF)
        return targets, np.ones(targets.shape[:2]), projected


class DexPilotOnline(VectorOnline):
    """DexPilot's retargeting (Handa et al. 2020): fingertips against each other come first.

    Vectors between the thumb and each finger (S1), between these fingers (S2) and from the wrist. When
    the person's thumb comes near a finger their vector's target is projected to contact and weighs
    more, with hysteresis; while two fingers pinch, the target between them keeps them apart.
    """

    config_type = DexPilotConfig
    config: DexPilotConfig

    def _pairs(self) -> list[tuple[int, int]]:
        if "thumb" not in self.finger_names or len(self.finger_names) < 2:
            raise HandError(
                f"DexPilot needs a thumb and another finger, this hand has {', '.join(self.finger_names)}"
            )
        thumb = self.finger_names.index("thumb")
        others = [finger for finger in range(len(self.finger_names)) if finger != thumb]
        pinches = [(thumb, finger) for finger in others]
        between = [(a, b) for k, a in enumerate(others) for b in others[k + 1 :]]
        # For each finger-finger vector, the two thumb-finger vectors that decide about it.
        self._deciding = np.array([(others.index(a), others.index(b)) for a, b in between], dtype=int)
        return pinches + between + super()._pairs()

    def _targets(self, p_HF: np.ndarray, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        config, fingers = self.config, len(self.finger_names)
        pinches, pairs = fingers - 1, len(self._vectors.pairs) - fingers
        human = self._vectors.human(p_HF)
        distance = np.sqrt((human[:, :pairs] ** 2).sum(-1))
        near = projected.copy()
        first = distance[:, :pinches]
        near[:, :pinches] = np.where(
            first < config.project, True, near[:, :pinches] & (first <= config.escape)
        )
        if len(self._deciding):
            both = near[:, self._deciding[:, 0]] & near[:, self._deciding[:, 1]]
            near[:, pinches:pairs] = both & (distance[:, pinches:] <= config.project)
        length = np.full(pairs, config.pinch_distance)
        length[pinches:] = config.apart_distance
        heavy = np.full(pairs, config.pinch_weight)
        heavy[pinches:] = config.apart_weight
        switched = near[:, :pairs]
        targets = config.scale * human
        direction = human[:, :pairs] / (distance[..., None] + 1e-6)
        targets[:, :pairs] = np.where(switched[..., None], direction * length[:, None], targets[:, :pairs])
        # Without projection the wrist's vectors lead, as in dex-retargeting.
        weights = np.full(human.shape[:2], float(pairs + fingers))
        weights[:, :pairs] = np.where(switched, heavy, 1.0)
        return targets, weights, near


def _make(method: type[VectorOnline]) -> Callable:
    def make(
        kinematics: "HandKinematics | NumpyKinematics",
        human_keypoints: Sequence[int] | None,
        _frames: np.ndarray | None,
        _seed: int,
        **settings: float,
    ) -> VectorOnline:
        return method(kinematics, method.config_type(**settings), human_keypoints)

    return make


METHODS = tuple(
    UntrainedMethod(
        name,
        f"{whose} vectors, optimised at every frame",
        _make(method),
        tuple(item.name for item in dataclasses.fields(method.config_type)),
    )
    for name, whose, method in (
        ("vector_online", "AnyTeleop's", VectorOnline),
        ("dexpilot_online", "DexPilot's", DexPilotOnline),
    )
)

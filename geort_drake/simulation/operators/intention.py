"""Kinds of people, their parameters, and how a person learns the robot's response to their motion."""

import dataclasses as dc
import math

import numpy as np

from geort_drake.settings import require_numbers
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.perception import FreePlay

# How a person moves a fingertip of the robot. SERVO corrects all seen errors, as if robot and own fingers had
# the same directions. MIMICRY makes the motion with the own finger and corrects little. ADAPTIVE makes the
# motion that it has learned to make the robot's, and corrects. The last two look at one finger at a time.
SERVO, MIMICRY, ADAPTIVE = "servo", "mimicry", "adaptive"


@dc.dataclass
class IntentionConfig:
    """A person with an intention, besides `OperatorConfig`.

    Sources: [F54] Fitts 1954, time of aimed movements; [H52] Hick 1952, time to choose; [R98] Rayner 1998,
    fixations; [K00] Krakauer et al. 2000, adaptation to rotated and scaled motion; [B02] as in
    `OperatorConfig`.
    """

    # Duration of a press or a release, s: 10 mm to within 3 mm are 2.7 bits of 0.1 s each [F54].
    press_time: float = 0.27
    # Time from a seen cue to the press, s: one of four, none included, is 2 bits of 0.15 s each [H52].
    choice_time: float = 0.3
    # Shortest time between two changes of the finger that is looked at, s; fixations take 0.2 to 0.3 s [R98].
    attention_time: float = 0.25
    # Correction of a mimic, 1/s: a fifth of the servo's. An assumption.
    mimicry_rate: float = 0.5
    # Standard deviation of each entry of the Jacobian that an adaptive person expects around one before free
    # play, and that it drifts by in a second. Rotations of 30° and gains of 1.5 are learned [K00].
    jacobian_spread: float = 0.5
    jacobian_drift: float = 0.02
    # Time between two comparisons of own and robot's motion, s, and the least own motion compared, m.
    # Assumptions; the time is that of a fixation.
    comparison_time: float = 0.25
    least_motion: float = 0.005
    # Free play teaches the motion within this distance of the own posture, m. An assumption.
    neighbourhood: float = 0.04
    # A finger whose key is not seen to go down is pushed further at this speed, m/s, at most so far, m.
    # Assumptions.
    push_speed: float = 0.02
    most_push: float = 0.02
    # A finger that is seen to press without a cue is raised by this, m. An assumption.
    lift: float = 0.004
    # An object is carried to within this distance of the point above its place, m, and lowered to this far
    # below the seen place, m, so that it is felt to stand. Both are about the error of vision [B02].
    place_tolerance: float = 0.003
    place_overshoot: float = 0.005

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "intention")


@dc.dataclass(frozen=True)
class LearnedMotion:
    """A person's estimate of robot fingertip motion per own fingertip motion, finger by finger.

    A Kalman filter of the Jacobian's rows, which share a covariance. It begins at one.

    Attributes:
        J: (F, 3, 3) robot's motion in B per own motion in H.
        P: (F, 3, 3) covariance of each row.
    """

    J: np.ndarray
    P: np.ndarray

    @classmethod
    def unlearned(cls, num_fingers: int, config: IntentionConfig) -> "LearnedMotion":
        """Robot and own fingers move alike."""
        one = np.tile(np.eye(3), (num_fingers, 1, 1))
        return cls(one, config.jacobian_spread**2 * one)

    def compared(
        self, finger: int, own: np.ndarray, robot: np.ndarray, noise: float, elapsed: float, drift: float
    ) -> "LearnedMotion":
        """The estimate after a comparison of own and robot's motion (3,), m.

        Args:
            noise: standard deviation of the seen motion, m.
            elapsed: time since the last comparison, s.
            drift: standard deviation by which entries drift in a second.
        """
        J, P = self.J.copy(), self.P.copy()
        P[finger] += elapsed * drift**2 * np.eye(3)
        gain = P[finger] @ own / (own @ P[finger] @ own + noise**2)
        J[finger] += np.outer(robot - J[finger] @ own, gain)
        P[finger] -= np.outer(gain, P[finger] @ own)
        return LearnedMotion(J, P)

    def own_motion(self, finger: int, robot: np.ndarray) -> np.ndarray:
        """The own motion (3,), m, that is expected to move the robot's fingertip by `robot`, m.

        In directions in which the robot hardly moves, a third of the own motion is assumed.
        """
        U, s, Vt = np.linalg.svd(self.J[finger])
        return Vt.T @ ((U.T @ robot) / np.maximum(s, 1 / 3))


def motion_noise(config: OperatorConfig, elapsed: float) -> float:
    """Standard deviation of an axis of a motion that is seen over some time, s, in m."""
    variance = (2 * config.visual_noise**2 + config.visual_depth_noise**2) / 3
    kept = math.exp(-elapsed / config.visual_noise_time) if config.visual_noise_time else 0.0
    return math.sqrt(max(2 * variance * (1 - kept), 1e-8))


def learned_in_play(
    play: FreePlay,
    p_HF: np.ndarray,
    config: IntentionConfig,
    operator: OperatorConfig,
    rng: np.random.Generator,
) -> LearnedMotion:
    """What free play teaches about motion near own fingertips p_HF (F, 3), m."""
    step = max(1, round(config.comparison_time / play.period))
    noise = motion_noise(operator, config.comparison_time)
    own, robot = play.p_HF[::step], play.p_BF[::step]
    learned = LearnedMotion.unlearned(p_HF.shape[0], config)
    moved = np.diff(own, axis=0)
    near = np.linalg.norm(own[1:] - p_HF, axis=-1) < config.neighbourhood
    far_enough = np.linalg.norm(moved, axis=-1) > config.least_motion
    seen = np.diff(robot, axis=0) + rng.normal(0, noise, moved.shape)
    for t, finger in np.argwhere(near & far_enough):
        learned = learned.compared(finger, moved[t, finger], seen[t, finger], noise, 0.0, 0.0)
    return learned

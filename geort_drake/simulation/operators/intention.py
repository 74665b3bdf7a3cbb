"""Kinds of people, their parameters, and how a person learns the robot's response to their motion."""

import dataclasses as dc
import math

import numpy as np

from geort_drake.settings import require_numbers
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.perception import FreePlay

# How a person moves a robot fingertip. SERVO corrects all seen errors, as if the robot moved like the own
# fingers. MIMICRY makes the intended motion with the own finger and corrects little. ADAPTIVE makes the own
# motion that it has learned to cause the intended one, and corrects. The last two look at one finger at once.
SERVO, MIMICRY, ADAPTIVE = "servo", "mimicry", "adaptive"


@dc.dataclass
class IntentionConfig:
    """Parameters, besides `OperatorConfig`, of a person who makes intended motions.

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
    # Correction rate of MIMICRY, 1/s: a fifth of SERVO's. An assumption.
    mimicry_rate: float = 0.5
    # Standard deviation of each entry of the Jacobian around the identity that ADAPTIVE expects before free
    # play, and of its drift in a second. Rotations of 30° and gains of 1.5 are learned [K00].
    jacobian_spread: float = 0.5
    jacobian_drift: float = 0.02
    # Time between two comparisons of own and robot motion, s, and the least own motion compared, m.
    # Assumptions; the time is that of a fixation.
    comparison_time: float = 0.25
    least_motion: float = 0.005
    # ADAPTIVE learns from free play within this distance of the own fingertip, m. An assumption.
    neighbourhood: float = 0.04
    # A finger whose key is not seen to go down is pushed further, at `push_speed`, m/s, by at most
    # `most_push`, m. Assumptions.
    push_speed: float = 0.02
    most_push: float = 0.02
    # A finger that is seen to press without a cue is raised by this, m. An assumption.
    lift: float = 0.004
    # An object is carried to within `place_tolerance`, m, of the point above its place, and lowered to
    # `place_overshoot`, m, below the seen place, to be set down. Both are about the error of vision [B02].
    place_tolerance: float = 0.003
    place_overshoot: float = 0.005

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "intention")


@dc.dataclass(frozen=True)
class LearnedMotion:
    """A person's estimate of robot fingertip motion per own fingertip motion, finger by finger.

    A Kalman filter estimates the rows of each Jacobian, which share a covariance, from the identity on.

    Attributes:
        J: (F, 3, 3) Jacobians: robot motion in B per own motion in H.
        P: (F, 3, 3) covariance of each row of a Jacobian.
    """

    J: np.ndarray
    P: np.ndarray

    @classmethod
    def unlearned(cls, num_fingers: int, config: IntentionConfig) -> "LearnedMotion":
        """Returns the initial estimate, that robot and own fingers move alike."""
        one = np.tile(np.eye(3), (num_fingers, 1, 1))
        return cls(one, config.jacobian_spread**2 * one)

    def compared(
        self, finger: int, own: np.ndarray, robot: np.ndarray, noise: float, elapsed: float, drift: float
    ) -> "LearnedMotion":
        """Returns the estimate after a comparison of own and robot motion (3,), m.

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
        """Returns the own motion (3,), m, expected to move the robot's fingertip by `robot` (3,), m.

        The robot is assumed to move at least a third as far as the own finger in every direction.
        """
        U, s, Vt = np.linalg.svd(self.J[finger])
        return Vt.T @ ((U.T @ robot) / np.maximum(s, 1 / 3))


def motion_noise(config: OperatorConfig, elapsed: float) -> float:
    """Returns the standard deviation of a seen motion along an axis, m, over `elapsed` time, s."""
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
    """Returns what the person learns from free play near own fingertips p_HF (F, 3), m."""
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

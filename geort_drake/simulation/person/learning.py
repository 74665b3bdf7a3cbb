"""How a person learns the robot's response to their own motion."""

import dataclasses as dc
import functools
import math

import numpy as np

from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.person.perception import FreePlay


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
    def initial(cls, num_fingers: int, config: OperatorConfig) -> "LearnedMotion":
        """Returns the initial estimate, that robot and own fingers move alike."""
        identity = np.tile(np.eye(3), (num_fingers, 1, 1))
        return cls(identity, config.jacobian_spread**2 * identity)

    def compared(
        self, finger: int, human: np.ndarray, robot: np.ndarray, noise: float, elapsed: float, drift: float
    ) -> "LearnedMotion":
        """Returns the estimate after a comparison of own and robot motion (3,), m.

        Args:
            noise: standard deviation of the seen motion, m.
            elapsed: time since the last comparison, s.
            drift: standard deviation by which entries drift in a second.
        """
        J, P = self.J.copy(), self.P.copy()
        P[finger] += elapsed * drift**2 * np.eye(3)
        gain = P[finger] @ human / (human @ P[finger] @ human + noise**2)
        J[finger] += np.outer(robot - J[finger] @ human, gain)
        P[finger] -= np.outer(gain, P[finger] @ human)
        return LearnedMotion(J, P)

    def own_motion(self, finger: int, robot: np.ndarray) -> np.ndarray:
        """Returns the own motion (3,), m, expected to move the robot's fingertip by `robot` (3,), m.

        The robot is assumed to move at least a third as far as the own finger in every direction.
        """
        U, s, Vt = (part[finger] for part in self._decomposition)
        return Vt.T @ ((U.T @ robot) / np.maximum(s, 1 / 3))

    @functools.cached_property
    def _decomposition(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Singular value decomposition of J."""
        return np.linalg.svd(self.J)


def motion_noise(config: OperatorConfig, elapsed: float) -> float:
    """Returns the standard deviation of a seen motion along an axis, m, over `elapsed` time, s."""
    variance = (2 * config.visual_noise**2 + config.visual_depth_noise**2) / 3
    share = math.exp(-elapsed / config.visual_noise_time) if config.visual_noise_time else 0.0
    return math.sqrt(max(2 * variance * (1 - share), 1e-8))


def learn_in_play(
    play: FreePlay,
    p_HF: np.ndarray,
    config: OperatorConfig,
    rng: np.random.Generator,
) -> LearnedMotion:
    """Returns what the person learns from free play near own fingertips p_HF (F, 3), m."""
    step = max(1, round(config.comparison_time / play.period))
    noise = motion_noise(config, config.comparison_time)
    p_HF_play, p_BF_play = play.p_HF[::step], play.p_BF[::step]
    learned = LearnedMotion.initial(p_HF.shape[0], config)
    human_motion = np.diff(p_HF_play, axis=0)
    is_near = np.linalg.norm(p_HF_play[1:] - p_HF, axis=-1) < config.neighbourhood
    is_far = np.linalg.norm(human_motion, axis=-1) > config.least_motion
    robot_motion = np.diff(p_BF_play, axis=0) + rng.normal(0, noise, human_motion.shape)
    for t, finger in np.argwhere(is_near & is_far):
        learned = learned.compared(finger, human_motion[t, finger], robot_motion[t, finger], noise, 0.0, 0.0)
    return learned

"""What a person learns, from motion alone, of how far the robot's fingers go for the own ones."""

import dataclasses as dc

import numpy as np


@dc.dataclass(frozen=True)
class SensedGain:
    """What a person senses of the ratio between the robot's fingertip motion and the own.

    People take on a new visuomotor gain within a few movements (Krakauer et al. 2000). The ratio is one
    number for the whole hand: Σ |Δrobot| |Δown| / Σ |Δown|², over free motions between looks that are
    `interval` apart, beginning with the belief that the gain is one.
    """

    # Since the last look: its time, the own (F, 3) and the robot's (F, 3) fingertips in their hands' frames.
    t: float = -np.inf
    own: np.ndarray | None = None
    robot: np.ndarray | None = None
    # The two sums; m².
    product: float = 1e-4
    square: float = 1e-4

    interval = 0.25

    @property
    def ratio(self) -> float:
        """Robot motion over own motion."""
        return self.product / self.square

    def look(self, t: float, own: np.ndarray, robot: np.ndarray, free: np.ndarray) -> "SensedGain":
        """The estimate after a look at time t, s; fingers that touch something are not `free` (F,)."""
        if t - self.t < self.interval:
            return self
        if self.own is None or self.robot is None:
            return dc.replace(self, t=t, own=own, robot=robot)
        own_step = np.linalg.norm(own - self.own, axis=1)
        robot_step = np.linalg.norm(robot - self.robot, axis=1)
        # Smaller motions drown in the noise of what is seen.
        use = free & (own_step > 0.005)
        return SensedGain(
            t,
            own,
            robot,
            self.product + float((own_step * robot_step)[use].sum()),
            self.square + float((own_step**2)[use].sum()),
        )

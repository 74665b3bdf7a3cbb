"""Limits of joint positions, speeds and accelerations, and steps towards targets within them."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.errors import HandError
from geort_drake.retargeting.numpy_kinematics import MAX_ANGLE

# rad/s²; reaches 7 rad/s from rest in one update at 100 Hz.
DEFAULT_ACCELERATION = 700.0
# rad/s and rad/s²; outside of this range squares may overflow, and no motor reaches it.
_RATES = (1e-6, 1e12)


def _speed_to_target(
    q: np.ndarray,
    v: np.ndarray,
    target: np.ndarray,
    target_before: np.ndarray,
    period: float,
    low: np.ndarray,
    high: np.ndarray,
    stop_factor: np.ndarray,
) -> tuple[np.ndarray, bool]:
    """Returns the speed (n,) to the target, and whether the results of `_fast_path_bounds` allow it.

    A joint at v stops within v²/2a; if it stops inside the position limits, no later step has to leave them.
    """
    speed = (target - q) / period
    stop = target + speed * np.abs(speed) * stop_factor
    values = np.concatenate((speed, speed - v, target_before - q, stop))
    return speed, np.count_nonzero((low <= values) & (values <= high)) == values.size


@dc.dataclass(frozen=True)
class JointLimits:
    """Limits of position, speed and acceleration of n joints.

    Attributes:
        lower, upper: (n,) positions, rad, within ±100.
        speed: (n,) rad/s, or a number for all joints.
        acceleration: (n,) rad/s², or a number for all joints.

    Raises:
        HandError: a limit is not finite or out of range, a lower limit is not below the upper one, or
            the shapes do not fit.
    """

    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray | float = 7.0
    acceleration: np.ndarray | float = DEFAULT_ACCELERATION
    # Results of `_fast_path_bounds` by period.
    _bounds: dict[float, tuple[np.ndarray, ...]] = dc.field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def __post_init__(self) -> None:
        names = ("lower", "upper", "speed", "acceleration")
        given = [np.asarray(getattr(self, name), dtype=float) for name in names]
        try:
            values = np.broadcast_arrays(*given)
        except ValueError:
            shapes = ", ".join(f"{name} {value.shape}" for name, value in zip(names, given, strict=True))
            raise HandError(f"joint limits: the shapes do not fit: {shapes}") from None
        for name, value in zip(names, values, strict=True):
            object.__setattr__(self, name, value.copy())
        for name in ("lower", "upper"):
            if not (np.abs(value := getattr(self, name)) <= MAX_ANGLE).all():
                raise HandError(
                    f"joint limits: {name} must be finite and within ±{MAX_ANGLE:g} rad; given: {value}"
                )
        if not (self.lower < self.upper).all():
            raise HandError(f"joint limits: lower must be below upper; given: {self.lower} and {self.upper}")
        for name in ("speed", "acceleration"):
            value = getattr(self, name)
            if not ((_RATES[0] <= value) & (value <= _RATES[1])).all():
                raise HandError(
                    f"joint limits: {name} must be positive and finite, from {_RATES[0]:g} to {_RATES[1]:g}; "
                    f"given: {value}"
                )

    @classmethod
    def of_plant(
        cls,
        plant: MultibodyPlant,
        model: ModelInstanceIndex,
        speed: float = np.inf,
        acceleration: float = DEFAULT_ACCELERATION,
    ) -> "JointLimits":
        """Returns the limits of a model's actuated joints, in actuator order; at most `speed`, rad/s."""
        joints = [plant.get_joint_actuator(index).joint() for index in plant.GetJointActuatorIndices(model)]
        speeds = np.array([joint.velocity_upper_limit() for joint in joints])
        return cls(
            np.array([joint.position_lower_limit() for joint in joints]),
            np.array([joint.position_upper_limit() for joint in joints]),
            np.minimum(speeds, speed),
            acceleration,
        )

    def start(self, positions: Mapping[str, float], joints: Sequence[str]) -> np.ndarray:
        """Returns initial positions (n,), rad, in the order of the limits, after checks.

        Args:
            positions: joint name → rad; a joint without one starts at 0, and other joints' are ignored.
            joints: n names, in the order of the limits.

        Raises:
            HandError: a joint is given twice, the limits are of another number of joints, or a position is
                outside them.
        """
        if len(set(joints)) < len(joints):
            raise HandError(f"a joint is given twice: {', '.join(joints)}")
        if self.lower.shape != (len(joints),):
            raise HandError(f"joint limits: shape {self.lower.shape}, but {len(joints)} joints")
        q = np.array([positions.get(name, 0.0) for name in joints], dtype=float)
        for name, value, low, high in zip(joints, q, self.lower, self.upper, strict=True):
            if not low <= value <= high:
                raise HandError(
                    f"the initial position of '{name}' must be within [{low:g}, {high:g}] rad; "
                    f"given: {value:g}"
                )
        return q

    def step(
        self,
        q: np.ndarray,
        v: np.ndarray,
        target: np.ndarray,
        target_before: np.ndarray,
        period: float,
        share: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns positions and velocities after a period, as near to `target` as the limits allow.

        Speed is (q' − q) / period and acceleration (v' − v) / period. A joint without lag reaches a
        target within the limits exactly; a lagging one catches up at the highest speed from which it can
        brake in time. If q and v respect the limits, so do the results, for any targets.

        Args:
            q, v: (n,) present positions (rad) and velocities (rad/s); v = 0 at the start.
            target, target_before: (n,) finite targets after the period and now, rad.
            period: s.
            share: usable fraction of the speed limit; a faster joint slows down.
        """
        # Fast path: a target within all limits is reached.
        bounds = self._fast_path_bounds(period)
        speed, within = _speed_to_target(q, v, target, target_before, period, *bounds)
        if within and share == 1.0:
            return target, speed
        gain, lag = self.acceleration * period, target_before - q  # largest change of speed
        distance = np.array([np.abs(lag), self.upper - q, q - self.lower])
        to_target, to_upper, to_lower = self._braking_speed(distance, period)
        speed = np.minimum(np.maximum((target - target_before) / period, -self.speed), self.speed)
        speed += np.copysign(to_target, lag)
        top_speed = np.maximum(share * self.speed, np.abs(v) - gain)
        high = np.minimum(np.minimum(v + gain, top_speed), to_upper)
        low = np.maximum(np.maximum(v - gain, -top_speed), -to_lower)
        v = np.minimum(np.maximum(speed, low), high)
        # Clipped again because of rounding.
        return np.minimum(np.maximum(q + v * period, self.lower), self.upper), v

    def _fast_path_bounds(self, period: float) -> tuple[np.ndarray, ...]:
        """Returns bounds (4n,) of speed, its change, lag and stopping position, low and high; and 1/2a (n,).

        Cached, because computing them takes as long as a step.
        """
        if period not in self._bounds:
            gain = self.acceleration * period
            most = np.concatenate([self.speed, gain, gain * period])
            low, high = np.concatenate([-most, self.lower]), np.concatenate([most, self.upper])
            self._bounds[period] = (low, high, np.divide(0.5, self.acceleration))
        return self._bounds[period]

    def _braking_speed(self, distance: np.ndarray, period: float) -> np.ndarray:
        """Returns the highest speed from which a joint stops within `distance` (..., n), next step included.

        With speeds in units of a·period and distances in units of a·period², steps at x, x − 1, x − 2, …
        cover (m + 1) x − m (m + 1) / 2, where m is x rounded down.
        """
        unit = self.acceleration * period * period
        d = np.maximum(distance, 0.0) / unit
        m = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * d) - 1.0))
        return (d / (m + 1.0) + 0.5 * m) * self.acceleration * period

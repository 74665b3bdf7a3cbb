"""Limits of joint positions, speeds and accelerations, and steps towards targets within them."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex

from geort_drake.errors import HandError

# Shorter periods suffer from rounding in long sessions; longer ones are useless for control.
_PERIODS = (1e-5, 10.0)  # s
# Lower cutoffs would block all motion.
_CUTOFFS = (1e-3, 1e6)  # Hz


def check_timing(period: float, latency: float = 0.0, cutoff: float = 0.0) -> None:
    """Checks a period (s), a latency (s) and a low-pass cutoff (Hz, 0 for none).

    Raises:
        ValueError: a value is not finite or out of range.
    """
    low, high = _PERIODS
    if not low <= period <= high:
        raise ValueError(f"period must be from {low:g} to {high:g} s, not {period}")
    if not 0.0 <= latency <= high:
        raise ValueError(f"latency must be from 0 to {high:g} s, not {latency}")
    low, high = _CUTOFFS
    if not (cutoff == 0.0 or low <= cutoff <= high):
        raise ValueError(f"cutoff must be 0, or from {low:g} to {high:g} Hz, not {cutoff}")


DEFAULT_SPEED = 7.0  # rad/s
# rad/s²; reaches 7 rad/s from rest in one update at 100 Hz.
DEFAULT_ACCELERATION = 700.0


def actuated_joints(plant: MultibodyPlant, model: ModelInstanceIndex) -> list[Joint]:
    """Returns the actuated joints of a model, in the order of its actuators and ports.

    Raises:
        HandError: `model` is not of the plant or has no actuators, or the plant is not finalized.
    """
    # Drake ends the process where an instance is not of the plant.
    if not isinstance(model, ModelInstanceIndex) or int(model) >= plant.num_model_instances():
        raise HandError(
            f"model must be a model instance of the plant, such as add_hand_model returns: {model!r:.60}"
        )
    indices = plant.GetJointActuatorIndices(model) if plant.is_finalized() else []
    if not indices:
        raise HandError(
            f"the model '{plant.GetModelInstanceName(model)}' has no actuated joints in a finalized plant"
        )
    return [plant.get_joint_actuator(index).joint() for index in indices]


@dc.dataclass(frozen=True)
class JointLimits:
    """Limits of position, speed and acceleration of n joints.

    Attributes:
        lower, upper: (n,) positions, rad.
        speed: (n,) rad/s, or a number for all joints.
        acceleration: (n,) rad/s², or a number for all joints.

    Raises:
        HandError: a limit is not finite, a lower limit is not below the upper one, a speed or acceleration is
            not positive, or the shapes do not fit.
    """

    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray | float = DEFAULT_SPEED
    acceleration: np.ndarray | float = DEFAULT_ACCELERATION

    def __post_init__(self) -> None:
        limits = {field.name: np.asarray(getattr(self, field.name), float) for field in dc.fields(self)}
        try:
            arrays = np.broadcast_arrays(*limits.values())
        except ValueError:
            shapes = ", ".join(f"{name} {value.shape}" for name, value in limits.items())
            raise HandError(f"joint limits: the shapes do not fit: {shapes}") from None
        for name, value in zip(limits, arrays, strict=True):
            if not np.isfinite(value).all():
                raise HandError(f"joint limits: {name} must be finite; given: {value}")
            object.__setattr__(self, name, value.copy())
        if not (self.lower < self.upper).all():
            raise HandError(f"joint limits: lower must be below upper; given: {self.lower} and {self.upper}")
        for name in ("speed", "acceleration"):
            if not (getattr(self, name) > 0).all():
                raise HandError(f"joint limits: {name} must be positive; given: {getattr(self, name)}")

    @classmethod
    def of_plant(
        cls,
        plant: MultibodyPlant,
        model: ModelInstanceIndex,
        speed: float = np.inf,
        acceleration: float = DEFAULT_ACCELERATION,
    ) -> "JointLimits":
        """Returns the limits of a model's actuated joints, in actuator order; at most `speed`, rad/s.

        The speed of a joint is the smaller one of both directions.

        Raises:
            HandError: a joint has limits that commands cannot respect; or as `actuated_joints`.
        """
        joints = actuated_joints(plant, model)
        for joint in joints:
            low, high = joint.position_lower_limit(), joint.position_upper_limit()
            if not -np.inf < low < high < np.inf:
                raise HandError(
                    f"the position limits of '{joint.name()}' must be finite and apart: {low}, {high}"
                )
            low, high = joint.velocity_lower_limit(), joint.velocity_upper_limit()
            if not low < 0.0 < high:
                raise HandError(
                    f"the velocity limits of '{joint.name()}' must be on both sides of 0: {low}, {high}"
                )
        return cls(
            np.array([joint.position_lower_limit() for joint in joints]),
            np.array([joint.position_upper_limit() for joint in joints]),
            np.minimum(
                [min(joint.velocity_upper_limit(), -joint.velocity_lower_limit()) for joint in joints], speed
            ),
            acceleration,
        )

    def start(self, positions: Mapping[str, float], joints: Sequence[str]) -> np.ndarray:
        """Returns initial positions (n,), rad, in the order of the limits, after checks.

        Args:
            positions: joint name → rad; a joint without one starts at 0, and other joints' are ignored.
            joints: n names, in the order of the limits.

        Raises:
            HandError: the limits are of another number of joints, or a position is outside them.
        """
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
        gain, lag = self.acceleration * period, target_before - q  # gain: largest change of speed
        if share == 1.0:
            # A target within all limits is reached. A joint at v stops within v²/2a; if it stops inside the
            # position limits, no later step has to leave them.
            v_target = (target - q) / period
            stop = target + v_target * np.abs(v_target) * (0.5 / self.acceleration)
            room = [
                self.speed - np.abs(v_target),
                gain - np.abs(v_target - v),
                gain * period - np.abs(lag),
                stop - self.lower,
                self.upper - stop,
            ]
            if np.min(room) >= 0.0:
                return target, v_target
        distance = np.array([np.abs(lag), self.upper - q, q - self.lower])
        to_target, to_upper, to_lower = self._braking_speed(distance, period)
        speed = np.clip((target - target_before) / period, -self.speed, self.speed)
        speed += np.copysign(to_target, lag)
        top_speed = np.maximum(share * self.speed, np.abs(v) - gain)
        high = np.minimum(np.minimum(v + gain, top_speed), to_upper)
        low = np.maximum(np.maximum(v - gain, -top_speed), -to_lower)
        v = np.minimum(np.maximum(speed, low), high)
        # Clipped again because of rounding.
        return np.clip(q + v * period, self.lower, self.upper), v

    def _braking_speed(self, distance: np.ndarray, period: float) -> np.ndarray:
        """Returns the highest speed from which a joint stops within `distance` (..., n), next step included.

        With speeds in units of a·period and distances in units of a·period², steps at x, x − 1, x − 2, …
        cover (m + 1) x − m (m + 1) / 2, where m is x rounded down.
        """
        unit = self.acceleration * period * period
        d = np.maximum(distance, 0.0) / unit
        m = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * d) - 1.0))
        return (d / (m + 1.0) + 0.5 * m) * self.acceleration * period

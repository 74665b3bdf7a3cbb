"""Steps a system or a diagram alone, and checks its commands."""

import copy
from functools import cache
from typing import Any

import numpy as np
from faults.sound import JOINTS, LOWER, UPPER, smooth_retargeter
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import PortDataType, System

from geort_drake import RetargetingSystem
from geort_drake.systems.joint_limits import JointLimits


class SystemBench:
    """A system that is stepped update by update; by default a tick ends between two updates."""

    def __init__(self, system: System, period: float = 0.01, phase: float = 0.5):
        self.system, self.period, self.ticks, self._phase = system, period, 0, phase
        self.simulator = Simulator(system)
        self.context = self.simulator.get_mutable_context()

    def fix(self, **inputs: Any) -> None:
        """Sets input ports to numbers, arrays or objects."""
        for name, value in inputs.items():
            port = self.system.GetInputPort(name)
            is_vector = port.get_data_type() == PortDataType.kVectorValued
            port.FixValue(self.context, np.ravel(value) if is_vector else AbstractValue.Make(value))

    def advance(self) -> None:
        """Goes on by a period."""
        self.simulator.AdvanceTo((self.ticks + self._phase) * self.period)
        self.ticks += 1

    def value(self, port: str, system: System | None = None) -> Any:
        """A copy of what an output port has, of the system or of one in it."""
        system = system or self.system
        return copy.copy(system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.context)))


START = 0.3  # rad, of every joint


@cache
def joint_plant(joint_names: tuple[str, ...]) -> tuple[MultibodyPlant, ModelInstanceIndex]:
    """A plant of one model, whose actuators move joints of these names, in this order."""
    plant = MultibodyPlant(0.01)
    model = plant.AddModelInstance("hand")
    for name in joint_names:
        link = plant.AddRigidBody(name, model, SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
        joint = RevoluteJoint(name, plant.world_frame(), link.body_frame(), [0, 0, 1], -2.0, 2.0)
        plant.AddJointActuator(name, plant.AddJoint(joint))
    plant.Finalize()
    return plant, model


class Bench(SystemBench):
    """Steps a `RetargetingSystem` update by update; functions without joint names have `JOINTS`."""

    def __init__(self, retarget=None, period=0.01, stamped=False, start=START, **options):
        self.limits = options.pop("limits", JointLimits(LOWER, UPPER))
        retarget = retarget or smooth_retargeter()
        joints = tuple(getattr(retarget, "joint_names", JOINTS))
        start = dict(zip(joints, start + np.zeros(len(joints)), strict=True))
        system = RetargetingSystem(
            retarget, *joint_plant(joints), joint_names=joints, initial_positions=start, period=period,
            limits=self.limits, **options,
        )  # fmt: skip
        super().__init__(system, period)
        self.stamped = stamped

    def tick(self, keypoints, valid=1.0, stamp=None):
        """One update; returns positions, velocities and the status after it."""
        self.fix(keypoints=keypoints, valid=valid, **({"stamp": stamp} if self.stamped else {}))
        self.advance()
        return *np.split(self.value("desired_state"), 2), self.value("status")


class Watch:
    """Checks every command against the limits and the command before it.

    Args:
        start: positions before the first command, rad; a number for all joints.
    """

    def __init__(self, limits: JointLimits, period: float, start: np.ndarray | float = START):
        self._limits, self._period = limits, period
        self._q, self._v = start + np.zeros(len(limits.lower)), np.zeros(len(limits.lower))

    def broken(self, q: np.ndarray, v: np.ndarray) -> list[str]:
        """Returns the guarantees that the next positions (rad) and velocities (rad/s) break."""
        limits, period = self._limits, self._period
        checks = {
            "finite": bool(np.isfinite(q).all() and np.isfinite(v).all()),
            "position": bool(((limits.lower <= q) & (q <= limits.upper)).all()),
            "speed": bool((np.abs(q - self._q) <= (limits.speed + 1e-9) * period).all()),
            "consistent velocity": bool((np.abs((q - self._q) / period - v) <= 1e-9).all()),
            "acceleration": bool((np.abs(v - self._v) <= limits.acceleration * period + 1e-9).all()),
        }
        self._q, self._v = q, v
        return [name for name, kept in checks.items() if not kept]

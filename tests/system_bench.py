"""Steps a system or a diagram alone."""

import copy
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import PortDataType, System


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

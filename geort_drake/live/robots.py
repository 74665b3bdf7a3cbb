"""Robots: simulated in the diagram, real ones behind a bus, and a stand-in for a real one's driver."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteStateIndex,
    DiscreteValues,
    EventStatus,
    InputPort,
)

from geort_drake.errors import LiveError
from geort_drake.hands.description import load_hand
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.joint_messages import MAX_HOLD_AFTER, Bus, JointState, JointTargets
from geort_drake.live.robot_buses import open_bus
from geort_drake.live.transports import wait_for
from geort_drake.live.watchdog import AFTER
from geort_drake.simulation.following import JointGroup, RobotModel, robot_model
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import ARM, HAND, actuated_state
from geort_drake.systems.python_system import PythonSystem

# Time between statuses, s.
STATUS_PERIOD = 0.004


class SimulatedRobot:
    """Simulates a scenario's arm, hand and task; the scenario's seed places the object.

    Input ports of `diagram`:
        hand_desired_state (2n), arm_desired_state (2m): joint positions (rad), then velocities (rad/s),
            in the plant's actuator order.
    Output ports:
        hand_state (2n), arm_state (2m): measured positions (rad), then velocities (rad/s), in the same order.
        body_poses (abstract list of RigidTransform): X_WB by the plant's body index.

    Attributes:
        diagram: the simulation; not a base class, as Drake never frees subclasses in Python (drake#24162).
        stage: the task's stage.

    Args:
        scenario: task, arm and simulation settings.
        model: the robot's model.
        meshcat: viewer that shows the scene, if any.

    Raises:
        ScenarioError, HandError: scenario and models do not fit together.
    """

    def __init__(self, scenario: Scenario, model: RobotModel, meshcat: Meshcat | None = None):
        builder = DiagramBuilder()
        rng = np.random.default_rng(scenario.random_seed)
        task = find_task(scenario.task)
        self.stage = task.add_stage(builder, scenario, model.description, None, model.X_WB, rng)
        plant, hand, arm = self.stage.plant, self.stage.hand, self.stage.arm
        for instance, name in ((hand, HAND), (arm, ARM)):
            builder.ExportInput(plant.get_desired_state_input_port(instance), f"{name}_desired_state")
            builder.ExportOutput(actuated_state(builder, plant, instance), f"{name}_state")
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(builder, self.stage.scene_graph, meshcat)
        builder.ExportOutput(plant.get_body_poses_output_port(), "body_poses")
        self.diagram = builder.Build()


def open_meshcat() -> Meshcat:
    """Returns a viewer that only this machine can reach."""
    return Meshcat(MeshcatParams(host="localhost"))


class JointServer(PythonSystem):
    """Replaces a robot's driver: follows the newest joint targets and publishes the joints' state.

    It follows positions only, with desired velocities of zero, so the joints lag. Targets are clamped to the
    limits. The robot holds its last command when no more come.

    Input ports:
        hand_state (2n), arm_state (2m): measured positions (rad), then velocities (rad/s), in the order of
            `groups`.
    Output ports:
        hand_desired_state (2n), arm_desired_state (2m): joint positions (rad), then velocities (rad/s).

    State: the commanded positions, rad; before the first command, the initial positions.

    Attributes:
        bus: the bus, which counts what it refuses.

    Args:
        bus: the driver's end of a bus.
        groups: the joints of hand and arm.
    """

    def __init__(self, bus: Bus[JointState, JointTargets], groups: Sequence[JointGroup]):
        super().__init__()
        self.bus, self._groups, self._sequence = bus, list(groups), 0
        self._measured = [self.DeclareVectorInputPort(f"{g.name}_state", 2 * len(g.joints)) for g in groups]
        self._commanded = [self.DeclareDiscreteState(group.start) for group in groups]
        for group, index in zip(groups, self._commanded, strict=True):
            self.DeclareVectorOutputPort(
                f"{group.name}_desired_state",
                2 * len(group.joints),
                lambda context, output, index=index: self._calc_desired(context, output, index),
                {self.discrete_state_ticket(index)},
            )
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(STATUS_PERIOD, 0.0, self._publish)

    def _calc_desired(self, context: Context, output: BasicVector, index: DiscreteStateIndex) -> None:
        q = context.get_discrete_state(index).value()
        output.SetFromVector(np.concatenate([q, np.zeros_like(q)]))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        positions: dict[str, float] = {}
        for targets in self.bus.fetch():
            positions |= dict(zip(targets.names, targets.position, strict=True))
        for group, index in zip(self._groups, self._commanded, strict=True):
            q = context.get_discrete_state(index).value()
            q = np.array(
                [positions.get(name, float(q_old)) for name, q_old in zip(group.joints, q, strict=True)]
            )
            discrete_state.get_mutable_vector(index).SetFromVector(np.clip(q, group.lower, group.upper))
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        q, v = np.concatenate([port.Eval(context).reshape(2, -1) for port in self._measured], axis=1)
        names = [name for group in self._groups for name in group.joints]
        self._sequence += 1
        self.bus.send(JointState(self._sequence, time.monotonic(), names, q.tolist(), v.tolist()))
        return EventStatus.Succeeded()


def make_stand_in(scenario: Scenario, address: str, meshcat: Meshcat | None = None) -> Diagram:
    """Builds a diagram that simulates the scenario's robot behind an address; run it in real time.

    Raises:
        ScenarioError, HandError: scenario and models do not fit, or the hand has no LCM messages.
        LiveError: the address is malformed.
    """
    description = load_hand(scenario.hand)
    builder, model = DiagramBuilder(), robot_model(scenario, description)
    robot = builder.AddNamedSystem("robot", SimulatedRobot(scenario, model, meshcat).diagram)
    groups = (model.hand, model.arm)
    server = builder.AddNamedSystem(
        "server", JointServer(open_bus(address, description, driver=True), groups)
    )
    for group in groups:
        state, desired = f"{group.name}_state", f"{group.name}_desired_state"
        builder.Connect(robot.GetOutputPort(state), server.GetInputPort(state))
        builder.Connect(server.GetOutputPort(desired), robot.GetInputPort(desired))
    diagram = builder.Build()
    diagram.set_name("stand_in_robot")
    return diagram


# Largest distance of a measured joint from its limits, rad; beyond it, the robot is not the model's.
_TOLERANCE = 0.1
# Number of periods without targets after which a driver holds.
_HOLD_PERIODS = 10


class RobotLink(PythonSystem):
    """Sends joint targets to a robot's driver and receives the robot's joint states, over any `Bus`.

    States are read every `POLL_PERIOD`. Targets are sent every `period`, as soon as they are computed. A
    robot without the model's arm is a hand alone: the arm stays in its initial position, and no targets are
    sent for it.

    Input ports:
        hand_desired_state (2n), arm_desired_state (2m): joint positions (rad), then velocities (rad/s), in
            the order of `hand` and `arm`.
        engaged (1): 1 while the robot follows the person, 0 while it holds.
    Output ports:
        hand_state (2n), arm_state (2m): measured positions (rad), then velocities (rad/s), in the same order;
            NaN before the first state.

    State: the values of the output ports.

    Attributes:
        bus: the bus, which counts what it refuses.

    Args:
        bus: where the driver listens.
        hand, arm: the model's joints.
        period: time between targets, s.
        clock: monotonic clock, s.
    """

    def __init__(
        self,
        bus: Bus[JointTargets, JointState],
        hand: JointGroup,
        arm: JointGroup,
        period: float,
        clock: Callable[[], float] = time.monotonic,
    ):
        super().__init__()
        self.bus, self._clock = bus, clock
        self._hold_after = min(_HOLD_PERIODS * period, MAX_HOLD_AFTER)
        self._measured: dict[str, tuple[float, float]] = {}  # joint → position, velocity
        self._arrived: dict[str, float] = {}
        self._sequence, self._fault = 0, ""
        self._groups = [hand, arm]
        self._ports = [self._declare_group(group) for group in self._groups]
        self._engaged = self.DeclareVectorInputPort("engaged", 1)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._publish)

    def handshake(self, timeout_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Waits for the robot's first states and checks that they fit the model.

        Returns:
            Positions of hand (n,) and arm (m,), rad, in the order of the ports, clamped to their limits.

        Raises:
            LiveError: no state of all joints came in time, or a joint is far outside its limits.
        """

        def poll() -> bool | None:
            self._fetch()
            return None if self._missing() else True

        wait_for(poll, timeout_s, lambda: self._silence(timeout_s))
        self._groups = [group for group, _, _ in self._ports if self._has(group)]
        return self._start(self._ports[0][0]), self._start(self._ports[1][0])

    def require_alive(self, silence_s: float) -> None:
        """Raises LiveError if a joint's state has not come for `silence_s`, s, or the robot has a fault."""
        if self._fault:
            raise LiveError(f"the robot reports a fault: {self._fault}; commands have stopped")
        for group in self._groups:
            name = min(group.joints, key=lambda name: self._arrived[name])
            if (silent := self._clock() - self._arrived[name]) > silence_s:
                raise LiveError(
                    f"{group.name}: no state of {name} for {silent:.1f} s; commands have stopped, because "
                    f"the robot may be elsewhere when it comes back{self._refusals()}"
                )

    def _has(self, group: JointGroup) -> bool:
        return bool(group.joints) and all(name in self._measured for name in group.joints)

    def _missing(self) -> list[str]:
        """Returns the joints that have no state yet: those of the hand, and of an arm if there is one."""
        hand, arm = (group for group, _, _ in self._ports)
        has_arm = self.bus.arm_is_required or any(name in self._measured for name in arm.joints)
        required = [*hand.joints, *(arm.joints if has_arm else [])]
        return [name for name in required if name not in self._measured]

    def _start(self, group: JointGroup) -> np.ndarray:
        if group not in self._groups:
            return group.start
        q = np.array([self._measured[name][0] for name in group.joints])
        clamped = np.clip(q, group.lower, group.upper)
        worst = int(np.argmax(np.abs(q - clamped)))
        if abs(q[worst] - clamped[worst]) > _TOLERANCE:
            raise LiveError(
                f"{group.name}: {group.joints[worst]} is at {q[worst]:.3f} rad, limits are "
                f"[{group.lower[worst]:.3f}, {group.upper[worst]:.3f}]. Is this the hand that the robot has?"
            )
        return clamped

    def _silence(self, timeout_s: float) -> str:
        missing = self._missing()
        others = sorted({*self._measured} - {name for group, _, _ in self._ports for name in group.joints})
        unknown = f"; it reports joints that the model lacks: {', '.join(others)[:200]}" if others else ""
        names = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        return f"no robot: no state of {names} within {timeout_s:g} s{unknown}{self._refusals()}"

    def _refusals(self) -> str:
        if not self.bus.refused:
            return ""
        return f"; {self.bus.refused} messages were refused, the last: {self.bus.last_refusal}"

    def _declare_group(self, group: JointGroup) -> tuple[JointGroup, InputPort, DiscreteStateIndex]:
        n = len(group.joints)
        port = self.DeclareVectorInputPort(f"{group.name}_desired_state", 2 * n)
        state = self.DeclareDiscreteState(np.full(2 * n, math.nan))
        self.DeclareVectorOutputPort(
            f"{group.name}_state",
            2 * n,
            lambda context, output: output.SetFromVector(context.get_discrete_state(state).value()),
            {self.discrete_state_ticket(state)},
        )
        return group, port, state

    def _fetch(self) -> None:
        for state in self.bus.fetch():
            for name, q, v in zip(state.names, state.position, state.velocity, strict=True):
                self._measured[name], self._arrived[name] = (q, v), self._clock()
            self._fault = state.fault

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self._fetch()
        for group, _, index in self._ports:
            resting = [(q, 0.0) for q in group.start]
            is_measured = self._has(group)
            values = [self._measured[name] for name in group.joints] if is_measured else resting
            if is_measured or group not in self._groups:
                discrete_state.get_mutable_vector(index).SetFromVector(np.ravel(np.transpose(values)))
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        names: list[str] = []
        parts: list[np.ndarray] = []
        for group, port, _ in self._ports:
            if group in self._groups:
                names += group.joints
                parts.append(port.Eval(context).reshape(2, -1))
        position, velocity = np.concatenate(parts, axis=1).tolist()
        self._sequence += 1
        engaged = bool(self._engaged.Eval(context)[0] >= 0.5)
        self.bus.send(
            JointTargets(self._sequence, self._clock(), names, position, velocity, engaged, self._hold_after)
        )
        return EventStatus.Succeeded()

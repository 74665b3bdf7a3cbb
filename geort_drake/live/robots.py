"""Robots: simulated in the diagram, real ones behind a bus, and a stand-in for a real one's driver."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
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

    State: the values of the output ports; before the first command, the initial positions.

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
        for group in groups:
            state = self.DeclareDiscreteState(np.concatenate([group.start, np.zeros_like(group.start)]))
            self.DeclareStateOutputPort(f"{group.name}_desired_state", state)
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(STATUS_PERIOD, 0.0, self._publish)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        targets: dict[str, float] = {}
        for message in self.bus.fetch():
            targets |= zip(message.names, message.position, strict=True)
        for index, group in enumerate(self._groups):
            desired = discrete_state.get_mutable_value(index)  # starts as the present one
            q = [targets.get(name, float(old)) for name, old in zip(group.joints, desired, strict=False)]
            desired[: len(q)] = np.clip(q, group.lower, group.upper)
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
        self._latest: dict[str, tuple[float, float, float]] = {}  # joint → position, velocity, arrival
        self._sequence, self._fault = 0, ""
        self._groups = self._driven = [hand, arm]
        self._desired = []
        for group in self._groups:
            n = len(group.joints)
            self._desired.append(self.DeclareVectorInputPort(f"{group.name}_desired_state", 2 * n))
            state = self.DeclareDiscreteState(np.full(2 * n, math.nan))
            self.DeclareStateOutputPort(f"{group.name}_state", state)
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

        def poll() -> bool:
            self._fetch()
            return not self._missing()

        wait_for(poll, timeout_s, lambda: self._silence(timeout_s))
        self._driven = [group for group in self._groups if self._has(group)]
        hand, arm = map(self._start, self._groups)
        return hand, arm

    def require_alive(self, silence_s: float) -> None:
        """Raises LiveError if a joint's state has not come for `silence_s`, s, or the robot has a fault."""
        if self._fault:
            raise LiveError(f"the robot reports a fault: {self._fault}; commands have stopped")
        for group in self._driven:
            arrival, name = min((self._latest[name][2], name) for name in group.joints)
            if (silent := self._clock() - arrival) > silence_s:
                raise LiveError(
                    f"{group.name}: no state of {name} for {silent:.1f} s; commands have stopped, because "
                    f"the robot may be elsewhere when it comes back{self._refusals()}"
                )

    def _has(self, group: JointGroup) -> bool:
        return bool(group.joints) and all(name in self._latest for name in group.joints)

    def _missing(self) -> list[str]:
        """Returns the joints that have no state yet: those of the hand, and of an arm if there is one."""
        hand, arm = self._groups
        has_arm = self.bus.arm_is_required or any(name in self._latest for name in arm.joints)
        required = [*hand.joints, *(arm.joints if has_arm else [])]
        return [name for name in required if name not in self._latest]

    def _start(self, group: JointGroup) -> np.ndarray:
        if group not in self._driven:
            return group.start
        q = np.array([self._latest[name][0] for name in group.joints])
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
        others = sorted({*self._latest} - {name for group in self._groups for name in group.joints})
        unknown = f"; it reports joints that the model lacks: {', '.join(others)[:200]}" if others else ""
        names = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        return f"no robot: no state of {names} within {timeout_s:g} s{unknown}{self._refusals()}"

    def _refusals(self) -> str:
        if not self.bus.refused:
            return ""
        return f"; {self.bus.refused} messages were refused, the last: {self.bus.last_refusal}"

    def _fetch(self) -> None:
        for state in self.bus.fetch():
            for name, q, v in zip(state.names, state.position, state.velocity, strict=True):
                self._latest[name] = q, v, self._clock()
            self._fault = state.fault

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self._fetch()
        for index, group in enumerate(self._groups):
            if self._has(group):
                q, v, _ = zip(*(self._latest[name] for name in group.joints), strict=True)
                discrete_state.set_value(index, [*q, *v])
            elif group not in self._driven:
                discrete_state.set_value(index, [*group.start, *np.zeros_like(group.start)])
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        driven = [pair for pair in zip(self._groups, self._desired, strict=True) if pair[0] in self._driven]
        names = [name for group, _ in driven for name in group.joints]
        desired = np.concatenate([port.Eval(context).reshape(2, -1) for _, port in driven], axis=1)
        position, velocity = desired.tolist()
        self._sequence += 1
        engaged = bool(self._engaged.Eval(context)[0] >= 0.5)
        self.bus.send(
            JointTargets(self._sequence, self._clock(), names, position, velocity, engaged, self._hold_after)
        )
        return EventStatus.Succeeded()

"""Builds the diagram: glove → engage switch → retargeting → watchdog → correction → robot."""

import dataclasses as dc
import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem, System

from geort_drake.live.glove_stream import MAX_LATENESS_S, GloveStream
from geort_drake.live.robots import SimulatedRobot
from geort_drake.live.watchdog import AFTER, EngageSwitch, Watchdog
from geort_drake.retargeting.base import Retarget
from geort_drake.simulation.following import RobotModel, add_arm, add_fingers
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Outcome, Stage
from geort_drake.systems.corrections import ActionCorrection
from geort_drake.systems.glove import GloveRecorder
from geort_drake.systems.python_system import PythonSystem
from geort_drake.systems.retargeting_status import HELD_LOST
from geort_drake.systems.wrist_to_arm import WristChecks

_MAX_SAMPLES = 3_000


class DelayMeter(PythonSystem):
    """Measures how long joint targets take, on this machine's clock.

    It takes a sample for the first command after new keypoints, if that differs from the command before it,
    and keeps the newest 3,000 samples.

    Input ports:
        sent (1): when the newest keypoints were measured, s, on `clock`; NaN before the first.
        command (2n): joint positions (rad), then velocities (rad/s), as sent to the robot.

    Args:
        num_joints: n.
        period: time between commands, s.
        clock: clock of `sent`, s.
    """

    def __init__(self, num_joints: int, period: float, clock: Callable[[], float] = time.monotonic):
        super().__init__()
        self._n, self._clock = num_joints, clock
        self._samples: deque[float] = deque(maxlen=_MAX_SAMPLES)
        self._last_sent, self._last_command = math.nan, np.full(num_joints, math.nan)
        self._sent = self.DeclareVectorInputPort("sent", 1)
        self._command = self.DeclareVectorInputPort("command", 2 * num_joints)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._sample)

    def delay(self, newest: int = _MAX_SAMPLES) -> dict[str, float | int | None]:
        """Returns `count`, `median` and `p99` (s) of the newest samples; None without samples."""
        samples = list(self._samples)[-newest:]
        if not samples:
            return {"count": 0, "median": None, "p99": None}
        median, p99 = np.percentile(samples, [50, 99]).tolist()
        return {"count": len(samples), "median": median, "p99": p99}

    def _sample(self, context: Context) -> EventStatus:
        sent, q = float(self._sent.Eval(context)[0]), self._command.Eval(context)[: self._n].copy()
        is_new = not np.array_equal(q, self._last_command)
        if math.isfinite(sent) and sent != self._last_sent and is_new:
            self._samples.append(self._clock() - sent)
        self._last_sent, self._last_command = sent, q
        return EventStatus.Succeeded()


# Shown in place of HELD_LOST when late frames are the reason.
HELD_LATE = "held: the glove's frames come late"


@dc.dataclass(frozen=True)
class Teleoperation:
    """The diagram of teleoperation, and the systems in it that sessions read; a real robot has no stage."""

    diagram: Diagram
    glove: LeafSystem
    stage: Stage | None
    watchdog: Watchdog
    correction: ActionCorrection
    wrist_checks: WristChecks
    meter: DelayMeter | None
    simulated_person: ClassVar[bool] = False

    def engage(self, root: Context, engaged: bool) -> None:
        """Makes the robot follow the person, or brake and hold, in a root context of the diagram."""
        self.diagram.GetInputPort("engaged").FixValue(root, [float(engaged)])

    def following(self, root: Context) -> bool:
        """Returns whether the fingers follow the person."""
        return bool(_eval(self.watchdog, "following", root)[0] >= 0.5)

    @property
    def notice(self) -> str:
        """What the person should know of the glove's clock, or ""."""
        return self.glove.notice if isinstance(self.glove, GloveStream) else ""

    def outcome(self, root: Context) -> Outcome | None:
        """Returns the task's outcome so far; None without a simulation."""
        return None if self.stage is None else self.stage.outcome(root)

    def restart(self, root: Context) -> None:
        """Restarts the simulation's task at the present time."""
        if self.stage is not None:
            self.stage.restart(root)

    def phase(self, root: Context) -> str | None:
        """Returns the name of the task's present state; None without a simulation."""
        return None if self.stage is None else self.stage.phase(root)

    @property
    def late(self) -> int:
        """Number of the glove's frames that came late."""
        return self.glove.late if isinstance(self.glove, GloveStream) else 0

    def delay(self, newest: int) -> dict[str, Any]:
        """Returns the delay of the newest samples, see `DelayMeter`; the glove must have stamps."""
        assert self.meter is not None
        return self.meter.delay(newest)

    def state(self, root: Context) -> str:
        """Returns the state of the fingers and why they are held.

        If they follow, it returns that of a failed policy or held arm, if any.
        """
        state = _eval(self.watchdog, "state", root)
        if not self.following(root):
            if isinstance(self.glove, GloveStream):
                if self.glove.source.refusing:
                    return f"{state}; messages arrive but are refused: {self.glove.source.refusing}"
                if state == HELD_LOST and _eval(self.glove, "lateness", root)[0] > MAX_LATENESS_S:
                    return HELD_LATE
            return state
        if self.correction.HasOutputPort("status") and (status := _eval(self.correction, "status", root)):
            return status
        wrist = _eval(self.wrist_checks, "state", root)
        return f"arm {wrist}" if wrist else state


def _eval(system: System, port: str, root: Context) -> Any:
    return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(root))


def make_teleoperation(
    scenario: Scenario,
    model: RobotModel,
    retarget: Retarget,
    glove: LeafSystem,
    robot: LeafSystem | SimulatedRobot,
    start: tuple[np.ndarray, np.ndarray],
    relax_after: float = 5.0,
    recorder: GloveRecorder | None = None,
) -> Teleoperation:
    """Builds the diagram for a glove and a robot. Engage the person in its context before the first step.

    Args:
        scenario: settings of retargeting, correction and arm.
        model: model of the robot.
        retarget: a `Retargeter`, or a similar callable with `joint_names`.
        glove: `GloveStream`, or `GloveReplay`, which has no stamps.
        robot: `RobotLink`, `SimulatedRobot`, or a system with the link's ports.
        start: present positions of hand (n,) and arm (m,), rad, in the model's order.
        relax_after: time for which a lost hand is held before it relaxes, s.
        recorder: records the glove's outputs, if given; records the hand as lost while disengaged.

    Raises:
        HandError: the retargeter and the robot move different joints.
        ValueError: `relax_after` is not positive.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("glove", glove)
    stage = robot.stage if isinstance(robot, SimulatedRobot) else None
    robot = builder.AddNamedSystem("robot", robot.diagram if isinstance(robot, SimulatedRobot) else robot)
    q_hand, q_arm = start

    # The glove's frames count only while the person is engaged.
    switch = builder.AddNamedSystem("engage_switch", EngageSwitch())
    builder.Connect(glove.GetOutputPort("valid"), switch.GetInputPort("valid"))
    builder.ExportInput(switch.GetInputPort("engaged"), "engaged")

    # Fingers.
    valid = switch.GetOutputPort("valid")
    retargeting, correction = add_fingers(
        builder, scenario, model, retarget, q_hand, glove, valid, scenario.retargeting.latency
    )
    safe_pose = [model.description.default_positions.get(name, 0.0) for name in model.hand.joints]
    watchdog = builder.AddNamedSystem(
        "watchdog", Watchdog(model.limits, np.array(safe_pose), retargeting.period, relax_after)
    )
    builder.Connect(retargeting.GetOutputPort("desired_state"), watchdog.GetInputPort("desired_state"))
    builder.Connect(retargeting.GetOutputPort("status"), watchdog.GetInputPort("status"))
    builder.ConnectInput("engaged", watchdog.GetInputPort("engaged"))
    builder.Connect(watchdog.GetOutputPort("desired_state"), correction.GetInputPort("desired_state"))
    builder.Connect(robot.GetOutputPort("hand_state"), correction.GetInputPort("hand_state"))
    builder.Connect(correction.GetOutputPort("desired_state"), robot.GetInputPort("hand_desired_state"))

    # The arm follows the wrist only while the fingers are followed and the wrist moves plausibly.
    arm_positions = dict(zip(model.arm.joints, q_arm.tolist(), strict=True))
    wrist_to_arm, wrist = add_arm(builder, scenario, model, glove, arm_positions, limit_acceleration=True)
    wrist_checks = builder.AddNamedSystem("wrist_checks", WristChecks(scenario.wrist_to_arm.period))
    builder.Connect(wrist.GetOutputPort("wrist_pose"), wrist_checks.GetInputPort("wrist_pose"))
    builder.Connect(watchdog.GetOutputPort("following"), wrist_checks.GetInputPort("valid"))
    builder.Connect(wrist_checks.GetOutputPort("valid"), wrist_to_arm.GetInputPort("valid"))
    builder.Connect(wrist_to_arm.GetOutputPort("arm_desired_state"), robot.GetInputPort("arm_desired_state"))

    if robot.HasInputPort("engaged"):
        builder.ConnectInput("engaged", robot.GetInputPort("engaged"))
    meter = None
    if glove.HasOutputPort("sent"):
        meter = builder.AddNamedSystem("delay_meter", DelayMeter(len(safe_pose), retargeting.period))
        builder.Connect(glove.GetOutputPort("sent"), meter.GetInputPort("sent"))
        builder.Connect(correction.GetOutputPort("desired_state"), meter.GetInputPort("command"))
    if recorder is not None:
        builder.AddNamedSystem("glove_recorder", recorder)
        for name in ("keypoints", "wrist_pose"):
            builder.Connect(glove.GetOutputPort(name), recorder.GetInputPort(name))
        # A replay follows what the robot followed.
        builder.Connect(switch.GetOutputPort("valid"), recorder.GetInputPort("valid"))
        for name, port in {
            "joints.command": correction.GetOutputPort("desired_state"),
            "joints.measured": robot.GetOutputPort("hand_state"),
            "arm.command": wrist_to_arm.GetOutputPort("arm_desired_state"),
            "arm.measured": robot.GetOutputPort("arm_state"),
        }.items():
            if recorder.HasInputPort(name):
                builder.Connect(port, recorder.GetInputPort(name))

    diagram = builder.Build()
    diagram.set_name("teleoperation")
    return Teleoperation(diagram, glove, stage, watchdog, correction, wrist_checks, meter)

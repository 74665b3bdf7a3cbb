"""Runs teleoperation from the page: one session after another, separated by resets."""

import copy
import dataclasses as dc
import gc
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import msgspec
from pydrake.systems.framework import DiagramBuilder, System

from geort_drake.errors import GeortError
from geort_drake.hands.description import HandDescription
from geort_drake.live.glove_stream import GloveStream
from geort_drake.live.robot_link import RobotLink
from geort_drake.live.robots import SimulatedRobot
from geort_drake.live.session import SessionReport, run_session
from geort_drake.live.teleoperation import Teleoperation, make_teleoperation
from geort_drake.live.web.control import PageControl
from geort_drake.live.web.operator_station import OperatorStation
from geort_drake.live.web.scene import PoseStream, RobotKinematics, Scene
from geort_drake.retargeting.base import Retarget
from geort_drake.simulation.following import RobotModel
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import ARM, HAND
from geort_drake.systems.glove_recorder import GloveRecorder

if TYPE_CHECKING:
    from geort_drake.live.web.server import WebServer

# Longest time between joint targets of a simulation, s; a new hand waits for half of it on average.
_PERIOD = 0.004


@dc.dataclass
class WebTeleoperation:
    """Runs the sessions of one page, and holds what they share.

    Attributes:
        scenarios: task → its scenario, the first task first; sessions vary the object.
        description, model: description of the robot's hand, and model of the first scenario's robot.
        retarget: the map with which every session begins.
        station, server, control: parts of the page's server.
        link: link to a real robot; None for the simulation.
        relax_after: see `Watchdog`, s.
    """

    scenarios: Mapping[str, Scenario]
    description: HandDescription
    model: RobotModel
    retarget: Retarget
    station: OperatorStation
    server: "WebServer"
    control: PageControl
    link: RobotLink | None = None
    relax_after: float = 5.0

    def run(
        self,
        engaged: bool,
        duration: float,
        stop: Callable[[], bool],
        timeout: float,
        silence: float,
        on_state: Callable[[float, str], None],
    ) -> tuple[SessionReport, Teleoperation]:
        """Runs sessions until `stop()` or until they have taken `duration`, s.

        Args:
            engaged: whether a person is engaged from the start.
            timeout, silence: how long to wait for a real robot, and for its next status, s.
            on_state: see `run_session`.

        Returns:
            A report of all sessions together, and the last session's diagram.
        """
        total = SessionReport(0.0, {}, 0)
        link, control = self.link, self.control
        scenes = 0
        before: tuple[str | None, str | None] | None = None
        while True:
            scenes += 1
            try:
                loop = self._begin(scenes, timeout)
            except GeortError as error:
                if not before:
                    raise
                # Not every hand can do every task: returns to the last one.
                (control.task, control.object), control.note = before, str(error)
                loop = self._begin(scenes, timeout)
            before = control.task, control.object
            for _ in range(2):  # the first frees what keeps the rest of the last diagram alive
                gc.collect()
            report = run_session(
                loop,
                engaged,
                control,
                duration - total.duration,
                lambda: stop() or control.again,
                lambda: link.require_alive(silence) if link else None,
                on_state,
            )
            control.end()
            states = {
                name: total.states.get(name, 0.0) + report.states.get(name, 0.0)
                for name in total.states | report.states
            }
            total = SessionReport(total.duration + report.duration, states, total.late + report.late)
            if stop() or not control.again:
                return total, loop
            engaged = False

    def _model(self, scenario: Scenario) -> RobotModel:
        first = next(iter(self.scenarios))
        return self.model if scenario.task == first else RobotModel(scenario, self.description)

    def _begin(self, number: int, timeout: float) -> Teleoperation:
        """Builds a session's diagram and shows its scene."""
        control, description = self.control, self.description
        scenario = copy.deepcopy(self.scenarios[control.task or next(iter(self.scenarios))])
        task, model = find_task(scenario.task), self._model(scenario)
        robot: SimulatedRobot | RobotLink
        if self.link is None:
            task.choose(scenario, control.object or task.case_of(scenario))
            scenario.random_seed += number - 1  # the object stands somewhere else
            scenario.retargeting.period = min(scenario.retargeting.period, _PERIOD)
            robot = SimulatedRobot(scenario, description, model)
            start = robot.hand.start, robot.arm.start
            shown = robot.stage.scene
            inspector = shown.scene_graph.model_inspector()
            scene = Scene(shown.plant, inspector, description)
        else:
            robot, start = self.link, self.link.handshake(timeout)
            standing = self.model.standing_at({})
            scene = Scene(standing.plant(), standing.scene_graph().model_inspector(), description)

        def add_view(builder: DiagramBuilder, robot: System) -> None:
            stream = builder.AddNamedSystem(
                "pose_stream",
                PoseStream(
                    scene,
                    lambda: self.station.p_HK,
                    description.side,
                    lambda frame: self.server.publish(frame=frame),
                ),
            )
            source: System = robot
            if not robot.HasOutputPort("body_poses"):
                source = builder.AddNamedSystem("robot_kinematics", RobotKinematics(standing.plant()))
                for name in (HAND, ARM):
                    builder.Connect(
                        robot.GetOutputPort(f"{name}_state"), source.GetInputPort(f"{name}_state")
                    )
            builder.Connect(source.GetOutputPort("body_poses"), stream.GetInputPort("body_poses"))

        # The joints of a real robot are recorded, because a replay cannot reproduce them.
        kept = {} if self.link is None else robot_joints(description, model)
        recorder = GloveRecorder(scenario.operator.period, robot=kept)
        loop = make_teleoperation(
            scenario,
            description,
            model,
            self.retarget,
            GloveStream(self.station, description.side),
            robot,
            start,
            self.relax_after,
            recorder,
            add_view,
        )
        self.server.show(msgspec.json.encode({"scene": number, **scene.description}), scene.meshes)
        facts: dict[str, str | int] = {"robot": self.station.about.robot, "hand": description.name}
        if self.link is None:
            facts |= {"task": task.name, "object": task.case_of(scenario), "seed": scenario.random_seed}
        control.begin(loop, recorder, number, facts)
        return loop


def robot_joints(description: HandDescription, model: RobotModel) -> dict[str, list[str]]:
    """Returns the argument `robot` of `GloveRecorder`, with names as in recordings of a simulation."""
    finger_of = {joint: finger.name for finger in description.fingers for joint in finger.joints}
    hand = [f"{finger_of[joint]}.{joint}" for joint in model.hand.joints]
    groups = {"joints": hand, "arm": list(model.arm.joints)}
    return {f"{key}.{label}": names for key, names in groups.items() for label in ("command", "measured")}

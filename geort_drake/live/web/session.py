"""Runs teleoperation from the page: one session after another, separated by resets."""

import copy
import dataclasses as dc
import gc
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from geort_drake.errors import GeortError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand
from geort_drake.live.glove_stream import GloveStream
from geort_drake.live.robots import RobotLink, SimulatedRobot
from geort_drake.live.session import STEP_S, run_in_real_time, run_session
from geort_drake.live.teleoperation import Teleoperation, make_teleoperation
from geort_drake.live.web.control import PageControl, WatchedTrial
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.live.web.scene import PageScene, measured_poses
from geort_drake.live.web.server import WebServer
from geort_drake.retargeting.base import Retarget, forget
from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram
from geort_drake.simulation.following import RobotModel, robot_model
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import TrialBuilder
from geort_drake.simulation.world import ARM, HAND
from geort_drake.systems.glove import GloveRecorder

# Longest time between joint targets of a simulation, s; a new hand waits for half of it on average.
_PERIOD = 0.004


@dc.dataclass(frozen=True)
class Setup:
    """A robot that the page operates.

    Attributes:
        about: facts for the pages.
        scenarios: task → its scenario, the first task first; sessions vary the object.
        description: description of the robot's hand.
        retarget: the map with which every session begins.
    """

    about: RobotInfo
    scenarios: Mapping[str, Scenario]
    description: HandDescription
    retarget: Retarget


def mount_of(scenario: Scenario) -> str:
    """Returns what carries the hand: "arm", or "floating"."""
    return "arm" if scenario.hand_parent == Scenario().hand_parent else "floating"


@dc.dataclass
class WebTeleoperation:
    """Runs the sessions of one page, and holds what they share.

    Attributes:
        setup: the robot.
        choose: returns the robot with another hand and mount; raises GeortError if there is none.
        station, server, control: parts of the page's server.
        link: link to a real robot; None for the simulation.
        relax_after: see `Watchdog`, s.
    """

    setup: Setup
    choose: Callable[[str, str], Setup]
    station: OperatorStation
    server: WebServer
    control: PageControl
    link: RobotLink | None
    relax_after: float

    def __post_init__(self) -> None:
        self._scenes = self._watched = 0
        self._builder: TrialBuilder | None = None  # of the trials that are watched

    def run(
        self,
        engaged: bool,
        duration: float,
        stop: Callable[[], bool],
        timeout: float,
        silence: float,
    ) -> tuple[dict[str, Any], Teleoperation]:
        """Runs sessions until `stop()` or until they have taken `duration`, s.

        Args:
            engaged: whether a person is engaged from the start.
            timeout, silence: how long to wait for a real robot, and for its next status, s.

        Returns:
            A summary of all sessions together, see `run_session`, and the last diagram of teleoperation.
        """
        summary: dict[str, Any] = {}
        link, control = self.link, self.control
        loop = self._teleoperation(timeout)
        while True:
            choice = control.choice
            for _ in range(2):  # the first frees what keeps the rest of the last diagram alive
                gc.collect()
            summary = run_session(
                loop,
                engaged,
                control.step,
                duration - summary.get("duration", 0.0),
                lambda: stop() or control.again,
                lambda: link.require_alive(silence) if link else None,
                summary,
            )
            control.end()
            engaged = False
            while control.again and not stop():
                try:
                    if not self.station.simulated_person:
                        loop = self._teleoperation(timeout)
                        break
                    self._watch(stop)
                    choice = control.choice
                except GeortError as error:
                    # Not every hand can do every task: returns to the last one.
                    control.choice, control.note = choice, str(error)
                    loop = self._teleoperation(timeout)
                    break
            else:
                return summary, loop

    def _scenario(self) -> Scenario:
        """Returns the chosen scenario, with a new object placement in every session."""
        choice, about = self.control.choice, self.setup.about
        robot = choice.hand or about.hand, choice.mount or about.mount
        if robot != (about.hand, about.mount):
            self.setup, self._builder = self.choose(*robot), None
            self.server.introduce(self.setup.about)
        scenarios = self.setup.scenarios
        scenario = copy.deepcopy(scenarios.get(choice.task or "", next(iter(scenarios.values()))))
        if self.link is None:
            task = find_task(scenario.task)
            cases = task.cases()
            task.choose(scenario, choice.object if choice.object in cases else task.case_of(scenario))
        return scenario

    def _show(self, scene: PageScene) -> None:
        """Shows a new scene."""
        self._scenes += 1
        self.server.show(msgspec.json.encode({"scene": self._scenes, **scene.description}), scene.meshes)

    def _facts(self, scenario: Scenario) -> dict[str, str | int]:
        """Returns what recordings tell of a session."""
        about, task = self.setup.about, find_task(scenario.task)
        facts: dict[str, str | int] = {"robot": about.robot, "hand": self.setup.description.name}
        if self.link is None:
            facts |= {"task": task.name, "object": task.case_of(scenario), "seed": scenario.random_seed}
            facts["mount"] = mount_of(scenario)
        return facts

    def _watch(self, stop: Callable[[], bool]) -> None:
        """Runs the trial of a simulated person, and shows its end until the page asks for another session."""
        control, scenario, setup = self.control, self._scenario(), self.setup
        scenario.random_seed += self._watched
        self._watched += 1
        if self._builder is None:
            self._builder = TrialBuilder(Hand(setup.description))
        parts, watched = watched_trial(self._builder, scenario, setup.retarget)
        scene = PageScene(parts.plant, parts.stage.scene_graph.model_inspector(), setup.description)
        self._show(scene)
        simulator = Simulator(parts.diagram)
        root = simulator.get_mutable_context()
        parts.initialize(root)
        poses = parts.plant.get_body_poses_output_port()
        keypoints = parts.glove_recorder.GetInputPort("keypoints")
        contexts = [system.GetMyContextFromRoot(root) for system in (parts.plant, parts.glove_recorder)]

        def show(root: Context) -> None:
            p_HK = keypoints.Eval(contexts[1]).reshape(21, 3)
            frame = scene.frame(root.get_time(), poses.Eval(contexts[0]), p_HK)
            self.server.publish(frame=frame)

        control.begin(watched, None, self._scenes, self._facts(scenario), show)

        def go_on() -> bool:
            control.step(root, False)
            return not (stop() or control.again or watched.outcome(root).over)

        run_in_real_time(simulator, STEP_S, go_on)
        while not (stop() or control.again):
            control.step(root, False)
            time.sleep(STEP_S)

    def _teleoperation(self, timeout: float) -> Teleoperation:
        """Builds a session's diagram and shows its scene."""
        scenario, control = self._scenario(), self.control
        description = self.setup.description
        model = robot_model(scenario, description)
        robot: SimulatedRobot | RobotLink
        if self.link is None:
            scenario.random_seed += self._scenes
            scenario.retargeting.period = min(scenario.retargeting.period, _PERIOD)
            robot = SimulatedRobot(scenario, model)
            start = model.hand.start, model.arm.start
            plant, graph = robot.stage.plant, robot.stage.scene_graph
        else:
            robot, start = self.link, self.link.handshake(timeout)
            standing = model.standing_at({})
            plant, graph = standing.plant(), standing.scene_graph()
        scene = PageScene(plant, graph.model_inspector(), description)
        poses_of = None if self.link is None else measured_poses(plant)

        # The joints of a real robot are recorded, because a replay cannot reproduce them.
        joints = {} if self.link is None else robot_joints(model)
        recorder = GloveRecorder(scenario.operator.period, robot=joints)
        loop = make_teleoperation(
            scenario,
            model,
            self.setup.retarget,
            GloveStream(self.station),
            robot,
            start,
            self.relax_after,
            recorder,
        )
        system = loop.diagram.GetSubsystemByName("robot")

        def show(root: Context) -> None:
            context = system.GetMyContextFromRoot(root)
            if poses_of is None:
                poses = system.GetOutputPort("body_poses").Eval(context)
            else:
                states = {name: system.GetOutputPort(f"{name}_state").Eval(context) for name in (HAND, ARM)}
                poses = poses_of(states)
            frame = scene.frame(root.get_time(), poses, self.station.p_HK)
            self.server.publish(frame=frame)

        self._show(scene)
        control.begin(loop, recorder, self._scenes, self._facts(scenario), show)
        return loop


def watched_trial(
    builder: TrialBuilder, scenario: Scenario, retarget: Retarget
) -> tuple[TrialDiagram, WatchedTrial]:
    """Builds the trial that `geort-drake grasp` would simulate for this scenario and method.

    Planning and the person's free play take some seconds the first time.

    Raises:
        ScenarioError: the hand cannot do the task.
    """
    trial = builder.trial(scenario, retarget)
    forget(trial.retarget)
    parts = make_trial_diagram(trial.scenario, trial.retarget, trial.human)
    return parts, WatchedTrial(parts.stage, scenario.timeout)


def robot_joints(model: RobotModel) -> dict[str, list[str]]:
    """Returns the argument `robot` of `GloveRecorder`, with names as in recordings of a simulation."""
    finger_of = {joint: finger.name for finger in model.description.fingers for joint in finger.joints}
    hand = [f"{finger_of[joint]}.{joint}" for joint in model.hand.joints]
    groups = {"joints": hand, "arm": list(model.arm.joints)}
    return {f"{key}.{label}": names for key, names in groups.items() for label in ("command", "measured")}

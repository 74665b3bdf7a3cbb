"""The loop of the live page's simulation, in steps, on a glove's clock that stands."""

import numpy as np
from faults.bench import Watch
from live_messages import Clock
from pydrake.systems.analysis import Simulator

from geort_drake import load_hand, load_scenario
from geort_drake.live.glove_stream import GloveStream
from geort_drake.live.robots import SimulatedRobot
from geort_drake.live.teleoperation import make_teleoperation
from geort_drake.live.web.operator_station import OperatorStation
from geort_drake.live.web.session import robot_joints
from geort_drake.retargeting.method import Retarget
from geort_drake.simulation.following import RobotModel
from geort_drake.simulation.tasks import find_task
from geort_drake.systems.glove_recorder import GloveRecorder


class LoopBench:
    """One session behind a station; nobody is engaged at first.

    Args:
        seed: of the scenario.
        task, text: whose scenario, and YAML that is merged into it.
        real: whether the robot's joints are recorded, as a real one's are.
    """

    def __init__(
        self,
        station: OperatorStation,
        retarget: Retarget,
        seed: int = 0,
        task: str = "grasp",
        text: str = "{}",
        real: bool = False,
    ):
        self.station, self.scenario = station, load_scenario(*find_task(task).scenario, text)
        self.scenario.random_seed = seed
        description = load_hand(self.scenario.hand)
        self.model = RobotModel(self.scenario, description)
        robot = SimulatedRobot(self.scenario, description, self.model)
        self.recorder = GloveRecorder(0.01, robot=robot_joints(description, self.model) if real else None)
        self.loop = make_teleoperation(
            self.scenario, description, self.model, retarget,
            GloveStream(station, "right", clock=Clock()), robot, (robot.hand.start, robot.arm.start),
            recorder=self.recorder,
        )  # fmt: skip
        self.simulator = Simulator(self.loop.diagram)
        self.context, self.engaged = self.simulator.get_mutable_context(), True
        self.engage(False)
        self.watch = Watch(self.model.limits, self.scenario.retargeting.period, robot.hand.start)

    def engage(self, engaged: bool) -> None:
        if engaged != self.engaged:
            self.engaged = engaged
            self.loop.engage(self.context, engaged)

    def step(self, seconds: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
        """Advances; returns the hand's targets, rad, and their velocities, rad/s."""
        self.simulator.AdvanceTo(self.context.get_time() + seconds)
        correction = self.loop.correction
        context = correction.GetMyContextFromRoot(self.context)
        q, v = np.split(correction.GetOutputPort("desired_state").Eval(context), 2)
        return q.copy(), v.copy()

    def state(self) -> str:
        return self.loop.state(self.context)

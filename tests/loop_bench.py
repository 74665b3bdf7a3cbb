"""What live use runs, in steps: the page's simulation on a clock that stands, and the arm by itself."""

from collections import Counter

import numpy as np
from live_messages import Clock
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from system_bench import SystemBench, Watch

from geort_drake import WristToArm, load_hand, load_scenario
from geort_drake.live.glove_stream import GloveStream
from geort_drake.live.robots import SimulatedRobot
from geort_drake.live.teleoperation import make_teleoperation
from geort_drake.live.web.operator_station import OperatorStation
from geort_drake.live.web.session import robot_joints
from geort_drake.retargeting.base import Retarget
from geort_drake.simulation.following import RobotModel
from geort_drake.simulation.world import ARM, HAND
from geort_drake.systems.glove import GloveRecorder
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.wrist_to_arm import WristChecks


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
        self.station, self.scenario = station, load_scenario(task=task, text=text)
        self.scenario.random_seed = seed
        description = load_hand(self.scenario.hand)
        self.model = RobotModel(self.scenario, description)
        robot = SimulatedRobot(self.scenario, self.model)
        start = self.model.hand.start, self.model.arm.start
        self.recorder = GloveRecorder(0.01, robot=robot_joints(self.model) if real else None)
        self.loop = make_teleoperation(
            self.scenario, self.model, retarget, GloveStream(station, clock=Clock()), robot, start,
            recorder=self.recorder,
        )  # fmt: skip
        self.simulator = Simulator(self.loop.diagram)
        self.context, self.engaged = self.simulator.get_mutable_context(), True
        self.engage(False)
        self.watch = Watch(self.model.limits, self.scenario.retargeting.period, self.model.hand.start)

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


PERIOD = 0.01
# The Panda's limits, rad/s and rad/s²: libfranka, kMaxJointVelocity and kMaxJointAcceleration.
SPEED = np.array([2.175] * 4 + [2.61] * 3)
ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])


class ArmBench(SystemBench):
    """Steps wrist checks and `WristToArm` with the settings of teleoperation, and counts broken limits."""

    def __init__(self):
        scenario = load_scenario()
        description = load_hand(scenario.hand)
        self._robot = robot = RobotModel(scenario, description).standing_at({})
        self._robot_context = robot.CreateDefaultContext()
        plant = robot.plant()
        arm, hand = (plant.GetModelInstanceByName(name) for name in (ARM, HAND))
        base = plant.GetFrameByName(description.base_frame, hand)
        lower, upper = plant.GetPositionLowerLimits()[:7], plant.GetPositionUpperLimits()[:7]
        start = plant.GetPositions(plant.CreateDefaultContext())[:7]
        self.watch = Watch(JointLimits(lower, upper, SPEED, ACCELERATION), PERIOD, start)
        self.broken: Counter[str] = Counter()
        builder = DiagramBuilder()
        self.checks = builder.AddSystem(WristChecks(PERIOD))
        self.arm = builder.AddSystem(
            WristToArm(robot, arm, base, scenario.wrist_to_arm, limit_acceleration=True)
        )
        builder.Connect(self.checks.GetOutputPort("valid"), self.arm.GetInputPort("valid"))
        builder.ExportInput(self.checks.GetInputPort("wrist_pose"), "wrist_pose")
        builder.ConnectInput("wrist_pose", self.arm.GetInputPort("wrist_pose"))
        builder.ExportInput(self.checks.GetInputPort("valid"), "valid")
        super().__init__(builder.Build(), PERIOD)
        self._hand_pose = lambda q: (plant.SetPositions(scratch, arm, q), base.CalcPoseInWorld(scratch))[1]
        scratch = plant.CreateDefaultContext()

    def hand_position(self, q: np.ndarray) -> np.ndarray:
        """p_WB (3,), m, of the hand with the arm at positions q (7,), rad."""
        return self._hand_pose(q).translation().copy()

    def arm_clearance(self, q: np.ndarray) -> float:
        """Least signed distance, m, of the arm's links from the table within 0.2 m, at positions q (7,), rad.

        The base is not counted, as it stands on the table.
        """
        plant, context = self._robot.plant(), self._robot_context
        plant.SetPositions(plant.GetMyMutableContextFromRoot(context), plant.GetModelInstanceByName(ARM), q)
        query = plant.get_geometry_query_input_port().Eval(plant.GetMyContextFromRoot(context))
        table = set(plant.GetCollisionGeometriesForBody(plant.GetBodyByName("table_top")))
        links = {
            shape
            for number in range(1, 8)
            for shape in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(f"panda_link{number}"))
        }
        pairs = query.ComputeSignedDistancePairwiseClosestPoints(0.2)
        distances = [p.distance for p in pairs if {p.id_A, p.id_B} & links and {p.id_A, p.id_B} & table]
        return min(distances, default=0.2)

    def tick(self, X_WH: RigidTransform, valid: float = 1.0) -> tuple[np.ndarray, np.ndarray, str]:
        """One update; returns the arm's positions (rad) and velocities (rad/s), and the wrist's state."""
        self.fix(wrist_pose=X_WH, valid=valid)
        self.advance()
        q, v = np.split(self.value("arm_desired_state", self.arm), 2)
        self.broken.update(self.watch.broken(q, v))
        return q, v, self.value("state", self.checks)

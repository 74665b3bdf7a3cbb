"""The drivers of `examples/drivers/`, each against a stand-in of its vendor's interface."""

import importlib.util
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest

from geort_drake import load_hand
from geort_drake.live import driver as driver_module
from geort_drake.live.joint_messages import Bus, JointTargets, open_zmq_bus
from geort_drake.live.transports import wait_for

DRIVERS = Path(__file__).resolve().parents[1] / "examples/drivers"
PATIENCE_S = 60.0


def load(name: str) -> types.ModuleType:
    """Imports a driver, as a user runs it."""
    specification = importlib.util.spec_from_file_location(name, DRIVERS / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


class Session:
    """Runs a driver in this process while a person moves all of its joints to `goal`, rad."""

    def __init__(self, tmp_path, monkeypatch, names, goal):
        self.endpoint, self.names, self.goal = f"ipc://{tmp_path}/robot", list(names), np.asarray(goal, float)
        self.states, self._sequence = [], 0
        self.driver = None
        made = driver_module.JointDriver.__init__

        def remember(driver, *arguments, **options):
            made(driver, *arguments, **options)
            self.driver = driver

        monkeypatch.setattr(driver_module.JointDriver, "__init__", remember)
        monkeypatch.syspath_prepend(DRIVERS)

    def run(self, module, *options, until=None) -> None:
        """Runs the driver's `main` until its robot stands at the goal, or `until` holds."""
        arguments = [f"{module.__name__}.py", "--endpoint", self.endpoint, "--speed", "1.0", *options]
        bus = open_zmq_bus(self.endpoint)
        error: list[BaseException] = []

        def person() -> None:
            try:
                wait_for(lambda: self._reached(bus, until), PATIENCE_S, lambda: f"at {self.states[-1:]}")
            except BaseException as raised:
                error.append(raised)
            finally:
                if self.driver is not None:
                    self.driver.running = False

        thread = threading.Thread(target=person)
        thread.start()
        before, sys.argv = sys.argv, arguments
        try:
            module.main()
        finally:
            sys.argv = before
            thread.join()
            bus.close()
        if error:
            raise error[0]

    def _reached(self, bus: Bus, until) -> bool:
        self._sequence += 1
        zeros = [0.0] * len(self.goal)
        bus.send(JointTargets(self._sequence, 0.0, self.names, self.goal.tolist(), zeros, True, 1.0))
        self.states += bus.fetch()
        time.sleep(0.005)
        if not self.states:
            return False
        assert list(self.states[-1].names) == self.names
        return (until or self._stands)(self.states[-1])

    def _stands(self, state) -> bool:
        return bool(np.abs(np.subtract(state.position, self.goal)).max() < 0.02)


class WujiHand:
    """Has the methods of wujihandpy 1.8's Hand and IController that the driver calls."""

    def __init__(self):
        self.q, self.enabled, self.closed = np.full((5, 4), 0.1), False, False

    def read_joint_lower_limit(self):
        return np.full((5, 4), -0.2)

    def read_joint_upper_limit(self):
        return np.full((5, 4), 0.5)

    def read_joint_actual_position(self):
        return self.q.copy()

    get_joint_actual_position = read_joint_actual_position

    def get_joint_error_code(self):
        return np.zeros((5, 4), int)

    def write_joint_target_position(self, q):
        assert np.shape(q) == (5, 4)

    def write_joint_enabled(self, enabled):
        self.enabled = enabled

    def realtime_controller(self, enable_upstream, filter):
        assert enable_upstream and filter == 10.0 and self.enabled
        return self

    def set_joint_target_position(self, q):
        self.q = np.array(q)

    def close(self):
        self.closed = True


def test_the_wuji_driver_moves_the_vendors_hand_within_its_limits(tmp_path, monkeypatch):
    hand = WujiHand()
    package = types.ModuleType("wujihandpy")
    package.Hand, package.filter = (lambda: hand), types.SimpleNamespace(LowPass=lambda cutoff: cutoff)
    monkeypatch.setitem(sys.modules, "wujihandpy", package)
    names = [f"right_finger{finger}_joint{joint}" for finger in range(1, 6) for joint in range(1, 5)]
    session = Session(tmp_path, monkeypatch, names, np.full(20, 0.9))
    session.run(load("wuji"), until=lambda state: min(state.position) > 0.499)
    np.testing.assert_allclose(hand.q, 0.5)
    assert hand.closed and not hand.enabled


class DynamixelBus:
    """Has the classes of dynamixel-sdk that the driver uses; 16 servos with a control table each."""

    def __init__(self):
        bus, self.reads, self.lost = self, 0, ()
        self.tables = [bytearray(256) for _ in range(16)]
        for table in self.tables:
            table[132:136] = (2048).to_bytes(4, "little")

        class PortHandler:
            def __init__(self, port):
                self.port = port

            def openPort(self):
                return True

            def setBaudRate(self, baud):
                return baud == 4_000_000

        class PacketHandler:
            def __init__(self, version):
                assert version == 2.0

        class GroupSyncWrite:
            def __init__(self, port, packets, address, size):
                self.address, self.size, self.values = address, size, {}

            def addParam(self, motor, data):
                assert len(data) == self.size
                self.values[motor] = data

            def txPacket(self):
                for motor, data in self.values.items():
                    bus.write(motor, self.address, data)
                return 0

        class GroupSyncRead:
            def __init__(self, port, packets, address, size):
                self.motors = []

            def addParam(self, motor):
                self.motors.append(motor)

            def txRxPacket(self):
                bus.reads += 1
                return -3001 if bus.reads in bus.lost else 0

            def getData(self, motor, address, size):
                return int.from_bytes(bus.tables[motor][address : address + size], "little")

        self.module = types.ModuleType("dynamixel_sdk")
        for kind in (PortHandler, PacketHandler, GroupSyncWrite, GroupSyncRead):
            setattr(self.module, kind.__name__, kind)

    def write(self, motor: int, address: int, data: bytes) -> None:
        table = self.tables[motor]
        assert address not in (11,) or table[64] == 0, "the mode is locked while there is torque"
        table[address : address + len(data)] = data
        if table[64] and address in (64, 116):  # with torque, the motor is where it shall be
            table[132:136] = table[116:120]


def test_the_leap_driver_commands_the_motors_of_the_models_joints(tmp_path, monkeypatch):
    """In ticks about 180°, in current-based position mode with a limit; the motors end without torque.

    An answer that is lost on the bus stops nothing.
    """
    bus = DynamixelBus()
    bus.lost = {4, 5, 9}
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", bus.module)
    names, goal = [f"joint_{i}" for i in range(16)], np.linspace(-0.2, 0.9, 16)
    session = Session(tmp_path, monkeypatch, names, goal)
    session.run(load("leap"), "--port", "/dev/ttyUSB0")
    ticks = [int.from_bytes(table[116:120], "little") for table in bus.tables]
    np.testing.assert_allclose(ticks, 2048 + goal * 2048 / np.pi, atol=8)
    for table in bus.tables:
        assert (table[11], table[64], int.from_bytes(table[102:104], "little")) == (5, 0, 300)


def test_the_leap_driver_leaves_the_motors_limp_when_it_fails(tmp_path, monkeypatch):
    bus = DynamixelBus()
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", bus.module)
    session = Session(tmp_path, monkeypatch, [f"joint_{i}" for i in range(16)], np.zeros(16))

    step, end = driver_module.JointDriver.step, threading.Event()

    def fail(driver, position, fault=""):
        if session.states:
            end.set()
            raise OSError("the cable is unplugged")
        return step(driver, position, fault)

    monkeypatch.setattr(driver_module.JointDriver, "step", fail)
    with pytest.raises(OSError, match="unplugged"):
        session.run(load("leap"), "--port", "/dev/ttyUSB0", until=lambda state: end.is_set())
    assert [table[64] for table in bus.tables] == [0] * 16


def test_the_leap_drivers_limits_are_the_models(monkeypatch):
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", DynamixelBus().module)
    leap, hand = load("leap"), load_hand("leap_right")
    from pydrake.multibody.plant import MultibodyPlant

    from geort_drake import add_hand_model

    plant = MultibodyPlant(0.0)
    model = add_hand_model(plant, hand)
    plant.Finalize()
    for i in range(16):
        joint = plant.GetJointByName(f"joint_{i}", model)
        assert leap.LOWER[i] == pytest.approx(joint.position_lower_limits()[0], abs=1e-3)
        assert leap.UPPER[i] == pytest.approx(joint.position_upper_limits()[0], abs=1e-3)


def test_the_orca_driver_moves_the_vendors_simulated_motors(tmp_path, monkeypatch):
    """`MockOrcaHand` of the vendor's package: its own code, with motors in memory."""
    core = pytest.importorskip("orca_core", reason="needs the vendor's package orca_core")
    config = next(Path(core.__file__).parent.glob("models/v2/orcahand-right/config.yaml"))
    joints = [joint for joint in core.MockOrcaHand(str(config)).config.joint_ids if joint != "wrist"]
    names = [f"right_{joint}" for joint in joints]
    session = Session(tmp_path, monkeypatch, names, np.full(len(names), 0.1))
    session.run(load("orca"), "--mock", "--model", str(config), "--prefix", "right_")


class Ros:
    """Has what the node uses of rclpy and sensor_msgs; a controller that follows at once.

    After the first state, which has all joints, each has a part of them; joints are in reverse order.
    """

    def __init__(self, names, topics):
        ros, self.q, self.published, self.states = self, [0.0] * len(names), [], 0
        self.names, self.silent = names, False

        class JointState:
            def __init__(self):
                self.header = types.SimpleNamespace(stamp=None)
                self.name, self.position = [], []

        class Node:
            def create_subscription(self, kind, topic, callback, depth):
                assert (kind, topic) == (JointState, topics[1])
                ros.callback = callback

            def create_publisher(self, kind, topic, depth):
                assert (kind, topic) == (JointState, topics[0])
                return types.SimpleNamespace(publish=ros.receive)

            def get_clock(self):
                now = types.SimpleNamespace(to_msg=lambda: "a stamp")
                return types.SimpleNamespace(now=lambda: now)

            def destroy_node(self):
                pass

        def spin_once(node, timeout_sec):
            if ros.silent:
                return
            state = JointState()
            joints = list(zip(names, ros.q, strict=True))[::-1]
            if ros.states:
                joints = joints[ros.states % 2 :: 2]
            ros.states += 1
            state.name, state.position = [name for name, _ in joints], [q for _, q in joints]
            ros.callback(state)

        rclpy, messages = types.ModuleType("rclpy"), types.ModuleType("sensor_msgs.msg")
        rclpy.init = rclpy.try_shutdown = lambda: None
        rclpy.ok, rclpy.create_node, rclpy.spin_once = (lambda: True), (lambda name: Node()), spin_once
        messages.JointState = JointState
        self.modules = {
            "rclpy": rclpy,
            "sensor_msgs": types.ModuleType("sensor_msgs"),
            "sensor_msgs.msg": messages,
        }

    def receive(self, message) -> None:
        self.published.append(message)
        wanted = dict(zip(message.name, message.position, strict=True))
        self.q = [wanted[name] for name in self.names]


def ros_session(tmp_path, monkeypatch, name) -> tuple[Ros, Session]:
    """The Allegro's controller has the names of Wonik's."""
    if name == "allegro":
        topics = "/allegroHand_0/joint_cmd", "/allegroHand_0/joint_states"
        names, theirs = [f"joint_{i}" for i in range(16)], [f"joint_{i}.0" for i in range(16)]
    else:
        topics = "/hand/joint_targets", "/hand/joint_states"
        names, theirs = ["c", "b", "a"], ["a", "b", "c"]
    ros = Ros(theirs, topics)
    for module, value in ros.modules.items():
        monkeypatch.setitem(sys.modules, module, value)
    monkeypatch.delitem(sys.modules, "ros2_node", raising=False)
    return ros, Session(tmp_path, monkeypatch, names, np.linspace(-0.3, 0.4, len(names)))


@pytest.mark.parametrize("name", ["ros2_node", "allegro"])
def test_the_ros_nodes_publish_joint_states_by_name(tmp_path, monkeypatch, name):
    """In whatever order the controller reports the joints."""
    ros, session = ros_session(tmp_path, monkeypatch, name)
    session.run(load(name))
    goal = session.goal if name == "allegro" else session.goal[::-1]
    np.testing.assert_allclose(ros.q, goal, atol=0.02)
    assert ros.published[-1].header.stamp == "a stamp"


def test_a_ros_controller_that_falls_silent_is_a_fault(tmp_path, monkeypatch):
    """The node holds, and what it reports is no longer taken for the robot's position."""
    ros, session = ros_session(tmp_path, monkeypatch, "ros2_node")

    def silenced(state) -> bool:
        ros.silent = ros.silent or bool(max(state.position) > 0.2)
        return "no state of" in state.fault

    session.run(load("ros2_node"), until=silenced)
    assert session.driver.holding

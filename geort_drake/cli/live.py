"""Commands that drive a robot or its simulation live, and stand in for a glove or a robot."""

import contextlib
import math
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from geort_drake.cli.base import (
    Command,
    Json,
    ScenarioOptions,
    Side,
    command,
    finish,
    methods_epilog,
    options,
    require,
    write_json,
)
from geort_drake.errors import OutputError, UsageError


@options
class Live(Command, ScenarioOptions):
    """Drive a robot or its simulation with your hand: by webcam, headset, glove or recording.

    Without options, the command opens a page in the browser, which tracks your hand with the camera or a
    headset, and shows the simulation.

    SOURCE is web, a recording's file, or an address: sub+tcp://127.0.0.1:5556 (ZeroMQ, from `geort-drake live
    publish` or a MANUS bridge that publishes), or pull+tcp://127.0.0.1:8000 (from a bridge that pushes).
    TARGET is simulation, zmq+tcp://127.0.0.1:5557 (joint targets of any hand, for a driver), lcm, or lcm+URL
    (an Allegro hand and a Panda arm).

    You engage and disengage on the page or, with a glove, by Enter. Ctrl-C stops the command; the robot then
    holds its position. Messages over ZeroMQ and LCM are neither signed nor encrypted: whoever can send them
    moves the robot. The page is protected by the key in its address.
    """

    glove: Annotated[str, arg(metavar="SOURCE")] = "web"
    """source of the hand motion"""
    robot: Annotated[str, arg(metavar="TARGET")] = "simulation"
    """robot or simulation to drive"""
    retargeter: Annotated[str | None, arg(metavar="NAME")] = None
    """method listed above, map or Python file (default: the hand's universal map; if it has none, a map that
    is first trained on synthetic play, which takes minutes unless the cache has it)"""
    glove_id: Annotated[str | None, arg(metavar="ID")] = None
    """serial number of the MANUS glove, if a bridge sends several"""
    engage: Literal["key", "now"] = "key"
    """engage with Enter, or at once"""
    relax_after: Annotated[float, arg(metavar="S")] = 5.0
    """seconds to hold after the hand is lost, before relaxing"""
    duration: Annotated[float, arg(metavar="S")] = math.inf
    """stop after this many seconds"""
    timeout: Annotated[float, arg(metavar="S")] = 10.0
    """seconds to wait for glove and robot"""
    robot_silence: Annotated[float, arg(metavar="S")] = 0.5
    """stop if the robot sends nothing for this many seconds"""
    record: Annotated[Path | None, arg(metavar="PATH")] = None
    """record the followed hand to a file (.npz); from the page, to a folder (default: runs/live)"""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """address of the page; beyond this machine, it uses TLS with a self-signed certificate"""
    port: Annotated[int, arg(metavar="N")] = 8742
    """port of the page; 0 for any"""
    open: bool = True
    """do not open the browser"""  # help of the flag --no-open
    meshcat: bool = False
    """show the simulation in a browser on this machine"""
    json: Json = None

    epilog = staticmethod(methods_epilog)

    def run(self) -> int:
        from geort_drake import GloveReplay, load_hand, read_recording
        from geort_drake.cli.live_session import (
            add_counts,
            print_keys,
            print_summary,
            retargeter_of,
            say_state,
        )
        from geort_drake.live.glove_stream import GloveStream, open_glove
        from geort_drake.live.robot_buses import open_bus
        from geort_drake.live.robots import RobotLink, SimulatedRobot, open_meshcat
        from geort_drake.live.session import EnterKey, run_session, stopping
        from geort_drake.live.teleoperation import make_teleoperation
        from geort_drake.live.transports import is_address
        from geort_drake.people.recording_log import RecordingLog, recover
        from geort_drake.simulation.following import robot_model
        from geort_drake.systems.glove import GloveRecorder

        for option in ("relax_after", "duration", "timeout", "robot_silence"):
            value = getattr(self, option)
            require(value > 0, f"--{option.replace('_', '-')}", "a positive number", value)
        require(0 <= self.port < 65536, "--port", "a port from 0 to 65535", self.port)
        if self.meshcat and self.robot != "simulation":
            raise UsageError("--meshcat shows the simulation; give it to `geort-drake live stand-in-robot`")
        if self.record is not None and self.glove != "web":
            recover(self.record.parent)
        if self.record is not None and self.record.is_file():
            raise OutputError(f"{self.record} exists; choose another file for the recording")
        scenario = self.load_scenario()
        description = load_hand(scenario.hand)
        side, duration = description.side, self.duration
        address = None if self.robot == "simulation" else self.robot
        model = robot_model(scenario, description)
        with contextlib.ExitStack() as stack:
            link = receiver = None
            if address:
                bus = stack.enter_context(contextlib.closing(open_bus(address, description)))
                link = RobotLink(bus, model.hand, model.arm, scenario.retargeting.period)
            _warn_of_open_addresses(self.glove if is_address(self.glove) else None, address)
            if self.glove == "web":
                from geort_drake.cli.live_web import run_web

                return run_web(self, scenario, description, link)
            if is_address(self.glove):
                receiver = stack.enter_context(
                    contextlib.closing(open_glove(self.glove, side, self.glove_id))
                )
                glove = GloveStream(receiver)
            else:
                glove = GloveReplay(read_recording(self.glove, side))
                duration = min(duration, glove.duration)
            retarget, _ = retargeter_of(self.retargeter, description)
            recorder = None
            if self.record:
                log = RecordingLog(self.record, {"side": side, "source": "teleoperation"})
                recorder = GloveRecorder(scenario.retargeting.period)
                recorder.switch(log)
                # The recording is finished even if the session ends with an error.
                stack.callback(log.finish)
                stack.callback(recorder.switch, None)
            if receiver:
                receiver.handshake(self.timeout)
            if link is None:
                robot = SimulatedRobot(scenario, model, open_meshcat() if self.meshcat else None)
                start = model.hand.start, model.arm.start
            else:
                robot, start = link, link.handshake(self.timeout)
            loop = make_teleoperation(
                scenario,
                model,
                retarget,
                glove,
                robot,
                start,
                self.relax_after,
                recorder,
            )
            engaged = self.engage == "now"
            print_keys("" if engaged else "Enter engages and disengages. ")
            with stopping() as stop:
                summary = run_session(
                    loop,
                    engaged,
                    None if engaged else EnterKey(),
                    duration,
                    stop.is_set,
                    lambda: link.require_alive(self.robot_silence) if link else None,
                    say_state,
                )
        add_counts(summary, loop, link)
        print_summary(summary)
        if self.record and self.record.is_file():
            finish({"Recording": self.record}, command("grasp", recording=self.record))
        write_json(self.json, summary)
        return 0


@options
class Publish(Command):
    """Send a recording as glove messages, one per frame.

    ADDRESS is pub+tcp://127.0.0.1:5556 (ZeroMQ, for `geort-drake live --glove sub+tcp://127.0.0.1:5556`) or
    push+tcp://127.0.0.1:8000 (for pull+tcp://…). Ctrl-C stops it.
    """

    recording: Positional[Path]
    """a recording in any known format"""
    to: Annotated[str, arg(metavar="ADDRESS")] = "pub+tcp://127.0.0.1:5556"
    """address to send to"""
    side: Side = "right"
    """side of the recorded hand"""
    loop: bool = False
    """repeat the recording"""

    def run(self) -> int:
        from geort_drake import read_recording
        from geort_drake.console import say, warn
        from geort_drake.live.session import play, stopping
        from geort_drake.live.transports import is_local, open_sender

        recording = read_recording(self.recording, self.side)
        sender = open_sender(self.to)
        if not is_local(self.to):
            warn(f"{self.to} is open to the network")
        say(f"{len(recording)} frames of a {recording.side} hand to {self.to}; Ctrl-C stops")
        sent = 0
        try:
            with stopping() as stop:
                while True:
                    sent += play(recording, sender.send, stop)
                    if stop.is_set() or not self.loop:
                        break
        finally:
            sender.close()
        say(f"{sent} messages sent")
        return 0


@options
class StandInRobot(Command, ScenarioOptions):
    """Simulate a robot that is controlled like a real one, over ZeroMQ or LCM.

    ADDRESS is that of `geort-drake live --robot`. Over ZeroMQ, it takes joint targets of any hand; over LCM,
    it is a Panda with an Allegro hand. It holds its last command when no more arrive. Ctrl-C stops it.
    """

    robot: Annotated[str, arg(metavar="ADDRESS")] = "zmq+tcp://127.0.0.1:5557"
    """zmq+tcp://HOST:PORT, lcm, or lcm+URL"""
    duration: Annotated[float, arg(metavar="S")] = math.inf
    """duration, s"""
    meshcat: bool = False
    """show it in a browser on this machine"""

    def run(self) -> int:
        from pydrake.systems.analysis import Simulator

        from geort_drake.console import say, warn
        from geort_drake.live.robots import make_stand_in, open_meshcat
        from geort_drake.live.session import run_in_real_time, stopping

        require(self.duration > 0, "--duration", "a positive number", self.duration)
        scenario = self.load_scenario()
        diagram = make_stand_in(scenario, self.robot, open_meshcat() if self.meshcat else None)
        simulator = Simulator(diagram)
        simulator.Initialize()
        root = simulator.get_context()
        say(f"{scenario.hand} at {self.robot}; Ctrl-C stops it")
        with stopping() as stop:
            late = run_in_real_time(
                simulator, 0.02, lambda: not stop.is_set() and root.get_time() < self.duration
            )
        if late:
            warn(f"the simulation was slower than real time {late} times")
        return 0


def _warn_of_open_addresses(glove: str | None, robot: str | None) -> None:
    """Warns of addresses through which other machines can move the robot."""
    from geort_drake.console import warn
    from geort_drake.live.transports import is_local, split_address

    for address in (glove, robot):
        if address and not is_local(address):
            warn(f"{address} is open to the network; anyone in it can move the robot")
    if robot and robot.startswith("lcm") and is_local(robot):
        url = split_address(robot, ["lcm"])[1]
        group = url.removeprefix("udpm://").partition(":")[0]
        warn(
            f"unless {group} is routed to loopback, {url} is also heard from the network, and anyone in it "
            f"can move the robot. To route it: sudo ip link set lo multicast on && sudo ip route add {group} "
            "dev lo"
        )

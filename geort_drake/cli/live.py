"""Commands that drive a robot or its simulation live, and stand in for a glove or a robot."""

import math
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from geort_drake.cli.base import (
    Check,
    Command,
    Json,
    ScenarioOptions,
    Side,
    methods_epilog,
    options,
)
from geort_drake.errors import UsageError

_DURATION = Check(lambda seconds: seconds > 0, "a positive number")  # may be infinite
_PORT = Check(lambda port: 0 <= port < 65536, "a port from 0 to 65535")


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
    relax_after: Annotated[float, arg(metavar="S"), _DURATION] = 5.0
    """seconds to hold after the hand is lost, before relaxing"""
    duration: Annotated[float, arg(metavar="S"), _DURATION] = math.inf
    """stop after this many seconds"""
    timeout: Annotated[float, arg(metavar="S"), _DURATION] = 10.0
    """seconds to wait for glove and robot"""
    robot_silence: Annotated[float, arg(metavar="S"), _DURATION] = 0.5
    """stop if the robot sends nothing for this many seconds"""
    record: Annotated[Path | None, arg(metavar="PATH")] = None
    """record the followed hand to a file (.npz); from the page, to a folder (default: runs/live)"""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """address of the page; beyond this machine, it uses TLS with a self-signed certificate"""
    port: Annotated[int, arg(metavar="N"), _PORT] = 8742
    """port of the page; 0 for any"""
    open: bool = True
    """do not open the browser"""  # help of the flag --no-open
    meshcat: bool = False
    """show the simulation in a browser on this machine"""
    json: Json = None

    epilog = staticmethod(methods_epilog)

    def run(self) -> int:
        from geort_drake.cli.live_session import run_live

        if self.meshcat and self.robot != "simulation":
            raise UsageError("--meshcat shows the simulation; give it to `geort-drake live stand-in-robot`")
        return run_live(self)


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
        from geort_drake.live.transports import SENDERS, ZmqSocket, is_local, split_address

        recording = read_recording(self.recording, self.side)
        sender = ZmqSocket(*split_address(self.to, SENDERS), binds=True)
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
    duration: Annotated[float, arg(metavar="S"), _DURATION] = math.inf
    """duration, s"""
    meshcat: bool = False
    """show it in a browser on this machine"""

    def run(self) -> int:
        from pydrake.systems.analysis import Simulator

        from geort_drake.console import say, warn
        from geort_drake.live.robots import make_stand_in, open_meshcat
        from geort_drake.live.session import run_in_real_time, stopping

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

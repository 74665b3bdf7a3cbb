"""Drive a robot or its simulation with your hand in a browser, a glove, or a recording.

Without options, a page in the browser takes your hand from the camera or a headset and shows the simulation.

SOURCE is web, a recording's file, or an address: sub+tcp://127.0.0.1:5556 (ZeroMQ, from `geort-drake publish`
or a MANUS bridge that publishes), or pull+tcp://127.0.0.1:8000 (from a bridge that pushes).
TARGET is simulation, zmq+tcp://127.0.0.1:5557 (joint targets of any hand, for a driver), lcm, or lcm+URL
(an Allegro hand and a Panda arm). On the page, or with Enter, you engage and disengage. Ctrl-C stops; the
robot holds its position. Messages over ZeroMQ and LCM are neither signed nor encrypted: whoever can send them
moves the robot. The page asks for the key in its address.
"""

import argparse
import math
from pathlib import Path

from geort_drake.cli.options import (
    CommandParser,
    command,
    finish,
    port,
    positive,
    scenario_of,
    write_json,
)
from geort_drake.errors import OutputError, UsageError


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("--glove", default="web", metavar="SOURCE", help="source of the hand motion")
    add("--robot", default="simulation", metavar="TARGET", help="robot or simulation to drive")
    trained = (
        "checkpoint or map (default: the hand's universal map; without one, a checkpoint trained on "
        "synthetic play; if the cache has none, training it takes minutes before anything moves)"
    )
    add("--retargeter", type=Path, help=trained)
    add("--glove-id", help="serial number of the MANUS glove, if a bridge sends several")
    add("--engage", default="key", choices=["key", "now"], help="engage with Enter, or at once")
    add(
        "--relax-after",
        type=positive,
        default=5.0,
        help="seconds to hold after the hand is lost, before relaxing",
    )
    add("--duration", type=positive, default=math.inf, help="stop after this many seconds (default: never)")
    add("--timeout", type=positive, default=10.0, help="seconds to wait for glove and robot")
    add(
        "--robot-silence",
        type=positive,
        default=0.5,
        help="stop if the robot sends nothing for this many seconds",
    )
    record = "record the followed hand to a file (.npz); from the page, to a folder (default: runs/live)"
    add("--record", type=Path, metavar="PATH", help=record)
    local = "address of the page; beyond this machine, it uses TLS with a self-signed certificate"
    add("--host", default="127.0.0.1", help=local)
    add("--port", type=port, default=8742, help="port of the page; 0 for any")
    add("--no-open", action="store_true", help="do not open the browser")
    add("--meshcat", action="store_true", help="show the simulation in a browser on this machine")
    parser.add_json("a report")
    parser.add_scenario("{correction: {kind: guard}}")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import GloveReplay, load_hand, read_recording
    from geort_drake.cli.live_session import (
        checkpoint_of,
        load,
        print_keys,
        print_summary,
        say_state,
        summary_of,
    )
    from geort_drake.console import warn
    from geort_drake.live.glove_stream import GloveStream
    from geort_drake.live.robot_buses import ROBOT_PATTERNS, open_bus
    from geort_drake.live.robot_link import RobotLink
    from geort_drake.live.robots import SimulatedRobot, open_meshcat
    from geort_drake.live.session import EnterKey, run_session, stopping
    from geort_drake.live.teleoperation import make_teleoperation
    from geort_drake.live.transports import is_address, open_receiver, split_address
    from geort_drake.people.recording_log import RecordingLog
    from geort_drake.simulation.following import RobotModel
    from geort_drake.systems.glove_recorder import GloveRecorder

    if arguments.meshcat and arguments.robot != "simulation":
        raise UsageError("--meshcat shows the simulation; give it to `geort-drake stand-in-robot`")
    if arguments.record is not None and arguments.record.is_file():
        raise OutputError(f"{arguments.record} exists; choose another file for the recording")
    scenario = scenario_of(arguments)
    description = load_hand(scenario.hand)
    side, duration = description.side, arguments.duration
    address = None if arguments.robot == "simulation" else arguments.robot
    if address:
        split_address(address, ROBOT_PATTERNS)
    if arguments.glove == "web":
        from geort_drake.cli.live_web import run_web

        return run_web(arguments, scenario, description, address)
    receiver = None
    if is_address(arguments.glove):
        receiver = open_receiver(arguments.glove)
        glove = GloveStream(receiver, side, arguments.glove_id)
    else:
        glove = GloveReplay(read_recording(arguments.glove, side))
        duration = min(duration, glove.duration)
    _warn_of_open_addresses(arguments.glove if receiver else None, address)

    retarget = load(checkpoint_of(arguments, description), description)
    model = RobotModel(scenario, description)
    recorder = None
    if arguments.record:
        parts = RecordingLog(arguments.record, {"side": side, "source": "teleoperation"})
        if parts.recovered:
            warn(f"an earlier session to {arguments.record} was interrupted; it is kept as {parts.recovered}")
        recorder = GloveRecorder(scenario.retargeting.period, parts)
    link = None
    if address:
        bus = open_bus(address, description)
        link = RobotLink(bus, model.hand, model.arm, scenario.retargeting.period)
    try:
        if receiver:
            glove.handshake(arguments.timeout)
        if link is None:
            robot = SimulatedRobot(
                scenario, description, model, open_meshcat() if arguments.meshcat else None
            )
            start = robot.hand.start, robot.arm.start
        else:
            robot, start = link, link.handshake(arguments.timeout)
        loop = make_teleoperation(
            scenario,
            description,
            model,
            retarget,
            glove,
            robot,
            start,
            arguments.relax_after,
            recorder,
        )
        engaged = arguments.engage == "now"
        print_keys("" if engaged else "Enter engages and disengages. ")
        with stopping() as stop:
            report = run_session(
                loop,
                engaged,
                None if engaged else EnterKey(),
                duration,
                stop.is_set,
                lambda: link.require_alive(arguments.robot_silence) if link else None,
                say_state,
            )
    finally:
        if receiver:
            receiver.close()
        if link:
            link.bus.close()
        # Finishes the recording even if the session ended with an error.
        recorded = recorder is not None and recorder.finish()
    summary = summary_of(report, loop, link)
    print_summary(summary)
    if recorded:
        finish({"Recording": arguments.record}, command("grasp", "--recording", arguments.record))
    write_json(arguments.json, summary)
    return 0


def _warn_of_open_addresses(glove: str | None, robot: str | None) -> None:
    """Warns of addresses through which other machines can move the robot."""
    from geort_drake.console import warn
    from geort_drake.live.transports import heard_from_outside, is_local, split_address

    for address in (glove, robot):
        if address and not is_local(address):
            warn(f"{address} is open to the network; anyone in it can move the robot")
    if robot and robot.startswith("lcm") and is_local(robot):
        url = split_address(robot, ["lcm"])[1]
        if not heard_from_outside(url):
            return
        group = url.removeprefix("udpm://").partition(":")[0]
        warn(
            f"{url} is also heard from the network: anyone in it can move the robot. To keep it to "
            f"this machine: sudo ip link set lo multicast on && sudo ip route add {group} dev lo"
        )

"""Drives a robot with a glove: live messages or a recording in, a simulation or a robot on LCM out.

SOURCE is a recording's file, or an address: sub+tcp://127.0.0.1:5556 (ZeroMQ, from publish_recording.py or a
MANUS bridge that publishes), pull+tcp://127.0.0.1:8000 (from a bridge that pushes), lcm, or lcm+URL.
TARGET is simulation, lcm, or lcm+URL. docs/live.md has the messages. Enter engages and disengages; Ctrl-C
stops and leaves the robot held. Messages are neither signed nor encrypted: who can send them moves the robot.
"""

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

from geort_drake.cli.console import console, run_main, warn
from geort_drake.cli.options import (
    add_json_option,
    add_scenario_options,
    check_outputs,
    command,
    make_parser,
    scenario_of,
    write_json,
)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("--glove", required=True, metavar="SOURCE", help="where the hand's motion comes from")
    add("--robot", default="simulation", metavar="TARGET", help="what is driven")
    add(
        "--retargeter",
        type=Path,
        help="directory of the checkpoint (default: one trained on synthetic play, now or before)",
    )
    add(
        "--backend",
        default="numpy",
        choices=["numpy", "numba"],
        help="what computes the retargeting (default: %(default)s; numba takes half the time)",
    )
    add("--glove_id", help="serial number of the MANUS glove, where a bridge sends several")
    add("--engage", default="key", choices=["key", "now"], help="engage with Enter, or at once")
    add("--relax_after", type=float, default=5.0, help="s that a lost hand is held, before it relaxes")
    add("--duration", type=float, default=math.inf, help="stop after so many seconds (default: never)")
    add("--timeout", type=float, default=10.0, help="s to wait for glove and robot")
    add("--robot_silence", type=float, default=0.5, help="s that the robot may be silent before it stops")
    add("--record", type=Path, metavar="FILE", help="keep what the glove gave (.npz), to train on or replay")
    add("--meshcat", action="store_true", help="show the simulation in a browser on this machine")
    add_json_option(parser, "a report")
    add_scenario_options(parser, "{correction: {kind: guard}}")
    arguments = parser.parse_args(argv)
    for name in ("duration", "relax_after", "timeout", "robot_silence"):
        if not getattr(arguments, name) > 0:
            parser.error(f"--{name} must be positive, not {getattr(arguments, name)}")
    if arguments.meshcat and arguments.robot != "simulation":
        parser.error("--meshcat shows the simulation; give it to stand_in_robot.py")
    check_outputs(parser, (arguments.record, ".npz"))
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.comparison.train import cached_checkpoint
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.live.devices import require_hand_messages
    from geort_drake.live.glove_stream import GloveStream
    from geort_drake.live.real_time import stopping
    from geort_drake.live.robot_link import RobotLink
    from geort_drake.live.session import EnterKey, run_session
    from geort_drake.live.simulated_robot import SimulatedRobot, show
    from geort_drake.live.teleoperation import RobotModel, make_teleoperation
    from geort_drake.live.transports import (
        heard_from_outside,
        is_address,
        is_local,
        open_receiver,
        split_address,
    )
    from geort_drake.live.watchdog import WatchdogConfig
    from geort_drake.people.play import synthesize_play
    from geort_drake.people.readers import read_recording
    from geort_drake.people.recording_parts import RecordingParts
    from geort_drake.retargeting.retargeter import load_retargeter
    from geort_drake.systems.glove_recorder import GloveRecorder
    from geort_drake.systems.glove_replay import GloveReplay

    scenario = scenario_of(arguments)
    description = load_hand(scenario.hand)
    side, duration = description.side, arguments.duration
    receiver = None
    if is_address(arguments.glove):
        receiver = open_receiver(arguments.glove)
        glove = GloveStream(receiver, side, arguments.glove_id)
    else:
        glove = GloveReplay(read_recording(arguments.glove, side))
        duration = min(duration, glove.duration)
    lcm_url = None if arguments.robot == "simulation" else split_address(arguments.robot, ())[1]
    if lcm_url:
        require_hand_messages(description)
    for address in (arguments.glove if receiver else None, lcm_url):
        if address and not is_local(address):
            warn(f"{address} is open to the network; whoever is in it can move the robot")
    for url in {lcm_url, split_address(arguments.glove, ("sub", "pull"))[1] if receiver else None}:
        if url and url.startswith("udpm://") and is_local(url) and heard_from_outside(url):
            group = url.removeprefix("udpm://").partition(":")[0]
            warn(
                f"{url} is heard from the network, too: whoever is in it can move the robot. To keep it to "
                f"this machine: sudo ip link set lo multicast on && sudo ip route add {group} dev lo"
            )

    checkpoint = arguments.retargeter
    if checkpoint is None:
        checkpoint, _ = cached_checkpoint(scenario.hand, synthesize_play(seed=0, side=side))
    retarget = load_retargeter(checkpoint, HandModel(description), arguments.backend)
    model = RobotModel(scenario, description)
    recorder = None
    if arguments.record:
        parts = RecordingParts(arguments.record, {"side": side, "source": "teleoperation"})
        if parts.recovered:
            warn(f"an earlier session to {arguments.record} was interrupted; it is kept as {parts.recovered}")
        recorder = GloveRecorder(scenario.retargeting.period, parts)
    try:
        if receiver:
            glove.handshake(arguments.timeout)
        link = None
        if lcm_url is None:
            robot = SimulatedRobot(scenario, description, show() if arguments.meshcat else None)
            start = robot.hand.start, robot.arm.start
        else:
            robot = link = RobotLink(lcm_url, model.hand, model.arm, scenario.retargeting.period)
            start = link.handshake(arguments.timeout)
        loop = make_teleoperation(
            scenario,
            description,
            model,
            retarget,
            glove,
            robot,
            start,
            WatchdogConfig(relax_after=arguments.relax_after),
            recorder,
        )
        engaged = arguments.engage == "now"
        console.print("Ctrl-C stops." if engaged else "Enter engages and disengages, Ctrl-C stops.")
        with stopping() as stop:
            report = run_session(
                loop,
                engaged,
                None if engaged else EnterKey(),
                duration,
                stop,
                lambda: link.require_alive(arguments.robot_silence) if link else None,
                lambda time, state: console.print(f"{time:8.2f} s  {state}", soft_wrap=True),
            )
    finally:
        if receiver:
            receiver.close()
        # Also of a session that ended with an error.
        recorded = recorder is not None and recorder.finish()
    summary = dataclasses.asdict(report)
    if receiver:
        summary["glove"] = {
            "received": glove.received,
            "refused": glove.refused,
            "late": glove.late,
            "clock_offset_s": None if math.isnan(glove.clock_offset) else glove.clock_offset,
        }
        summary["latency_s"] = {
            name: dataclasses.asdict(latency)
            for name, latency in (("command", loop.meter.to_command()), ("echo", loop.meter.to_echo()))
        }
    if link:
        summary["robot"] = {"refused": link.inbox.refused}
    tell(summary)
    if recorded:
        train = command("simulate_grasp.py", "--recording", arguments.record)
        console.print(f"Recording: {arguments.record}", markup=False, soft_wrap=True)
        console.print(f"Train on it, and grasp: {train}", markup=False, soft_wrap=True)
    write_json(arguments.json, summary)
    return 0


def tell(summary: dict) -> None:
    """The session in a few lines."""
    for name, text in (("command", "glove to command"), ("echo", "glove to the robot and back")):
        latency = summary.get("latency_s", {}).get(name)
        if latency and latency["count"]:
            median, p99 = (f"{1e3 * latency[key]:.1f} ms" for key in ("median", "p99"))
            console.print(f"{text}: median {median}, 99th percentile {p99} ({latency['count']} commands)")
    if "glove" in summary:
        counts = summary["glove"]
        console.print(
            f"glove: {counts['received']} frames received, {counts['refused']} refused, {counts['late']} late"
        )
        if counts["clock_offset_s"] is not None:
            offset = counts["clock_offset_s"]
            console.print(
                f"glove: the quickest frame came {offset:.3f} s after its time on the glove's clock"
            )
    if summary["late"]:
        warn(f"the loop was late {summary['late']} times")
    console.print("stopped; the robot holds its last command")


if __name__ == "__main__":
    run_main(main)

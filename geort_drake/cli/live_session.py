"""Runs `geort-drake live`: sessions with a glove or a recording, and those of the page."""

import contextlib
import copy
import sys
from pathlib import Path
from typing import Any

from geort_drake.cli.base import command, finish, write_json
from geort_drake.console import console, say, warn
from geort_drake.errors import GeortError, OutputError, UsageError
from geort_drake.files import require_writable
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.hands.hand import Hand
from geort_drake.live.glove_stream import GloveStream, open_glove
from geort_drake.live.robot_buses import open_bus
from geort_drake.live.robots import RobotLink, SimulatedRobot, open_meshcat
from geort_drake.live.session import EnterKey, run_session, stopping
from geort_drake.live.teleoperation import Teleoperation, make_teleoperation
from geort_drake.live.transports import is_address, is_local, split_address
from geort_drake.live.web.control import PageControl
from geort_drake.live.web.hands import RecordedHand
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.live.web.serve import find_page, open_server
from geort_drake.live.web.session import Setup, WebTeleoperation, mount_of
from geort_drake.methods import default_method, names_of, resolve
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.people.recording_log import RecordingLog, recover
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.base import Retarget
from geort_drake.retargeting.store import shipped_maps
from geort_drake.simulation.following import RobotModel, robot_model
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.task import Task
from geort_drake.simulation.tasks import find_task, task_names
from geort_drake.systems.glove import GloveRecorder, GloveReplay

# Folder of the page's recordings, unless --record names another.
_RECORDINGS = Path("runs/live")
# What the hand is mounted on → name of the scenario.
_MOUNTS = {"arm": "Grasp", "floating": "Floating"}


def run_live(options: Any) -> int:
    """Runs the command with its options, see `geort_drake.cli.live.Live`."""
    by_page = options.glove == "web"
    if by_page:
        recover(options.record or _RECORDINGS)
    elif options.record:
        recover(options.record.parent)
    if options.record and options.record.is_file():
        raise OutputError(f"{options.record} exists; choose another file for the recording")
    scenario = options.load_scenario()
    description = load_hand(scenario.hand)
    model = robot_model(scenario, description)
    address = None if options.robot == "simulation" else options.robot
    with contextlib.ExitStack() as stack:
        link = None
        if address:
            bus = stack.enter_context(contextlib.closing(open_bus(address, description)))
            link = RobotLink(bus, model.hand, model.arm, scenario.retargeting.period)
        _warn_of_open_addresses(options.glove if is_address(options.glove) else None, address)
        if by_page:
            summary, recording = _run_page(options, scenario, link)
        else:
            summary, recording = _run_glove(options, stack, scenario, model, link)
    _print_summary(summary)
    if recording is not None and recording.is_file():
        # A session of the page has a task to replay, and others show a person's hand.
        use = command("grasp", replay=recording) if by_page else command("grasp", recording=recording)
        finish({"Recording": recording}, use)
    write_json(options.json, summary)
    return 0


def _run_glove(
    options: Any,
    stack: contextlib.ExitStack,
    scenario: Scenario,
    model: RobotModel,
    link: RobotLink | None,
) -> tuple[dict[str, Any], Path | None]:
    """Runs a session with a glove or a recording; returns its summary and its recording, if there is one."""
    side, duration = model.description.side, options.duration
    glove: GloveStream | GloveReplay
    if is_address(options.glove):
        receiver = stack.enter_context(contextlib.closing(open_glove(options.glove, side, options.glove_id)))
        glove = GloveStream(receiver)
    else:
        glove = GloveReplay(read_recording(options.glove, side))
        duration = min(duration, glove.duration)
    retarget, _ = _retargeter_of(options.retargeter, model.description)
    recorder = None
    if options.record:
        log = RecordingLog(options.record, {"side": side, "source": "teleoperation"})
        recorder = GloveRecorder(scenario.retargeting.period)
        recorder.switch(log)
        # The recording is finished even if the session ends with an error.
        stack.callback(log.finish)
        stack.callback(recorder.switch, None)
    if isinstance(glove, GloveStream):
        receiver.handshake(options.timeout)
    robot: RobotLink | SimulatedRobot
    if link is None:
        robot = SimulatedRobot(scenario, model, open_meshcat() if options.meshcat else None)
        start = model.hand.start, model.arm.start
    else:
        robot, start = link, link.handshake(options.timeout)
    loop = make_teleoperation(scenario, model, retarget, glove, robot, start, options.relax_after, recorder)
    engaged = options.engage == "now"
    console.print("Ctrl-C stops." if engaged else "Enter engages and disengages. Ctrl-C stops.")
    with stopping() as stop:
        summary = run_session(
            loop,
            engaged,
            None if engaged else EnterKey().step,
            duration,
            stop.is_set,
            lambda: link.require_alive(options.robot_silence) if link else None,
        )
    _add_counts(summary, loop, link)
    return summary, options.record


def _run_page(options: Any, scenario: Scenario, link: RobotLink | None) -> tuple[dict[str, Any], Path | None]:
    """Serves the page and runs its sessions; returns a summary of all and the last recording."""
    if options.meshcat:
        raise UsageError("--meshcat: the page shows the simulation")
    if options.record:
        require_writable(options.record, directory=True)
    page = find_page()
    if link:
        _confirm_real_robot()
    setup = _setup(options, scenario, link is not None)

    def choose(hand: str, mount: str) -> Setup:
        other = load_scenario(None, _MOUNTS[mount], options.scenario_text, hand)
        return _setup(options, other, False)

    folder = options.record or _RECORDINGS
    station = OperatorStation(
        setup.about, play=lambda: RecordedHand(_recorded_hand(folder, station.about.side))
    )
    with open_server(station, page, options.host, options.port, options.open) as server:
        control = PageControl(station, server.publish, folder)
        teleoperation = WebTeleoperation(setup, choose, station, server, control, link, options.relax_after)
        console.print("Ctrl-C stops.")
        try:
            with stopping() as stop:
                summary, loop = teleoperation.run(
                    options.engage == "now",
                    options.duration,
                    stop.is_set,
                    options.timeout,
                    options.robot_silence,
                )
        finally:
            control.close()
    _add_counts(summary, loop, link)
    summary["glove"]["refused"] += server.dropped
    return summary, control.recordings[-1] if control.recordings else None


def _setup(options: Any, scenario: Scenario, is_real: bool) -> Setup:
    """Returns a scenario's robot, a real one or that of a simulation, with its map and tasks."""
    description = load_hand(scenario.hand)
    retarget, words = _retargeter_of(options.retargeter, description)
    scenarios = {scenario.task: scenario}
    mount = mount_of(scenario)
    tasks: dict[str, list[str]] = {}
    instructions: dict[str, str] = {}
    # Only the usual scenarios have other hands, mounts and tasks.
    is_default = not is_real and options.scenario_file is None and options.scenario_name in _MOUNTS.values()
    if not is_real:
        for name in task_names() if mount == "arm" else ("grasp",):
            task = find_task(name)
            scenarios.setdefault(name, _like(scenario, task))
            tasks[name], instructions[name] = task.cases(), task.summary
    has_method_name = options.retargeter is None or options.retargeter in METHODS
    hands = sorted({*shipped_maps(), scenario.hand}) if is_default and has_method_name else []
    robot = "real" if is_real else "simulation"
    about = RobotInfo(
        description.side,
        scenario.hand,
        robot,
        tasks,
        words,
        instructions,
        mount,
        hands,
        [*_MOUNTS] if is_default else [],
    )
    return Setup(about, scenarios, description, retarget)


def _recorded_hand(folder: Path, side: str) -> Recording:
    """Returns the newest recording of a hand of this side in the page's folder, or synthetic play."""
    for path in sorted(folder.glob("*.npz"), reverse=True):
        try:
            recording = Recording.load(path)
        except GeortError:
            continue
        if recording.side == side and recording.valid.any():
            return recording
    return synthesize_play(seed=0, side=side, duration_s=60.0)


def _like(scenario: Scenario, task: Task) -> Scenario:
    """Returns the scenario of another task, with the same hand, retargeting, safety and seed."""
    other = load_scenario(hand=scenario.hand, task=task.name)
    for name in ("random_seed", "retargeting", "correction", "wrist_to_arm"):
        setattr(other, name, copy.deepcopy(getattr(scenario, name)))
    return other


def _confirm_real_robot() -> None:
    """Asks whether a page may move a real robot.

    Raises:
        UsageError: the answer is not yes.
    """
    console.print("A web page will move a real robot. Is its emergency stop within reach? Type yes:")
    if sys.stdin.readline().strip().lower() != "yes":
        raise UsageError("a page moves a real robot only if you answer yes in the terminal")


def _retargeter_of(name: str | None, description: HandDescription) -> tuple[Retarget, str]:
    """Returns the retargeter for a hand, and a few words for it.

    Args:
        name: name of a method, or path of a map or a Python file; None takes the hand's universal map, or one
            that is trained on synthetic play.

    Raises:
        GeortError: see `geort_drake.methods.names_of`.
    """
    hand = Hand(description)
    method = name or default_method(hand)
    names_of([method], hand)
    words = "universal map" if method == "universal" else f"map of {Path(method).name}"
    if name is None and method != "universal":
        say(f"no universal map is shipped for {description.name}; using a map trained on synthetic play")
        words = "map trained on synthetic play"
    return resolve(method, hand)[0], words


def _add_counts(summary: dict[str, Any], loop: Teleoperation, link: RobotLink | None) -> None:
    """Adds the counts of glove and robot to the summary of a session, for --json."""
    if (meter := loop.meter) is not None:
        glove = loop.glove
        summary["glove"] = {
            "received": glove.source.received,
            "refused": glove.source.refused,
            "last_refusal": glove.source.last_refusal or None,
            "late": glove.late,
        }
        summary["delay_s"] = meter.delay()
    if link:
        summary["robot"] = {"refused": link.bus.refused, "last_refusal": link.bus.last_refusal or None}


def _print_summary(summary: dict) -> None:
    """Prints the summary in a few lines."""
    if (delay := summary.get("delay_s")) and delay["count"]:
        median, p99 = (f"{1e3 * delay[key]:.1f} ms" for key in ("median", "p99"))
        say(f"from keypoints to joint targets: median {median}, 99th percentile {p99}")
    if counts := summary.get("glove"):
        say(
            f"glove: {counts['received']} frames received, {counts['refused']} refused, {counts['late']} late"
        )
    for name in ("glove", "robot"):
        if reason := summary.get(name, {}).get("last_refusal"):
            warn(f"{name}: {summary[name]['refused']} messages were refused, the last: {reason}")
    if summary["late"]:
        warn(f"the loop was late {summary['late']} times")
    say("stopped; the robot holds its last command")


def _warn_of_open_addresses(glove: str | None, robot: str | None) -> None:
    """Warns of addresses through which other machines can move the robot."""
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

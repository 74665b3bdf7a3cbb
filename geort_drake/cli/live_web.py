"""Runs `geort-drake live` with the page: serves it and runs its sessions."""

import copy
import sys
from pathlib import Path
from typing import Any

from geort_drake.cli.base import command, finish, write_json
from geort_drake.cli.live_session import add_counts, print_keys, print_summary, retargeter_of, say_state
from geort_drake.console import console
from geort_drake.errors import GeortError, UsageError
from geort_drake.files import require_writable
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.live.robots import RobotLink
from geort_drake.live.session import stopping
from geort_drake.live.web.control import PageControl
from geort_drake.live.web.hands import RecordedHand
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.live.web.serve import find_page, open_server
from geort_drake.live.web.session import Setup, WebTeleoperation, mount_of
from geort_drake.people.recording import Recording
from geort_drake.people.recording_log import recover
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.store import shipped_maps
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.task import Task
from geort_drake.simulation.tasks import find_task, task_names

# Folder of the page's recordings, unless --record names another.
_RECORDINGS = Path("runs/live")
# What the hand is mounted on → name of the scenario.
_MOUNTS = {"arm": "Grasp", "floating": "Floating"}


def run_web(options: Any, scenario: Scenario, description: HandDescription, link: RobotLink | None) -> int:
    """Serves the page and runs its sessions; `link` is that to a real robot, if there is one."""
    if options.meshcat:
        raise UsageError("--meshcat: the page shows the simulation")
    if options.record:
        require_writable(options.record, directory=True)
    page = find_page()
    if link:
        _confirm_real_robot()
    setup = _setup(options, scenario, description, link is not None)

    def choose(hand: str, mount: str) -> Setup:
        other = load_scenario(None, _MOUNTS[mount], options.scenario_text, hand)
        return _setup(options, other, load_hand(hand), False)

    folder = options.record or _RECORDINGS
    recover(folder)
    station = OperatorStation(
        setup.about, play=lambda: RecordedHand(_recorded_hand(folder, station.about.side))
    )
    with open_server(station, page, options.host, options.port, options.open) as server:
        control = PageControl(station, server.publish, folder)
        teleoperation = WebTeleoperation(setup, choose, station, server, control, link, options.relax_after)
        print_keys("")
        try:
            with stopping() as stop:
                summary, loop = teleoperation.run(
                    options.engage == "now",
                    options.duration,
                    stop.is_set,
                    options.timeout,
                    options.robot_silence,
                    say_state,
                )
        finally:
            control.close()
    add_counts(summary, loop, link)
    summary["glove"]["refused"] += server.dropped
    print_summary(summary)
    if control.recordings:
        last = control.recordings[-1]
        finish({"Recording": last}, command("grasp", replay=last))
    write_json(options.json, summary)
    return 0


def _setup(options: Any, scenario: Scenario, description: HandDescription, is_real: bool) -> Setup:
    """Returns a scenario's robot, a real one or that of a simulation, with its map and tasks."""
    retarget, words = retargeter_of(options.retargeter, description)
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

"""Grasp objects in simulation.

Without arguments, a simulated person grasps three objects with a Panda and an Allegro hand, through the
universal map, and a table shows the outcomes. A method that needs training is first trained on the person's
hand motion. The output folder gets results.json, the scenario, and for each trial a Rerun recording (.rrd)
and the glove and tracker data (.npz), which replace those of an earlier run.
"""

import argparse
import contextlib
import copy
import dataclasses
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geort_drake.cli.options import (
    DEFAULT_HAND,
    DEFAULT_METHOD,
    DEFAULT_SCENARIO,
    SHIPPED_METHOD,
    CommandParser,
    at_least,
    command,
    finish,
    methods_for,
    scenario_of,
    view,
    write_json,
)
from geort_drake.errors import ScenarioError
from geort_drake.resources import object_names

if TYPE_CHECKING:
    from geort_drake import Recording
    from geort_drake.simulation.scenario import Scenario
    from geort_drake.simulation.task import TrialResult

# Grasped if neither --objects nor the scenario names an object.
DEFAULT_OBJECTS = ("cylinder", "sphere", "cube")
EPILOG = "{methods}"


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_output("runs/grasp", "results.json")
    objects = (
        f"objects to grasp, of {', '.join(object_names())} (default: the scenario's object, or "
        f"{' '.join(DEFAULT_OBJECTS)} if it has none)"
    )
    add("--objects", nargs="+", metavar="NAME", help=objects)
    add("--trials", type=at_least(1), default=1, help="trials per object, each with its own seed")
    add("--recording", type=Path, help="recording of the person's hand (default: synthetic play)")
    parser.add_side()
    retargeter = (
        "method listed below, checkpoint (also give its --recording), map or Python file (default: "
        f"{SHIPPED_METHOD} if the hand has a map, else {DEFAULT_METHOD})"
    )
    add("--retargeter", metavar="NAME", help=retargeter)
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train")
    parser.add_seed("training and synthetic play")
    add(
        "--replay",
        type=Path,
        help="replay this recording, with its wrist poses, instead of the simulated person; a session is "
        "replayed with its own task, object and seed",
    )
    add("--no-rerun", action="store_true", help="write no Rerun recordings")
    parser.add_json("the results")
    parser.add_scenario()


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, __version__, load_hand, run_trial
    from geort_drake.benchmark.trials import plan
    from geort_drake.console import print_table, progress_bar, say, track, warn
    from geort_drake.export.episode import RESULTS, SCENARIO
    from geort_drake.files import locked, write_text
    from geort_drake.methods import names_of, resolve
    from geort_drake.own_method import OwnMethod
    from geort_drake.retargeting.train import training_recording
    from geort_drake.retargeting.universal import UniversalRetargeter
    from geort_drake.simulation.free_play import keep_reached, persons_hand, practise
    from geort_drake.simulation.scenario import dump_scenario
    from geort_drake.simulation.tasks import find_task
    from geort_drake.simulation.tasks.grasp import explained

    # Checks the whole request before anything is computed or written.
    base, replay = _request(arguments)
    description = load_hand(base.hand)
    hand = HandModel(description)
    has_map = SHIPPED_METHOD in methods_for(base.hand)
    method = arguments.retargeter or (SHIPPED_METHOD if has_map else DEFAULT_METHOD)
    names_of([method], hand=hand)  # refuses an unusable one
    side = arguments.side or description.side
    scenarios = scenarios_of(arguments, base, replay)
    recording = training_recording(arguments.recording, side, arguments.seed)

    # Plans before training, because planning shows whether the robot can grasp the objects at all.
    plans: dict[str, Any] = {}
    if replay is None:
        names = list(dict.fromkeys(scenario.object.name for scenario in scenarios))
        plans = {name: plan(dump_scenario(base), name) for name in track("planning", names, len(names))}
        refused = [reason for reason in plans.values() if isinstance(reason, str)]
        if len(refused) == len(plans):
            raise ScenarioError(refused[0])
        for reason in refused:
            warn(f"left out: {reason}")
        scenarios = [scenario for scenario in scenarios if isinstance(plans[scenario.object.name], list)]
    retarget, checkpoint = resolve(method, hand, recording, arguments.seed, arguments.device)
    source = str(arguments.recording or f"synthetic play, seed {arguments.seed}")
    say(f"Human motion: {source}")
    properties: dict[str, str | float] = {"method": method, "hand": description.name}
    session = replay.metadata if replay else {}
    properties |= {f"session_{name}": json.dumps(value) for name, value in session.items()}
    if checkpoint is None:
        say(f"Retargeter:   {method} (needs no training)")
    elif isinstance(retarget, OwnMethod):
        say(f"Retargeter:   {checkpoint} (own method)")
    elif isinstance(retarget, UniversalRetargeter):
        say(f"Retargeter:   {checkpoint} (universal)")
        properties |= {"checkpoint": str(checkpoint), "method": SHIPPED_METHOD}
    else:
        say(f"Retargeter:   {checkpoint}")
        info = getattr(retarget, "info", {})
        properties |= {"checkpoint": str(checkpoint), "method": info.get("method", method)}

    person = persons_hand(scenarios[0], recording)
    goals = {}
    if replay is None:
        retarget, seen = practise(base, retarget, hand, person)
        found = {scenario.object.name for scenario in scenarios}
        goals = {name: keep_reached(plans[name], seen)[0] for name in found}
    report: dict[str, Any] = {
        "version": __version__,
        "human_motion": source,
        "recording_sha256": recording.digest,
        "retargeter": str(checkpoint or method),
        "session": session,
    }
    results: list[TrialResult] = []
    with locked(arguments.output), progress_bar() as display:
        update = display.counter("grasping")
        for done, scenario in enumerate(scenarios):
            stem = f"{find_task(scenario.task).case_of(scenario)}-{scenario.random_seed}"

            def show(t: float, done: int = done, stem: str = stem) -> None:
                update(done, len(scenarios), f"{stem}: {t:.1f} s simulated")

            # The recording of an interrupted trial stays here, so that it never replaces a complete one.
            recorded = arguments.output / "interrupted" / f"{stem}.rrd"
            recorded.unlink(missing_ok=True)
            result, glove = run_trial(
                scenario,
                retarget,
                replay or (person, goals[scenario.object.name]),
                None if arguments.no_rerun else recorded,
                properties,
                show,
            )
            if not results:
                _remove_run(arguments.output)
                # The first trial's scenario; the others differ in object and seed, which are in results.json.
                write_text(arguments.output / SCENARIO, dump_scenario(scenario))
            _keep_recording(recorded, arguments.output)
            glove.save(arguments.output / f"{stem}.glove.npz")
            results.append(result)
            # Written after each trial, so that an interrupted run keeps the finished ones.
            report |= {
                "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "successes": sum(result.success for result in results),
                "trials": [result.to_json() for result in results],
            }
            write_json(arguments.output / RESULTS, report)
        update(len(scenarios), len(scenarios))

    print_table(
        ("object", "seed", "outcome", "hold at", "attempts", "height", "force", "speed"),
        [_row(result) for result in results],
        title="Grasps",
        caption="hold at: start of the successful hold; height, force: peak; speed: relative to real time",
        text=("outcome",),
    )
    held = sum(result.success for result in results)
    say(f"{held} of {len(results)} held")
    for result in results:
        if not result.success:
            where = "" if arguments.no_rerun else f"; watch {result.object}-{result.seed}.rrd"
            say(f"{result.object}, seed {result.seed}: {explained(result.outcome)}{where}")
    write_json(arguments.json, report)
    watch = None if arguments.no_rerun else view(arguments.output, "/*.rrd")
    finish({"Results": arguments.output / RESULTS}, watch)
    return 0


def scenarios_of(
    arguments: argparse.Namespace, base: "Scenario", replay: "Recording | None" = None
) -> list["Scenario"]:
    """Returns a scenario per trial, from `base`; a session sets its own object, seed and timeout."""
    from geort_drake.simulation.scenario_files import check_scenario, names_object
    from geort_drake.simulation.tasks import find_task

    objects = arguments.objects or DEFAULT_OBJECTS
    of_scenario = arguments.scenario_file, arguments.scenario_name, arguments.scenario_text
    if arguments.objects is None and names_object(*of_scenario):
        objects = [base.object.name]
    facts = replay.metadata if replay else {}
    if replay and arguments.objects is None and "object" in facts:
        objects = [facts["object"]]
        base.random_seed = int(facts.get("seed", base.random_seed))
        base.timeout = float(replay.t[-1] - replay.t[0]) + find_task("grasp").settings_of(base).hold_time
    scenarios = []
    for name in objects:
        for trial in range(arguments.trials):
            scenario = copy.deepcopy(base)
            find_task(scenario.task).choose(scenario, name)
            scenario.random_seed = base.random_seed + trial
            check_scenario(scenario)
            scenarios.append(scenario)
    return scenarios


def _remove_run(folder: Path) -> None:
    """Removes the results of an earlier run and the files of its trials, which had another scenario."""
    from geort_drake.export.episode import RESULTS

    results = folder / RESULTS
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # no results, or damaged ones
        names = {f"{trial['object']}-{trial['seed']}" for trial in json.loads(results.read_bytes())["trials"]}
        for path in (path for kind in (".rrd", ".parquet", ".glove.npz") for path in folder.glob(f"*{kind}")):
            if path.name.partition(".")[0] in names:
                path.unlink()
    results.unlink(missing_ok=True)


def _keep_recording(recorded: Path, folder: Path) -> None:
    """Moves a complete trial's recording and table to its folder; without them, removes an earlier run's."""
    for file in (recorded, recorded.with_suffix(".parquet")):
        kept = folder / file.name
        kept.unlink(missing_ok=True)
        if file.exists():
            file.replace(kept)
    with contextlib.suppress(OSError):  # the folder may contain other files
        recorded.parent.rmdir()


def try_out(retargeter: Path, hand: str, recording: Path | None = None) -> str:
    """Formats a command that tries a retargeter: `grasp` if the hand can, else `explore`.

    Args:
        retargeter: checkpoint or map.
        hand: name or description file.
        recording: recording on which the retargeter was trained.
    """
    from geort_drake import load_hand
    from geort_drake.simulation.plan.contacts import GRIPS, grip_of

    fingers = {*load_hand(hand).finger_names}
    graspable = any(fingers.issuperset(GRIPS[grip_of(name)].fingers) for name in DEFAULT_OBJECTS)
    words = ("grasp", "--retargeter") if graspable else ("explore", "--output", "explore.rrd", "--methods")
    shown = None if hand == DEFAULT_HAND else hand
    return command(*words, retargeter, "--recording", recording, "--hand", shown)


def _request(arguments: argparse.Namespace) -> "tuple[Scenario, Recording | None]":
    """Returns the scenario and the recording of --replay, which needs wrist poses unless the base is fixed.

    A session of another task uses that task's scenario, unless an option selects one.
    """
    from geort_drake import load_hand, load_scenario, read_recording

    base = scenario_of(arguments)
    name, path = arguments.scenario_name, arguments.replay
    if path is None:
        if base.fixed_base:
            raise ScenarioError(
                f"scenario '{name}': the operator cannot grasp with a fixed base; give a --replay"
            )
        return base, None
    replay = read_recording(path, arguments.side or load_hand(base.hand).side)
    task = replay.metadata.get("task", base.task)
    if task != base.task and arguments.scenario_file is None and name == DEFAULT_SCENARIO:
        base = load_scenario(text=arguments.scenario_text, hand=arguments.hand, task=task)
    if base.fixed_base:
        return base, dataclasses.replace(replay, X_WH=None)  # the base cannot follow the wrist
    if replay.X_WH is None:
        raise ScenarioError(
            f"{path}: a replay needs wrist poses (X_WH); this recording has none; use --scenario-name Fixed "
            "to keep the hand in place"
        )
    return base, replay


def _row(result: Any) -> tuple[str, ...]:
    return (
        result.object,
        str(result.seed),
        f"[{'green' if result.success else 'red'}]{result.outcome}[/]",
        "–" if result.completion_time is None else f"{result.completion_time:.1f} s",
        "–" if result.attempts is None else str(result.attempts),
        f"{100 * result.metrics['peak_height']:.0f} cm" if "peak_height" in result.metrics else "–",
        f"{result.peak_force:.0f} N",
        f"{result.simulated_time / result.wall_time:.1f} ×",
    )

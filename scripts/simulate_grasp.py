"""Trains a retargeter if there is none yet, then grasps with it in simulation.

Without arguments: synthetic glove play → training → one closed-loop grasp of each of three objects with
the Panda and the Allegro hand → a table, and in the output folder results.json, the resolved scenario,
and of each trial a Rerun recording (.rrd) and the glove and tracker data (.npz).
"""

import argparse
import contextlib
import copy
import dataclasses
import json
import shlex
import time
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake import __version__
from geort_drake.cli.console import console, progress_bar, run_main
from geort_drake.cli.options import (
    TRAINED_METHODS,
    add_json_option,
    add_scenario_options,
    at_least,
    command,
    make_parser,
    method_help,
    scenario_of,
    write_json,
)
from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.files import require_writable, write_text
from geort_drake.people.recording import SIDES
from geort_drake.retargeting.checkpoint import METRICS, Checkpoint, load_checkpoint

# Grasped where neither --objects nor the scenario says what.
DEFAULT_OBJECTS = ("cylinder", "sphere", "cube")
EPILOG = f"""\
{method_help(TRAINED_METHODS)}
objects: those of models/objects.yaml; docs/grasping.md says what each of them tries
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("--output", type=Path, default=Path("runs/grasp"), help="folder for the results")
    add(
        "--objects",
        nargs="+",
        metavar="NAME",
        help=f"what to grasp (default: the scenario's object, or {' '.join(DEFAULT_OBJECTS)} if it has none)",
    )
    add("--trials", type=at_least(1), default=1, help="trials per object, each with its own seed")
    add("--recording", type=Path, help="glove recording to train on (default: synthetic play)")
    add("--side", choices=SIDES, help="side of the recorded hand (default: the robot hand's)")
    add("--retargeter", type=Path, help="use this checkpoint, do not train; give its --recording too")
    add("--method", metavar="NAME", help=f"what to train, of those below (default: {TRAINED_METHODS[0]})")
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train")
    add("--seed", type=at_least(0), default=0, help="seed of training and synthetic play")
    add("--replay", type=Path, help="replay this recording in the operator's place, with its wrist poses")
    add("--no_rerun", action="store_true", help="write no .rrd files")
    add_json_option(parser, "the results")
    add_scenario_options(parser)
    arguments = parser.parse_args(argv)
    require_writable(arguments.output, directory=True)
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.comparison.train import DEFAULT_METHOD, METHODS, cached_checkpoint
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.people.human_hand import HumanHand
    from geort_drake.people.play import synthesize_play
    from geort_drake.people.readers import read_recording
    from geort_drake.retargeting.retargeter import load_retargeter
    from geort_drake.simulation.scenario import dump_scenario, names_object
    from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
    from geort_drake.simulation.trial import run_trial

    # What is wrong with the request is found before anything is computed or written.
    method = arguments.method or DEFAULT_METHOD
    if method not in METHODS:
        raise UnknownNameError("retargeting method", method, METHODS)
    base = scenario_of(arguments)
    description = load_hand(base.hand)
    side = arguments.side or description.side
    objects = arguments.objects or DEFAULT_OBJECTS
    if arguments.objects is None and names_object(
        arguments.scenario_file, arguments.scenario_name, arguments.scenario_text
    ):
        objects = [base.object.name]
    scenarios = []
    for name in objects:
        for trial in range(arguments.trials):
            scenario = copy.deepcopy(base)
            scenario.object.name = name
            scenario.random_seed = base.random_seed + trial
            scenario.validate()
            scenarios.append(scenario)
    replay = None
    if arguments.replay:
        replay = read_recording(arguments.replay, side)
        if base.fixed_base:
            replay = dataclasses.replace(replay, X_WH=None)  # nothing is to follow the wrist
        elif replay.X_WH is None:
            raise ScenarioError(
                f"{arguments.replay}: a replay needs wrist poses (X_WH), and it has none; with "
                "--scenario_name Fixed the hand stays where it is"
            )
    elif base.fixed_base:
        raise ScenarioError(
            f"scenario '{arguments.scenario_name}': nobody grasps from a fixed base; give a --replay"
        )

    if arguments.recording:
        recording = read_recording(arguments.recording, side, training=True)
        source = str(arguments.recording)
    else:
        recording = synthesize_play(seed=arguments.seed, side=description.side)
        source = f"synthetic play, seed {arguments.seed}"
    hand = HandModel(description)
    checkpoint, retarget = arguments.retargeter, None
    if checkpoint is not None:
        retarget = load_retargeter(checkpoint, hand)

    # Planning comes before training, as it shows whether the robot can grasp the objects at all.
    goals = {}
    if replay is None:
        with progress_bar() as progress:
            task = progress.add_task("planning", total=len(scenarios), note="")
            for scenario in scenarios:
                name = scenario.object.name
                progress.update(task, note=name)
                if name not in goals:
                    goals[name] = GraspPlanner(scenario, description).plan()
                progress.update(task, advance=1, note="")
    reused = True
    if retarget is None:
        checkpoint, reused = cached_checkpoint(base.hand, recording, method, arguments.seed, arguments.device)
        retarget = load_retargeter(checkpoint, hand)
    console.print(f"Human motion: {source}", soft_wrap=True)
    console.print(f"Retargeter:   {checkpoint} ({'reused' if reused else 'trained now'})", soft_wrap=True)

    person = HumanHand.fit(recording)
    properties = describe(load_checkpoint(checkpoint))
    results = []
    with progress_bar() as progress:
        total = len(scenarios)
        task = progress.add_task("grasping", total=total, note="")
        for scenario in scenarios:
            name = scenario.object.name
            stem = f"{name}-{scenario.random_seed}"
            result, glove = run_trial(
                scenario,
                retarget,
                replay or (person, goals[name]),
                None if arguments.no_rerun else arguments.output / f"{stem}.rrd",
                properties,
                lambda t, stem=stem: progress.update(task, note=f"{stem}: {t:.1f} s simulated"),
            )
            glove.save(arguments.output / f"{stem}.glove.npz")
            results.append(result)
            progress.update(task, advance=1, note="")

    report = {
        "version": __version__,
        "human_motion": source,
        "recording_sha256": recording.digest,
        "retargeter": str(checkpoint),
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "successes": sum(result.success for result in results),
        "trials": [result.to_json() for result in results],
    }
    write_json(arguments.output / "results.json", report)
    # That of the first trial; the others differ in object and seed, which the results name.
    write_text(arguments.output / "scenario.yaml", dump_scenario(scenarios[0]))
    console.print(results_table(results))
    write_json(arguments.json, report)
    console.print(f"Results:    {arguments.output / 'results.json'}", soft_wrap=True)
    if not arguments.no_rerun:
        # The shell is to put the names in.
        recordings = f"{shlex.quote(str(arguments.output))}/*.rrd"
        console.print(f"Watch them: {command('rerun')} {recordings}", markup=False, soft_wrap=True)
    return 0


def describe(checkpoint: Checkpoint) -> dict[str, str | float]:
    """What the recordings say of the retargeter, with the time that one call took, if it was measured."""
    properties = {
        "checkpoint": str(checkpoint.path),
        "method": checkpoint.config["method"],
        "hand": checkpoint.hand["name"],
    }
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        metrics = json.loads((checkpoint.path / METRICS).read_text(encoding="utf-8"))
        properties["retargeting_call_us"] = float(metrics["latency_us"]["median"])
    return properties


def results_table(results) -> Table:
    """One row a trial."""
    table = Table(title="Grasps")
    columns = ("object", "seed", "outcome", "hold at", "tries", "lifted", "force", "speed")
    for heading in columns:
        table.add_column(
            heading, justify="left" if heading in ("object", "outcome") else "right", no_wrap=True
        )
    for r in results:
        table.add_row(
            r.object,
            str(r.seed),
            f"[{'green' if r.success else 'red'}]{r.outcome}[/]",
            "–" if r.completion_time is None else f"{r.completion_time:.1f} s",
            "–" if r.attempts is None else str(r.attempts),
            f"{100 * r.peak_height:.0f} cm",
            f"{r.peak_force:.0f} N",
            f"{r.simulated_time / r.wall_time:.1f} ×",
        )
    table.caption = "hold at: start of the successful hold; force: peak; speed: of real time"
    return table


if __name__ == "__main__":
    run_main(main)

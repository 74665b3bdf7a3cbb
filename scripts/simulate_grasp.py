"""Trains a retargeter if there is none yet, then grasps with it in simulation.

Without arguments: synthetic glove play → training → one closed-loop grasp of each of three objects with
the Panda and the Allegro hand → a table, and in the output folder results.json, the resolved scenario,
and of each trial a Rerun recording (.rrd) and the glove and tracker data (.npz).
"""

import argparse
import copy
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake import __version__
from geort_drake.command_line import add_scenario_options, at_least, make_parser, scenario_of
from geort_drake.console import console, progress_bar, run_main
from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.files import require_writable, write_text

DEFAULT_OBJECTS = ("cylinder", "sphere", "cube")


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("--output", type=Path, default=Path("runs/grasp"), help="folder for the results (runs/grasp)")
    add("--objects", nargs="+", help=f"what to grasp ({' '.join(DEFAULT_OBJECTS)})")
    add("--trials", type=at_least(1), default=1, help="trials per object, each with its own seed (1)")
    add("--recording", type=Path, help="train on this glove recording instead of synthetic play")
    add("--side", choices=["left", "right"], help="side of the recorded hand (the robot hand's)")
    add("--retargeter", type=Path, help="use this checkpoint, do not train; give its --recording too")
    add("--method", help="retargeting method to train (train_retargeter.py's default)")
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train (cpu)")
    add("--seed", type=at_least(0), default=0, help="seed of training and synthetic play (0)")
    add("--replay", type=Path, help="replay this recording with wrist poses in the operator's place")
    add("--no_rerun", action="store_true", help="write no .rrd files")
    add("--json", action="store_true", help="also print the results as JSON on stdout")
    add_scenario_options(parser)
    arguments = parser.parse_args(argv)
    require_writable(arguments.output, directory=True)
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.evaluation.checkpoint_cache import cached_checkpoint
    from geort_drake.evaluation.pipeline import DEFAULT_METHOD, METHODS
    from geort_drake.gloves.human_hand import HumanHand
    from geort_drake.gloves.play import synthesize_play
    from geort_drake.gloves.readers import read_recording
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.retargeting.retargeter import load_retargeter
    from geort_drake.simulation.grasp_planner import GraspPlanner
    from geort_drake.simulation.scenario import dump_scenario
    from geort_drake.simulation.trial import run_trial

    # What is wrong with the request is found before anything is computed or written.
    method = arguments.method or DEFAULT_METHOD
    if method not in METHODS:
        raise UnknownNameError("retargeting method", method, METHODS)
    base = scenario_of(arguments)
    description = load_hand(base.hand)
    side = arguments.side or description.side
    scenarios = []
    for name in arguments.objects or DEFAULT_OBJECTS:
        for trial in range(arguments.trials):
            scenario = copy.deepcopy(base)
            scenario.object.name = name
            scenario.random_seed = base.random_seed + trial
            scenario.validate()
            scenarios.append(scenario)
    replay = None
    if arguments.replay:
        replay = read_recording(arguments.replay, side)
        if replay.X_WH is None:
            raise ScenarioError(f"{arguments.replay}: a replay needs wrist poses (X_WH), and it has none")

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
                {"method": method, "checkpoint": str(checkpoint), "version": __version__},
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
    text = json.dumps(report, indent=2, allow_nan=False)
    write_text(arguments.output / "results.json", text + "\n")
    write_text(arguments.output / "scenario.yaml", dump_scenario(base))
    console.print(results_table(results))
    if arguments.json:
        print(text)
    console.print(f"Results: {arguments.output / 'results.json'}")
    if not arguments.no_rerun:
        console.print(f"Watch them: {rerun_command()} {arguments.output}/*.rrd", soft_wrap=True)
    return 0


def rerun_command() -> str:
    """The viewer that belongs to this Python, as one would type it here."""
    beside = Path(sys.executable).with_name("rerun")
    return os.path.relpath(beside) if beside.exists() else "rerun"


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

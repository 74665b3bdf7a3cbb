"""Evaluate retargeting methods side by side on recordings of people's hands.

geort-drake evaluate --recording alex.npy --methods geort vector_online --json table.json
"""

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.cli.options import (
    STDOUT,
    add_hand_option,
    add_json_option,
    at_least,
    finish,
    method_help,
    output_folder,
    require_distinct,
    write_json,
)
from geort_drake.errors import UsageError

if TYPE_CHECKING:
    from rich.progress import Progress

    from geort_drake.comparison.comparison import Comparison, Outcome
    from geort_drake.people.recording import Recording

EPILOG = f"""\
{method_help()}
protocols, each with its own tables:
  same person      trained and scored on --recording, as in the paper; always done
  held-out blocks  with --held-out K: the recording is cut into K blocks, and each is scored by a method
                   trained on the others, without the seconds next to the block
  another person   with --score-on FILE...: trained on --recording, scored on the other files

for the table of all methods:
  geort-drake evaluate --recording alex.npy --held-out 5 --score-on ben.npz --seeds 0 1 2 --json table.json

K blocks mean K more trainings, and every seed repeats all of them. The cache keeps each training, so the
same command continues an interrupted run; only scoring is repeated. --json is rewritten after each method.
A method may also be the directory of a checkpoint, which is scored by the protocols that fit its training.

Online methods start from rest in every recording and block and answer its frames in order. Where a metric
asks about other hands, the hand is held until the answer has settled, starting at the nearest frame.

A sweep trains methods again and again with one setting changed, and writes tables and a plot to --output:
  geort-drake evaluate --recording alex.npy --methods geort --sweep --seeds 0 1 2 --jobs 2 --output runs/sweep
The same command continues an interrupted sweep.

Exit code 1 if something could not be scored or trained; the rest is shown all the same.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add_hand_option(parser)
    add("--recording", type=Path, required=True, help="what methods are trained on")
    add("--held-out", type=int, metavar="K", help="also score on K held-out blocks, for example 5")
    add("--score-on", type=Path, nargs="+", metavar="FILE", help="also score on recordings of other people")
    add(
        "--methods",
        nargs="+",
        metavar="NAME",
        help="of those below, or directories of checkpoints (default: all of them)",
    )
    add(
        "--seeds",
        type=at_least(0),
        nargs="+",
        metavar="SEED",
        default=[0],
        help="seeds of training and metrics; of several, mean and worst are shown",
    )
    add(
        "--frames",
        type=at_least(10),
        metavar="N",
        help="score on the first N valid frames only, also of each block (default: all)",
    )
    add_json_option(parser, "all figures")
    add("--plots", type=output_folder, metavar="FOLDER", help="plot the first seed, same person, here")
    group = parser.add_argument_group("sweep")
    group.add_argument(
        "--sweep",
        nargs="*",
        metavar="NAME=V1,V2",
        help="train with other values of these settings, one at a time; without names, with every loss "
        "weight at 0, half and double its value",
    )
    group.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of all runs, repeatable"
    )
    group.add_argument("--output", type=output_folder, metavar="FOLDER", help="folder of the sweep")
    group.add_argument("--jobs", type=at_least(1), metavar="N", help="runs at a time (default: 1)")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.comparison.comparison import Comparison, check_methods, method_names
    from geort_drake.comparison.plots import write_plots
    from geort_drake.comparison.protocols import SAME_PERSON, held_out, other_person, same_person
    from geort_drake.comparison.report import failures, report, tables
    from geort_drake.console import console, progress_bar, warn
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.people.readers import read_recording

    _check(arguments)
    if arguments.sweep is not None:
        return _sweep(arguments)
    description = load_hand(arguments.hand)
    hand = HandModel(description)
    methods = arguments.methods or list(method_names())
    check_methods(methods, hand)
    recording = read_recording(arguments.recording, description.side, training=True)
    protocols = [same_person(recording, arguments.recording.name)]
    if arguments.held_out is not None:
        protocols.append(held_out(recording, arguments.held_out))
    if arguments.score_on:
        others = {str(path): read_recording(path, description.side) for path in arguments.score_on}
        protocols.append(other_person(recording, others))

    with progress_bar() as progress:
        trainer = _trainer(arguments.hand, progress)
        comparison = Comparison(hand, protocols, arguments.seeds, trainer, arguments.frames)
        results = _run(comparison, methods, arguments, recording, progress)
    for table in tables(comparison, results):
        console.print(table)
    for line in failures(results):
        warn(f"not scored: {line}")
    write_json(arguments.json, report(comparison, results, recording, arguments.recording.name))
    written = {} if arguments.json in (None, STDOUT) else {"Figures": arguments.json}
    if arguments.plots:
        firsts = {name: of_method[SAME_PERSON][0].judged for name, of_method in results.items()}
        scored = {name: judged for name, judged in firsts.items() if judged is not None}
        space = comparison.space(arguments.seeds[0])
        written["Plots"] = ", ".join(map(str, write_plots(arguments.plots, scored, hand.finger_names, space)))
    if not (arguments.json or arguments.plots):
        console.print("Nothing was written: --json FILE keeps these figures, and --plots FOLDER draws them.")
    finish(written)
    return 1 if any(failures(results)) else 0


def _run(
    comparison: "Comparison",
    methods: Sequence[str],
    arguments: argparse.Namespace,
    recording: "Recording",
    progress: "Progress",
) -> dict[str, dict[str, list["Outcome"]]]:
    """Judges every method, and writes what is known to the JSON file whenever one is done."""
    from geort_drake.comparison.report import report

    results = {}
    total = comparison.cases_per_method * len(methods)
    task = progress.add_task("evaluation", total=total, note="")
    done = -1

    def starts(note: str) -> None:
        nonlocal done
        done += 1
        progress.update(task, completed=done, note=note)

    for name in methods:
        results[name] = comparison.run(name, starts)
        content = report(comparison, results, recording, arguments.recording.name)
        write_json(arguments.json, content, done=False)
    progress.update(task, completed=total, note="")
    return results


def _sweep(arguments: argparse.Namespace) -> int:
    """Trains what a sweep still lacks, and writes its tables and plot."""
    from geort_drake.comparison.ablation import ablation
    from geort_drake.comparison.plots import write_sweep_plot
    from geort_drake.comparison.sweep import SWEEP, Ground, Sweep, plan, read_sweep
    from geort_drake.console import console, progress_bar, warn
    from geort_drake.files import write_text
    from geort_drake.hands.description import load_hand

    hand = load_hand(arguments.hand)
    runs = plan(arguments.methods, arguments.seeds, arguments.sweep, arguments.set, hand)
    ground = Ground.of(arguments.hand, arguments.recording, runs[0].common)
    sweep = Sweep(runs, ground, arguments.output)
    failed = []
    with progress_bar() as progress:
        progress.speed_estimate_period = math.inf
        task = progress.add_task("runs", total=len(runs), completed=len(runs) - len(sweep.missing), note="")
        progress.advance(task, 1e-9)  # the time left is reckoned from here on
        for record in sweep.train(arguments.jobs or 1):
            progress.update(task, advance=1, note=record["name"])
            if "error" in record:
                failed.append(record["name"])
                warn(f"{record['name']}: {record['error']}")
    content = read_sweep(arguments.output)
    write_text(arguments.output / "ablation.md", ablation(content))
    plot = write_sweep_plot(arguments.output, content["runs"])
    lines = {"Tables": arguments.output / "ablation.md", "Plot": plot, "Figures": arguments.output / SWEEP}
    finish(lines)
    if failed:
        console.print(f"{len(failed)} runs failed; the same command tries them again.")
    return 1 if failed else 0


def _trainer(hand_name: str, progress: "Progress") -> "Callable[[Recording, str, int], Path]":
    """`cached_checkpoint`, with the bars of training in place of these ones."""
    from geort_drake.comparison.train import cached_checkpoint

    def train(recording: "Recording", method: str, seed: int) -> Path:
        progress.stop()
        try:
            return cached_checkpoint(hand_name, recording, method, seed)[0]
        finally:
            progress.start()

    return train


def _check(arguments: argparse.Namespace) -> None:
    """Refuses contradicting options before anything is read."""
    sweeping, comparing = ("set", "output", "jobs"), ("held_out", "score_on", "frames", "json", "plots")
    others = sweeping if arguments.sweep is None else comparing
    wrong = [f"--{name}" for name in others if getattr(arguments, name)]
    if wrong:
        only = "only" if arguments.sweep is None else "not"
        raise UsageError(f"{', '.join(wrong)}: {only} with --sweep".replace("_", "-"))
    if arguments.sweep is not None and not (arguments.methods and arguments.output):
        raise UsageError("--sweep needs --methods and --output")
    require_distinct("--seeds", arguments.seeds)
    require_distinct("--score-on", arguments.score_on or [])
    require_distinct("--methods", [Path(name).name for name in arguments.methods or []])

"""Evaluates retargeting methods side by side on recordings of people's hands.

python scripts/evaluate_retargeting.py --recording alex.npy --methods geort vector_online --json table.json
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.progress import Progress

from geort_drake.cli.console import console, progress_bar, run_main, warn
from geort_drake.cli.options import (
    STDOUT,
    add_json_option,
    at_least,
    make_parser,
    method_help,
    write_json,
)
from geort_drake.comparison.comparison import Comparison, Outcome, check_methods, method_names
from geort_drake.comparison.plots import write_plots
from geort_drake.comparison.protocols import (
    GUARD_S,
    SAME_PERSON,
    held_out,
    other_person,
    same_person,
)
from geort_drake.comparison.report import failures, report, tables
from geort_drake.files import require_writable
from geort_drake.hands.description import hand_names, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording

EPILOG = f"""\
{method_help()}
protocols, each with tables of its own:
  same person      trained and scored on --recording, as in the paper; always done
  held-out blocks  with --held_out K: the recording is cut into K blocks, and each is scored by a method
                   trained on the others, without the {GUARD_S:g} s before and after the block
  another person   with --score_on FILE...: trained on --recording, scored on the other files

for the table of all methods:
  python scripts/evaluate_retargeting.py --recording alex.npy --held_out 5 --score_on ben.npz \\
      --seeds 0 1 2 --json table.json

K blocks train K times more, every seed all of them again. Each training is kept in the cache, so the same
command goes on where a run was stopped; only scoring is repeated. --json is written anew after each method.
A method may also be the directory of a checkpoint, which is scored as it is, by the protocols that fit what
it was trained on.

Online methods start from rest in every recording and block and answer its frames in their order; where a
metric asks about hands that were not recorded, the hand is held until their answer has settled, from their
state at the nearest frame.

Ends with code 1 if something could not be scored; the rest is shown all the same.
"""


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
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
    if arguments.plots:
        firsts = {name: of_method[SAME_PERSON][0].judged for name, of_method in results.items()}
        scored = {name: judged for name, judged in firsts.items() if judged is not None}
        space = comparison.space(arguments.seeds[0])
        for path in write_plots(arguments.plots, scored, hand.finger_names, space):
            console.print(f"Plot: {path}", markup=False, soft_wrap=True)
    if arguments.json not in (None, STDOUT):
        text = f"Figures: {arguments.json} (docs/data_formats.md explains them)"
        console.print(text, markup=False, soft_wrap=True)
    elif not (arguments.json or arguments.plots):
        console.print("Nothing was written: --json FILE keeps these figures, and --plots FOLDER draws them.")
    return 1 if any(failures(results)) else 0


def _run(
    comparison: Comparison,
    methods: Sequence[str],
    arguments: argparse.Namespace,
    recording: Recording,
    progress: Progress,
) -> dict[str, dict[str, list[Outcome]]]:
    """Judges every method, and writes what is known to the JSON file whenever one is done."""
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


def _trainer(hand_name: str, progress: Progress) -> Callable[[Recording, str, int], Path]:
    """`cached_checkpoint`, with the bars of training in place of these ones."""
    from geort_drake.comparison.train import cached_checkpoint

    def train(recording: Recording, method: str, seed: int) -> Path:
        progress.stop()
        try:
            return cached_checkpoint(hand_name, recording, method, seed)[0]
        finally:
            progress.start()

    return train


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__, EPILOG)
    parser.add_argument(
        "--hand",
        default="allegro_right",
        help=f"name or file of a hand description; names: {', '.join(hand_names())}",
    )
    parser.add_argument("--recording", type=Path, required=True, help="what methods are trained on")
    parser.add_argument("--held_out", type=int, metavar="K", help="also score on K held-out blocks; 5, say")
    parser.add_argument(
        "--score_on", type=Path, nargs="+", metavar="FILE", help="also score on recordings of other people"
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        metavar="NAME",
        help="of those below, or directories of checkpoints (default: all of them)",
    )
    parser.add_argument(
        "--seeds",
        type=at_least(0),
        nargs="+",
        metavar="SEED",
        default=[0],
        help="of training and metrics; of several, the mean and the worst are shown",
    )
    parser.add_argument(
        "--frames",
        type=at_least(10),
        metavar="N",
        help="score on the first N valid frames only, of each block too (default: all)",
    )
    add_json_option(parser, "all figures")
    parser.add_argument(
        "--plots", type=Path, metavar="FOLDER", help="write plots of the first seed, same person, here"
    )
    arguments = parser.parse_args(argv)
    _check(parser, arguments)
    return arguments


def _check(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Refuses what argparse cannot, before anything is read."""
    listed = {
        "seeds": arguments.seeds,
        "score_on": arguments.score_on or [],
        "methods": [Path(name).name for name in arguments.methods or []],
    }
    for option, values in listed.items():
        twice = sorted({str(value) for value in values if values.count(value) > 1})
        if twice:
            parser.error(f"--{option} lists {', '.join(twice)} more than once")
    if arguments.plots:
        require_writable(arguments.plots, directory=True)


if __name__ == "__main__":
    run_main(main)

"""Compare retargeting methods by metrics on recordings of hands.

geort-drake evaluate --recording alex.npy --methods geort anyteleop --json table.json
"""

import argparse
import itertools
from pathlib import Path

from geort_drake.cli.options import STDOUT, CommandParser, at_least, finish, methods_for, write_json

EPILOG = """\
{methods}
protocols:
  same person      always: train and score on --recording, as in the paper
  held-out blocks  --held-out K: cut the recording into K blocks; score each with a method trained on the
                   others, except for one second on either side of the block
  another person   --score-on FILE...: train on --recording, score on the other files

all methods and protocols:
  geort-drake evaluate --recording alex.npy --held-out 5 --score-on ben.npz --seeds 0 1 2 --json table.json

K blocks need K more trainings per seed. Trainings are cached, so the same command resumes an interrupted run;
only the scoring is repeated. --json is rewritten after each method. A map is scored by the protocols
that fit its training.

Online methods start from rest in every recording and block, and process the frames in order. For metrics on
unrecorded hands, they start at the nearest frame, and get the same hand until their output has settled.

Exit codes: 0 success; 1 a method could not be scored; 2 the input is invalid.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_hand()
    add("--recording", type=Path, required=True, help="recording to train on")
    add("--held-out", type=int, metavar="K", help="also score on K held-out blocks, for example 5")
    add("--score-on", type=Path, nargs="+", metavar="FILE", help="also score on recordings of other people")
    methods = "methods listed below, maps or Python files (default: all)"
    add("--methods", nargs="+", metavar="NAME", help=methods)
    seeds = "seeds of training and metrics; with several, shows mean and worst"
    add("--seeds", type=at_least(0), nargs="+", metavar="SEED", default=[0], help=seeds)
    frames = "score only the first N valid frames of each recording and block (default: all)"
    add("--frames", type=at_least(10), metavar="N", help=frames)
    parser.add_json("all figures")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, load_hand, read_recording
    from geort_drake.console import console, progress_bar, warn
    from geort_drake.methods import names_of
    from geort_drake.metrics.compare import Comparison, Row, failures, report, tables
    from geort_drake.metrics.protocols import held_out, other_person, same_person

    description = load_hand(arguments.hand)
    hand = HandModel(description)
    methods = list(dict.fromkeys(arguments.methods or methods_for(arguments.hand)))
    names_of(methods, hand=hand)  # refuses unusable ones before anything is trained
    seeds = list(dict.fromkeys(arguments.seeds))
    recording = read_recording(arguments.recording, description.side, training=True)
    protocols = [same_person(recording, arguments.recording.name)]
    if arguments.held_out is not None:
        protocols.append(held_out(recording, arguments.held_out))
    if arguments.score_on:
        others = {str(path): read_recording(path, description.side) for path in arguments.score_on}
        protocols.append(other_person(recording, others))
    comparison = Comparison(hand, protocols, seeds, arguments.frames)
    rows: list[Row] = []
    done, total = itertools.count(), comparison.cases_per_method * len(methods)
    with progress_bar() as display:
        update = display.counter("evaluation")
        for name in methods:
            rows += comparison.run(name, lambda note: update(next(done), total, note))
            draft = report(comparison, rows, recording, arguments.recording.name)
            write_json(arguments.json, draft, done=False)
        update(total, total)
    for table in tables(comparison, rows):
        console.print(table)
    for line in failures(rows):
        warn(f"not scored: {line}")
    write_json(arguments.json, report(comparison, rows, recording, arguments.recording.name))
    written = {} if arguments.json in (None, STDOUT) else {"Figures": arguments.json}
    if arguments.json is None:
        console.print("Nothing was written; --json FILE saves the figures.")
    finish(written)
    return 1 if any(failures(rows)) else 0

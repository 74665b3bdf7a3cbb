"""Fit the universal map to one person's hand.

geort-drake refit my_hand.npz runs/my_map

The output is a checkpoint. Its metrics are measured on the recording.
"""

import argparse
import json
from pathlib import Path

from geort_drake.cli.grasp import try_out
from geort_drake.cli.options import CommandParser, at_least, finish, output_folder, write_json


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("recording", type=Path, help="recording of the person's hand, one to five minutes")
    add("output", type=output_folder, help="directory of the checkpoint")
    parser.add_hand()
    add("--map", type=Path, metavar="FILE", help="universal map (default: the one shipped for the hand)")
    add("--steps", type=at_least(1), help="training steps (default: 400 a minute, 600 to 2000)")
    parser.add_seed("training and metrics")
    parser.add_json("the metrics")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import refit_checkpoint
    from geort_drake.cli.train import metric_rows
    from geort_drake.console import print_table
    from geort_drake.retargeting.checkpoint import METRICS, load_checkpoint

    path = refit_checkpoint(
        arguments.recording,
        arguments.output,
        arguments.hand,
        arguments.map,
        arguments.steps,
        arguments.seed,
        not arguments.quiet,
    )
    seconds = load_checkpoint(path).provenance["timings"]["fit_s"]
    metrics = json.loads((path / METRICS).read_text(encoding="utf-8"))
    print_table(("metric", "value"), metric_rows(metrics), f"fitted in {seconds:.1f} s")
    write_json(arguments.json, metrics)
    finish({"Checkpoint": path}, try_out(path, arguments.hand, arguments.recording))
    return 0

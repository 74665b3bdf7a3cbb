"""Fit a trained retargeter to another person's hand.

The output is a checkpoint. Its metrics are measured on the new recording.
"""

import argparse
import json
from pathlib import Path

from geort_drake.cli.options import CommandParser, at_least, command, finish, output_folder, write_json


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("checkpoint", type=Path, help="directory of the checkpoint to start from")
    add("recording", type=Path, help="recording of the new person's hand, about a minute")
    add("output", type=output_folder, help="directory of the new checkpoint")
    parser.add_hand(None, " (default: the checkpoint's)")
    add("--steps", type=at_least(0), default=600, help="fine-tuning steps; 0 skips fine-tuning")
    parser.add_seed("fine-tuning and metrics")
    parser.add_json("the metrics")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import refit_checkpoint
    from geort_drake.cli.train import metric_rows
    from geort_drake.console import print_table, progress_bar
    from geort_drake.retargeting.checkpoint import METRICS, load_checkpoint

    with progress_bar() as display:
        update = display.counter("fitting")
        path = refit_checkpoint(
            arguments.checkpoint,
            arguments.recording,
            arguments.output,
            arguments.hand,
            arguments.steps,
            arguments.seed,
            lambda done, total, *_: update(done, total),
        )
    provenance = load_checkpoint(path).provenance
    metrics = json.loads((path / METRICS).read_text(encoding="utf-8"))
    rows = [
        (
            finger,
            "  ".join(f"{row[axis]:.2f}" for axis, row in enumerate(maps["A"])),
            "  ".join(f"{1e3 * value:+.0f}" for value in maps["b"]),
            f"{maps['miss_mm']:.1f} mm",
        )
        for finger, maps in provenance["refit"]["affine"].items()
    ]
    print_table(("finger", "scale, x y z", "shift, mm", "residual"), rows)
    title = f"after {provenance['timings']['fit_s']:.1f} s"
    print_table(("metric", "value"), metric_rows(metrics), title)
    write_json(arguments.json, metrics)
    words = ("--retargeter", path, "--recording", arguments.recording, "--hand", arguments.hand)
    finish({"Checkpoint": path}, command("grasp", *words))
    return 0

"""Fits a trained retargeter to another person's hand, from about a minute of their motion.

What it writes is an ordinary checkpoint. Its metrics are on the recording it was fitted to.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake.cli.console import console, progress_bar, run_main
from geort_drake.cli.options import add_json_option, at_least, command, make_parser, write_json
from geort_drake.files import require_writable


def main(argv: Sequence[str] | None = None) -> None:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.comparison.refit import refit_checkpoint
    from geort_drake.retargeting.checkpoint import METRICS, load_checkpoint
    from geort_drake.retargeting.methods.coupled.refit import FINE_TUNING

    steps = FINE_TUNING.steps if arguments.steps is None else arguments.steps
    with progress_bar() as progress:
        task = progress.add_task("fitting", total=steps or None, note="")
        path = refit_checkpoint(
            arguments.checkpoint,
            arguments.recording,
            arguments.output,
            arguments.hand,
            steps,
            arguments.seed,
            lambda done, total, *_: progress.update(task, completed=done, total=total),
        )
    provenance = load_checkpoint(path).provenance
    metrics = json.loads((path / METRICS).read_text(encoding="utf-8"))
    table = Table("finger", "stretched by, x y z", "moved by, mm", "then off by", box=None)
    for finger, maps in provenance["refit"]["affine"].items():
        table.add_row(
            finger,
            "  ".join(f"{row[axis]:.2f}" for axis, row in enumerate(maps["A"])),
            "  ".join(f"{1e3 * value:+.0f}" for value in maps["b"]),
            f"{maps['miss_mm']:.1f} mm",
        )
    console.print(table)
    closed = metrics["pinch"]["closed"]
    console.print(
        f"motion preservation {metrics['motion_preservation']:.3f}, "
        f"coverage {metrics['coverage']['10mm']:.2f}, "
        f"pinches closed {'–' if closed is None else f'{100 * closed:.0f} %'}, self-collision "
        f"{100 * metrics['self_collision']:.1f} %; fitted in {provenance['timings']['fit_s']:.1f} s"
    )
    write_json(arguments.json, metrics)
    console.print(f"Checkpoint: {path}", markup=False, soft_wrap=True)
    hand = [] if arguments.hand is None else ["--hand", arguments.hand]
    grasp = command("simulate_grasp.py", "--retargeter", path, "--recording", arguments.recording, *hand)
    console.print(f"Grasp with it: {grasp}", markup=False, soft_wrap=True)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("checkpoint", type=Path, help="directory of the checkpoint to start from")
    add("recording", type=Path, help="about a minute of the new person's hand, in any format that is read")
    add("output", type=Path, help="directory of the new checkpoint")
    add("--hand", help="robot hand, by name or file of its description (default: the checkpoint's)")
    add(
        "--steps",
        type=at_least(0),
        help="of fine-tuning; 0 leaves it out, which takes a second (default: 600)",
    )
    add("--seed", type=at_least(0), default=0, help="of fine-tuning and metrics")
    add_json_option(parser, "the metrics")
    arguments = parser.parse_args(argv)
    require_writable(arguments.output, directory=True)
    return arguments


if __name__ == "__main__":
    run_main(main)

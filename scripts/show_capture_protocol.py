"""Shows what a new user records in five minutes: the steps as a table, and our synthetic hand doing them."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake.cli.console import console, run_main
from geort_drake.cli.options import at_least, check_outputs, command, make_parser
from geort_drake.people.protocol import STEPS, demonstrate


def main(argv: Sequence[str] | None = None) -> None:
    arguments = parse_arguments(argv)
    table = Table("from", "for", "step", "what to do", box=None)
    begin = 0.0
    for step in STEPS:
        table.add_row(
            f"{begin // 60:.0f}:{begin % 60:02.0f}", f"{step.seconds:g} s", step.name, step.instruction
        )
        begin += step.seconds
    console.print(table)
    console.print("docs/capture.md explains it; --output FILE.rrd shows a hand doing it.")
    if arguments.output is None and arguments.recording is None:
        return
    recording, names = demonstrate(arguments.seed)
    if arguments.recording is not None:
        recording.save(arguments.recording)
        console.print(f"Recording: {arguments.recording}", markup=False, soft_wrap=True)
    if arguments.output is not None:
        # Imported here, as it brings Drake and Rerun, and the table needs neither.
        from geort_drake.rerun.hand_recording import write_hand

        write_hand(recording, arguments.output, states={"step": names})
        console.print(f"Watch it: {command('rerun', arguments.output)}", markup=False, soft_wrap=True)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    parser.add_argument("--output", type=Path, help=".rrd to write: the synthetic hand in Rerun")
    parser.add_argument("--recording", type=Path, help=".npz to write: the same as a recording")
    parser.add_argument("--seed", type=at_least(0), default=0, help="of the demonstration")
    arguments = parser.parse_args(argv)
    check_outputs(parser, (arguments.output, ".rrd"), (arguments.recording, ".npz"))
    return arguments


if __name__ == "__main__":
    run_main(main)

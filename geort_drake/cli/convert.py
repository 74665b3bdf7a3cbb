"""Convert a recording of a hand to geort-drake's own format (.npz).

Also reports faults, as `geort-drake check-recording` does.

Exit codes: 0 usable, perhaps with warnings; 2 refused.
"""

import argparse
import os

from geort_drake.cli import check_recording
from geort_drake.cli.options import CommandParser, output_file
from geort_drake.errors import UsageError

EPILOG = check_recording.EPILOG


def add_arguments(parser: CommandParser) -> None:
    check_recording.add_reading_arguments(parser)
    parser.add_argument("output", type=output_file(".npz"), help="file to write (.npz)")
    parser.add_json("the report")
    parser.set_defaults(watch=False)


def run(arguments: argparse.Namespace) -> int:
    # Path.resolve raises an error for a link to itself.
    if os.path.realpath(arguments.output) == os.path.realpath(arguments.input):
        raise UsageError(f"{arguments.output}: choose another file than the recording itself")
    return check_recording.run(arguments)

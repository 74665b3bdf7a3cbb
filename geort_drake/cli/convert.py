"""Convert a recording of a hand in any known format to geort-drake's .npz.

It reports the recording's health as `geort-drake check-recording` does. Exit code 2: refused.
"""

import argparse

from geort_drake.cli import check_recording
from geort_drake.cli.options import CommandParser, output_file

EPILOG = check_recording.EPILOG


def add_arguments(parser: CommandParser) -> None:
    check_recording.add_reading_arguments(parser)
    parser.add_argument("output", type=output_file(".npz"), help=".npz to write")
    parser.add_json("the report")
    parser.set_defaults(picture=None, watch=False)


def run(arguments: argparse.Namespace) -> int:
    return check_recording.run(arguments)

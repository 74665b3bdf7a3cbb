"""Take a screenshot of a Rerun recording (.rrd) without a display."""

import argparse
from pathlib import Path

from geort_drake.cli.options import CommandParser, finish, output_file

EPILOG = """\
Without a graphics card, Rerun's viewer needs Mesa's software driver (Debian and Ubuntu: apt-get install
mesa-vulkan-drivers).
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("recording", type=Path, metavar="FILE.rrd", help="Rerun recording")
    add("picture", type=output_file(".png"), metavar="OUT.png", help="picture to write")
    add(
        "--time",
        type=float,
        metavar="T",
        help="time to show, simulated s or training steps (default: the end)",
    )


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.rerun.screenshot import take_screenshot

    take_screenshot(arguments.recording, arguments.picture, time=arguments.time)
    finish({"Picture": arguments.picture})
    return 0

"""Takes a picture of a Rerun recording (.rrd), without a screen."""

from collections.abc import Sequence
from pathlib import Path

from geort_drake.cli.console import console, run_main
from geort_drake.cli.options import make_parser

EPILOG = """\
On a machine without a graphics card, Rerun's viewer draws with Mesa's software driver (Debian and Ubuntu:
apt-get install mesa-vulkan-drivers).
"""


def main(argv: Sequence[str] | None = None) -> int | None:
    parser = make_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("recording", type=Path, metavar="FILE.rrd", help="the recording")
    add("picture", type=Path, metavar="OUT.png", help="the picture to write")
    add(
        "--time",
        type=float,
        metavar="T",
        help="what to show: simulated s, or training steps (default: the end)",
    )
    add("--width", type=int, default=1440, metavar="PX", help="of the window")
    add("--height", type=int, default=900, metavar="PX", help="of the window")
    arguments = parser.parse_args(argv)

    from geort_drake.rerun.screenshot import take_screenshot

    size = (arguments.width, arguments.height)
    take_screenshot(arguments.recording, arguments.picture, time=arguments.time, size=size)
    console.print(f"Picture: {arguments.picture}", markup=False, soft_wrap=True)
    return None


if __name__ == "__main__":
    run_main(main)

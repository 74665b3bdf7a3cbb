"""Plays a recording as a glove does: one message a frame, at the recording's own pace.

ADDRESS is pub+tcp://127.0.0.1:5556 (ZeroMQ, for teleoperate.py --glove sub+tcp://127.0.0.1:5556),
push+tcp://127.0.0.1:8000 (for pull+tcp://…), lcm, or lcm+URL. Ctrl-C stops it.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from geort_drake.cli.console import console, run_main, warn
from geort_drake.cli.options import make_parser
from geort_drake.people.recording import SIDES


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("recording", type=Path, help="a recording in any format that is read")
    add("--to", default="pub+tcp://127.0.0.1:5556", metavar="ADDRESS", help="where the messages go")
    add("--side", default="right", choices=SIDES, help="side of the recorded hand")
    add("--loop", action="store_true", help="begin again at the end")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.live.playback import play
    from geort_drake.live.real_time import stopping
    from geort_drake.live.transports import is_local, open_sender
    from geort_drake.people.readers import read_recording

    recording = read_recording(arguments.recording, arguments.side)
    sender = open_sender(arguments.to)
    if not is_local(arguments.to):
        warn(f"{arguments.to} is open to the network")
    console.print(f"{len(recording)} frames of a {recording.side} hand to {arguments.to}; Ctrl-C stops")
    sent = 0
    try:
        with stopping() as stop:
            while True:
                sent += play(recording, sender.send, stop, time.monotonic)
                if stop.is_set() or not arguments.loop:
                    break
    finally:
        sender.close()
    console.print(f"{sent} messages sent")
    return 0


if __name__ == "__main__":
    run_main(main)

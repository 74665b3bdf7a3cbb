"""Send a recording as glove messages, one per frame.

ADDRESS is pub+tcp://127.0.0.1:5556 (ZeroMQ, for `geort-drake live --glove sub+tcp://127.0.0.1:5556`) or
push+tcp://127.0.0.1:8000 (for pull+tcp://…). Ctrl-C stops it.
"""

import argparse
from pathlib import Path

from geort_drake.cli.options import CommandParser


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("recording", type=Path, help="a recording in any known format")
    add("--to", default="pub+tcp://127.0.0.1:5556", metavar="ADDRESS", help="address to send to")
    parser.add_side("right")
    add("--loop", action="store_true", help="repeat the recording")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import read_recording
    from geort_drake.console import say, warn
    from geort_drake.live.session import play, stopping
    from geort_drake.live.transports import is_local, open_sender

    recording = read_recording(arguments.recording, arguments.side)
    sender = open_sender(arguments.to)
    if not is_local(arguments.to):
        warn(f"{arguments.to} is open to the network")
    say(f"{len(recording)} frames of a {recording.side} hand to {arguments.to}; Ctrl-C stops")
    sent = 0
    try:
        with stopping() as stop:
            while True:
                sent += play(recording, sender.send, stop)
                if stop.is_set() or not arguments.loop:
                    break
    finally:
        sender.close()
    say(f"{sent} messages sent")
    return 0

"""Show in Rerun how retargeting methods map a recorded hand, side by side.

geort-drake explore --recording alex.npy --methods geort_coupled geort --output explore.rrd
rerun explore.rrd
"""

import argparse
from pathlib import Path

from geort_drake.cli.options import (
    CommandParser,
    finish,
    finite,
    method_help,
    output_file,
    recording_of,
    view,
)
from geort_drake.errors import UsageError

EPILOG = f"""\
{method_help()}
The result shows the recorded hand and, beside it, the robot hand under each method, the loss of each posture,
pinches that close or do not, and collisions.

A method that learns is trained on the whole recording, unless its checkpoint is in the user's cache. A method
may also be the directory of a checkpoint.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("--recording", type=Path, metavar="FILE", help="of a hand (default: synthetic play)")
    methods = "of those below, or directories of checkpoints"
    default = ["geort_coupled", "vector_online"]
    add("--methods", nargs="+", metavar="NAME", default=default, help=methods)
    add("--output", type=output_file(".rrd"), required=True, metavar="FILE.rrd", help="recording to write")
    parser.add_hand()
    add("--start", type=float, metavar="S", help="where to begin, s (default: where most pinches are)")
    add("--duration", type=finite, default=20.0, metavar="S", help="how long, s, from 0.1 to 600")
    parser.add_seed("training and synthetic play")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, load_hand, load_retargeter
    from geort_drake.cli.retargeters import retargeter_of
    from geort_drake.comparison.comparison import check_methods
    from geort_drake.comparison.exploration import answers, excerpt
    from geort_drake.comparison.explorer_recording import write_exploration
    from geort_drake.console import track

    if not 0.1 <= arguments.duration <= 600:
        raise UsageError(f"--duration must be from 0.1 to 600, not {arguments.duration:g}")
    check_methods(arguments.methods)
    description = load_hand(arguments.hand)
    hand = HandModel(description)
    check_methods(arguments.methods, hand)
    recording = recording_of(arguments.recording, description.side, arguments.seed)
    hands = excerpt(recording, duration_s=arguments.duration, start_s=arguments.start)
    retargeters = {
        method: load_retargeter(method, hand)
        if Path(method).is_dir()
        else retargeter_of(method, arguments.hand, recording, arguments.seed)[0]
        for method in arguments.methods
    }
    methods = {
        Path(method).name: answers(retargeters[method], hand, hands)
        for method in track("retargeting", retargeters, len(retargeters))
    }
    properties = {
        "hand": description.name,
        "methods": ", ".join(methods),
        "recording": arguments.recording.name if arguments.recording else "synthetic play",
        "recording_sha256": recording.digest,
        "start_s": hands.start,
        "seed": arguments.seed,
    }
    write_exploration(arguments.output, hand, hands, methods, properties)
    finish({"Recording": arguments.output}, view(arguments.output))
    return 0

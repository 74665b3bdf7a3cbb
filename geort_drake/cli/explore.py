"""Show retargeting methods side by side on a recorded hand, in Rerun.

geort-drake explore --recording alex.npy --methods universal geort --output explore.rrd
rerun explore.rrd
"""

import argparse
from pathlib import Path

from geort_drake.cli.options import CommandParser, finish, finite, output_file, view
from geort_drake.errors import UsageError

EPILOG = """\
{methods}
The recording shows the human hand, the robot hand with each method, the losses over time, closed and missed
pinches, and collisions. Methods that need training are trained on the whole recording and cached. The
universal map is measured from the recording's first second.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("--recording", type=Path, metavar="FILE", help="recording of a hand (default: synthetic play)")
    methods = "methods listed below, maps or Python files"
    default = ["universal", "anyteleop"]
    add("--methods", nargs="+", metavar="NAME", default=default, help=methods)
    output = "Rerun recording to write"
    add("--output", type=output_file(".rrd"), required=True, metavar="FILE.rrd", help=output)
    parser.add_hand()
    add("--start", type=float, metavar="S", help="start time, s (default: the part with the most pinches)")
    add("--duration", type=finite, default=20.0, metavar="S", help="duration, s, from 0.1 to 600")
    parser.add_seed("training and synthetic play")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, load_hand
    from geort_drake.console import track
    from geort_drake.methods import names_of, resolve
    from geort_drake.metrics.exploration import excerpt, response
    from geort_drake.metrics.explorer_recording import write_exploration
    from geort_drake.metrics.metrics import adapted
    from geort_drake.retargeting.train import training_recording

    if not 0.1 <= arguments.duration <= 600:
        raise UsageError(f"--duration must be from 0.1 to 600, not {arguments.duration:g}")
    description = load_hand(arguments.hand)
    hand = HandModel(description)
    names = names_of(arguments.methods, hand=hand)
    recording = training_recording(arguments.recording, description.side, arguments.seed)
    hands = excerpt(recording, duration_s=arguments.duration, start_s=arguments.start)
    methods = {}
    for name, method in track("retargeting", names.items(), len(names), lambda item: item[0]):
        retarget, _ = resolve(method, hand, recording, arguments.seed)
        methods[name] = response(adapted(retarget, recording), hand, hands)
    properties = {
        "hand": description.name,
        "methods": ", ".join(methods),
        "recording": arguments.recording.name if arguments.recording else "synthetic play",
        "recording_sha256": recording.digest,
        "start_s": hands.metadata["start_s"],
        "seed": arguments.seed,
    }
    write_exploration(arguments.output, hand, hands, methods, properties)
    finish({"Recording": arguments.output}, view(arguments.output))
    return 0

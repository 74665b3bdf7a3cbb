"""Shows what retargeting methods make of a recorded hand, side by side, in the Rerun viewer.

python scripts/explore_retargeting.py --recording alex.npy --methods geort_coupled geort --output e.rrd
rerun e.rrd
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from geort_drake.cli.console import console, progress_bar, run_main
from geort_drake.cli.options import at_least, check_outputs, command, make_parser, method_help
from geort_drake.comparison.comparison import check_methods
from geort_drake.hands.description import hand_names, load_hand

EPILOG = f"""\
{method_help()}
The recording shows the recorded hand, and beside it the robot hand as each method moves it, the price of
each answer, pinches that close or do not, and collisions; docs/rerun.md explains the picture.

A method that is trained is trained on the whole recording, unless that was done before: the checkpoint is
kept in the user's cache directory. A method may also be the directory of a checkpoint.
"""


def main(argv: Sequence[str] | None = None) -> int:
    parser = make_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("--recording", type=Path, metavar="FILE", help="of a hand (default: synthetic play)")
    add(
        "--methods",
        nargs="+",
        metavar="NAME",
        default=["geort_coupled", "vector_online"],
        help="of those below, or directories of checkpoints",
    )
    add("--output", type=Path, required=True, metavar="FILE.rrd", help="the recording to write")
    add(
        "--hand",
        default="allegro_right",
        help=f"name or file of a hand description; names: {', '.join(hand_names())}",
    )
    add("--start", type=float, metavar="S", help="where to begin, s (default: where most pinches are)")
    add("--duration", type=float, default=20.0, metavar="S", help="how long, s")
    add("--seed", type=at_least(0), default=0, help="of training and of synthetic play")
    arguments = parser.parse_args(argv)
    if not 0.1 <= arguments.duration <= 600:
        parser.error(f"--duration must be from 0.1 to 600, not {arguments.duration:g}")
    check_outputs(parser, (arguments.output, ".rrd"))
    check_methods(arguments.methods)

    from geort_drake.comparison.exploration import answers, excerpt
    from geort_drake.hands.model import HandModel
    from geort_drake.people.play import synthesize_play
    from geort_drake.people.readers import read_recording
    from geort_drake.rerun.explorer import write_exploration

    description = load_hand(arguments.hand)
    hand = HandModel(description)
    check_methods(arguments.methods, hand)
    if arguments.recording is None:
        recording = synthesize_play(arguments.seed, side=description.side)
    else:
        recording = read_recording(arguments.recording, description.side, training=True)
    hands = excerpt(recording, duration_s=arguments.duration, start_s=arguments.start)
    methods = {}
    retargeters = {method: _retargeter(method, arguments, hand, recording) for method in arguments.methods}
    with progress_bar() as progress:
        task = progress.add_task("answers", total=len(retargeters), note="")
        for method, retarget in retargeters.items():
            progress.update(task, note=method)
            methods[Path(method).name] = answers(retarget, hand, hands)
            progress.update(task, advance=1, note="")
    properties = {
        "hand": description.name,
        "methods": ", ".join(methods),
        "recording": arguments.recording.name if arguments.recording else "synthetic play",
        "recording_sha256": recording.digest,
        "start_s": hands.start,
        "seed": arguments.seed,
    }
    write_exploration(arguments.output, hand, hands, methods, properties)
    console.print(f"Recording: {arguments.output}", markup=False, soft_wrap=True)
    console.print(f"Watch it: {command('rerun', arguments.output)}", markup=False, soft_wrap=True)
    return 0


def _retargeter(method: str, arguments: argparse.Namespace, hand, recording) -> Callable:
    from geort_drake.comparison.train import METHODS, cached_checkpoint
    from geort_drake.hands.canonical import canonical_kinematics
    from geort_drake.retargeting.methods.registry import BASELINES, make_baseline
    from geort_drake.retargeting.retargeter import load_retargeter

    if method in BASELINES:
        keypoints = hand.description.human_keypoints
        frames = recording.fingertips(keypoints)
        return make_baseline(
            method, canonical_kinematics(hand), keypoints, frames=frames, seed=arguments.seed
        )
    if method in METHODS:
        return load_retargeter(cached_checkpoint(arguments.hand, recording, method, arguments.seed)[0], hand)
    return load_retargeter(method, hand)


if __name__ == "__main__":
    run_main(main)

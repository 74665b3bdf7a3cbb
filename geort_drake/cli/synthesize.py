"""Make a synthetic recording of hand motion."""

import argparse
from pathlib import Path

from geort_drake.cli.options import CommandParser, command, finish, finite, output_file
from geort_drake.errors import UsageError

_MOST_FRAMES = 5_000_000  # half a day at 120 Hz, and two gigabytes while they are made


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("output", type=output_file(".npz"), help="recording to write (.npz)")
    parser.add_seed("the motions")
    add("--duration", type=finite, default=300.0, help="duration, s")
    add("--rate", type=finite, default=120.0, help="frames per second")
    add("--hand-of", type=Path, help="recording of the hand to imitate (default: an average adult's hand)")
    parser.add_side("right")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import read_recording, synthesize_play
    from geort_drake.console import warn
    from geort_drake.people.checks import check_recording
    from geort_drake.people.human_hand import HumanHand

    if arguments.duration * arguments.rate > _MOST_FRAMES:
        raise UsageError(f"--duration times --rate may be at most {_MOST_FRAMES:,} frames")
    hand = None
    if arguments.hand_of is not None:
        hand = HumanHand.fit(read_recording(arguments.hand_of, arguments.side))
    recording = check_recording(
        synthesize_play(arguments.seed, arguments.duration, arguments.rate, hand), str(arguments.output)
    )
    recording.save(arguments.output)
    for warning in recording.metadata["warnings"]:
        warn(warning)
    size = f"{len(recording)} frames at {recording.rate_hz:g} Hz"
    finish({"Recording": f"{arguments.output} ({size})"}, command("grasp", "--recording", arguments.output))
    return 0

"""Make synthetic recordings of hand motion.

By default, the command makes one recording of an average adult's hand. With --people, it makes one recording
for each of several people with different hands, habits and devices.
"""

import argparse
from pathlib import Path

from geort_drake.cli.options import (
    CommandParser,
    at_least,
    command,
    finish,
    finite,
    output_file,
    output_folder,
)
from geort_drake.errors import RecordingError, UsageError

_MAX_FRAMES = 5_000_000  # half a day at 120 Hz; needs two gigabytes of memory
_RATE_HZ = 120.0


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("output", help="recording to write (.npz), or with --people a folder for recordings")
    parser.add_seed("the motions, and of the people")
    add("--duration", type=finite, default=300.0, help="duration, s")
    add("--rate", type=finite, help=f"frames per second (default: {_RATE_HZ:g}; with --people, the device's)")
    add("--people", type=at_least(1), metavar="N", help="draw the first N people of the seed's population")
    add("--hand-of", type=Path, help="recording of the hand to imitate (default: an average adult's hand)")
    parser.add_side("right")


def run(arguments: argparse.Namespace) -> int:
    if arguments.duration * (arguments.rate or _RATE_HZ) > _MAX_FRAMES:
        raise UsageError(f"--duration times --rate may be at most {_MAX_FRAMES:,} frames")
    if arguments.people is None:
        return _average(arguments)
    if arguments.hand_of is not None:
        raise UsageError("--hand-of cannot be used with --people, who have their own hands")
    return _people(arguments)


def _average(arguments: argparse.Namespace) -> int:
    from geort_drake import read_recording, synthesize_play
    from geort_drake.console import warn
    from geort_drake.people.checks import examine
    from geort_drake.people.synthetic.hand import HumanHand

    output, hand = output_file(".npz")(arguments.output), None
    if arguments.hand_of is not None:
        person = read_recording(arguments.hand_of, arguments.side)
        try:
            hand = HumanHand.fit(person)
        except RecordingError as error:
            raise RecordingError(f"{arguments.hand_of}: {error}") from error
    rate = arguments.rate or _RATE_HZ
    recording = examine(synthesize_play(arguments.seed, arguments.duration, rate, hand, side=arguments.side))
    recording.save(output)
    for sentence in recording.metadata["warnings"]:
        warn(sentence)
    size = f"{len(recording)} frames at {recording.rate_hz:g} Hz"
    finish({"Recording": f"{output} ({size})"}, command("grasp", "--recording", output))
    return 0


def _people(arguments: argparse.Namespace) -> int:
    from geort_drake.console import warn
    from geort_drake.people.synthetic.population import sample_person

    folder = output_folder(arguments.output)
    paths = [folder / f"person_{number:03d}.npz" for number in range(arguments.people)]
    for number, path in enumerate(paths):
        person = sample_person(arguments.seed, number)
        person.record(arguments.duration, arguments.rate, arguments.side).save(path)
    if others := sorted({*folder.glob("person_*.npz")} - {*paths}):
        warn(f"{folder}: also contains people of another run, such as {others[0].name}")
    results = {"Recordings": f"{folder} (people: {arguments.people})"}
    finish(results, command("check-recording", folder / "person_000.npz"))
    return 0

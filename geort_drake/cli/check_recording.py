"""Check a recording of a hand and report its faults.

Exit codes: 0 usable, perhaps with warnings; 2 refused.
"""

import argparse
import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geort_drake.cli.options import SIDES, CommandParser, command, finish, finite, write_json

if TYPE_CHECKING:
    from geort_drake import Recording

EPILOG = "{formats}"
_POLL_PERIOD_S = 1.0


def add_arguments(parser: CommandParser) -> None:
    add_reading_arguments(parser)
    parser.set_defaults(output=None)  # only `convert` has this argument
    parser.add_json("the report")
    add = parser.add_argument
    add(
        "--watch",
        action="store_true",
        help="first show the missing motions while the file is being recorded",
    )


def add_reading_arguments(parser: CommandParser) -> None:
    """Adds the file's argument and the options for reading it."""
    add = parser.add_argument
    add("input", type=Path, help="recording in one of the formats below")
    add("--format", default="auto", metavar="NAME", help="format, one of those below; auto detects it")
    add("--side", choices=SIDES, default="right", help="side of the recorded hand")
    add("--mirror", action="store_true", help="turn it into a recording of the other hand")
    add(
        "--unit",
        choices=["m", "dm", "cm", "mm", "inch"],
        help="unit of lengths in the file (default: the format's)",
    )
    add("--rate", type=finite, metavar="HZ", help="frame rate of a file without timestamps (default: 30)")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.errors import RecordingError
    from geort_drake.people.checks import training_faults
    from geort_drake.people.coverage import figures

    if arguments.watch:
        _watch(arguments)
    name = str(arguments.input)
    try:
        recording = _read(arguments)
    except RecordingError as error:
        result = {"file": name, "verdict": "refused", "fit_for_training": False, "reason": str(error)}
        write_json(arguments.json, result)
        raise
    warnings, unfit = recording.metadata.get("warnings", []), training_faults(recording)
    verdict = "usable with warnings" if warnings or unfit else "usable"
    result = {
        "file": name,
        "verdict": verdict,
        "fit_for_training": not unfit,
        "warnings": [*warnings, *unfit],
    }
    result |= figures(recording)
    _print(result)
    write_json(arguments.json, result)
    written, following = {}, None
    if arguments.output is not None:
        recording.save(arguments.output)
        written["Recording"] = arguments.output
    if result["fit_for_training"]:
        hand = None if recording.side == "right" else "allegro_left"
        following = command("grasp", "--recording", arguments.output or arguments.input, "--hand", hand)
        if arguments.output is None and (options := _options_of_convert(arguments)):
            converted = arguments.input.with_name(f"{arguments.input.stem}_converted.npz")
            following = command("convert", arguments.input, converted, *options)
    finish(written, following)
    return 0


def _options_of_convert(arguments: argparse.Namespace) -> list[str]:
    """Returns the given options that only `convert` shares; empty if other commands read the file alike."""
    given = {"--format": arguments.format, "--unit": arguments.unit, "--rate": arguments.rate}
    words = [
        word for name, value in given.items() if value not in (None, "auto") for word in (name, str(value))
    ]
    words += ["--mirror"] if arguments.mirror else []
    return [*words, "--side", "left"] if words and arguments.side == "left" else words


def _read(arguments: argparse.Namespace) -> "Recording":
    from geort_drake import read_recording

    options = {"format": arguments.format, "unit": arguments.unit, "rate_hz": arguments.rate}
    recording = read_recording(arguments.input, arguments.side, **options)
    return recording.mirrored() if arguments.mirror else recording


def _print(result: dict[str, Any]) -> None:
    from geort_drake.console import print_table, say, warn
    from geort_drake.people.formats import FORMATS

    known_format = FORMATS.get(result["format"])
    kind = known_format.title if known_format else result["format"]
    known = "known" if result["rate_known"] else "assumed"
    origin = f", mirrored from a {result['recorded_side']} one" if result["recorded_side"] else ""
    say(f"{result['file']}: {result['side']} hand{origin}, read as {kind}")
    say(
        f"{result['frames']} frames, {result['valid_frames']} valid, {result['duration_s']:.1f} s at "
        f"{result['rate_hz']:.1f} Hz ({known}); wrist: {result['wrist']}"
    )
    rows = [
        (
            finger,
            " ".join(f"{value:5.1f}" for value in figures["bones_mm"]),
            f"{figures['bones_vary_percent']:.1f} %",
            f"{figures['speed_median_m_s']:.2f} (p95 {figures['speed_p95_m_s']:.2f})",
            "" if figures["pinch_frames"] is None else str(figures["pinch_frames"]),
        )
        for finger, figures in result["fingers"].items()
    ]
    print_table(("finger", "bones from the wrist, mm", "vary by", "speed, m/s", "pinch frames"), rows)
    for sentence in result["warnings"]:
        warn(sentence)
    missing = [motion for motion in result["coverage"] if not motion["enough"]]
    for motion in missing:
        # Rounded down, because 6.9 of 7 degrees are not enough.
        seen = int(motion["seen"])
        say("insufficient: {motion}: {0} {unit}, required {required:.0f}".format(seen, **motion))
    count = len(result["coverage"])
    say(f"coverage: {count - len(missing)} of {count} motions that training needs")
    say(f"verdict: {result['verdict']}" + ("" if result["fit_for_training"] else "; not fit for training"))


def _watch(arguments: argparse.Namespace) -> None:
    """Shows the motions that a growing file lacks until none is missing, or Ctrl-C."""
    seen: int | None = -1  # so that a missing file is reported too
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            stamp = arguments.input.stat().st_mtime_ns if arguments.input.exists() else None
            if stamp != seen and _print_coverage(arguments):
                return
            seen = stamp
            time.sleep(_POLL_PERIOD_S)


def _print_coverage(arguments: argparse.Namespace) -> bool:
    """Prints the motions recorded so far and the missing ones; returns whether none is missing."""
    from geort_drake.console import console, print_table, say
    from geort_drake.errors import RecordingError
    from geort_drake.people.coverage import coverage

    console.clear()
    try:
        recording = _read(arguments)
    except RecordingError as error:
        # A file that is being written may be empty, or end within a frame.
        say(f"waiting: {error}")
        return False
    motions = coverage(recording)
    rows = [
        (
            f"[{'green' if motion.enough else 'red'}]{motion.name}[/]",
            f"{int(motion.seen)} {motion.unit}",
            f"{motion.required:.0f}",
            "" if motion.enough else motion.advice,
        )
        for motion in motions
    ]
    headings = ("motion", "recorded", "required", "what to do")
    print_table(headings, rows, f"{recording.duration_s:.0f} s", text=headings[3:])
    return all(motion.enough for motion in motions)

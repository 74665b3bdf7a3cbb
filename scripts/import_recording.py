"""Reads a recording of a hand in any known format, reports its health, and saves it as our own .npz.

Exit code 0: usable, with or without warnings; 2: refused.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.live import Live
from rich.table import Table

from geort_drake.cli.console import console, run_main, warn
from geort_drake.cli.options import (
    add_json_option,
    check_outputs,
    command,
    make_parser,
    positive,
    write_json,
)
from geort_drake.errors import RecordingError
from geort_drake.people.checks import examine, noted, refuse
from geort_drake.people.checks.anatomy import UNITS_M
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.checks.report import report
from geort_drake.people.coverage import coverage
from geort_drake.people.formats import AUTO, FORMATS
from geort_drake.people.readers import open_recording
from geort_drake.people.recording import SIDES, Recording

_ROBOT_SAMPLES = 4000
_LOOK_EVERY_S = 1.0


def main(argv: Sequence[str] | None = None) -> None:
    arguments = parse_arguments(argv)
    name = str(arguments.input)
    if arguments.watch:
        _watch(arguments)
    recording, findings = None, []
    try:
        recording, findings = open_recording(
            arguments.input, arguments.side, arguments.format, arguments.unit, arguments.rate
        )
        recording, found = examine(recording)
        findings += found
        refuse(name, findings)
        recording = recording.mirrored() if arguments.mirror else recording
    except RecordingError as error:
        # What could not even be read has no finding of a check.
        read = findings or [Finding("file", Severity.ERROR, str(error).removeprefix(f"{name}: "))]
        write_json(arguments.json, report(name, recording, read))
        raise
    result = report(name, recording, findings)
    _print(result, findings)
    write_json(arguments.json, result)
    lines = {}
    if arguments.picture is not None:
        _draw(recording, arguments.hand, arguments.picture)
        lines["Picture"] = str(arguments.picture)
    if arguments.output is not None:
        noted(recording, findings).save(arguments.output)
        lines["Recording"] = str(arguments.output)
    if result["fit_for_training"]:
        # A robot hand of the same side, which other programs read the file as.
        hand = [] if recording.side == "right" else ["--hand", "allegro_left"]
        words = ("--recording", arguments.output or arguments.input, *hand)
        if arguments.output is not None or not arguments.mirror:
            lines["Train on it, and grasp"] = command("simulate_grasp.py", *words)
    for what, line in lines.items():
        console.print(f"{what}: {line}", markup=False, soft_wrap=True)


def _print(result: dict[str, Any], findings: Sequence[Finding]) -> None:
    kind = FORMATS[result["format"]].title if result["format"] in FORMATS else result["format"]
    known = "known" if result["rate_known"] else "assumed"
    origin = f", mirrored from a {result['recorded_side']} one" if result["recorded_side"] else ""
    console.print(
        f"{result['file']}: {result['side']} hand{origin}, taken for {kind}", markup=False, soft_wrap=True
    )
    console.print(
        f"{result['frames']} frames, {result['valid_frames']} valid, {result['duration_s']:.1f} s at "
        f"{result['rate_hz']:.1f} Hz ({known}); wrist: {result['wrist']}"
    )
    table = Table("finger", "bones from the wrist, mm", "vary by", "speed, m/s", "pinch frames", box=None)
    for finger, figures in result["fingers"].items():
        pinches = figures["pinch_frames"]
        table.add_row(
            finger,
            " ".join(f"{value:5.1f}" for value in figures["bones_mm"]),
            f"{figures['bones_vary_percent']:.1f} %",
            f"{figures['speed_median_m_s']:.2f} (p95 {figures['speed_p95_m_s']:.2f})",
            "" if pinches is None else f"{pinches} ({100 * pinches / result['valid_frames']:.0f} %)",
        )
    console.print(table)
    for finding in findings:
        if finding.severity in (Severity.UNFIT, Severity.WARNING):
            warn(str(finding))
        else:
            console.print(f"{finding.severity}: {finding}", markup=False, soft_wrap=True)
    enough = [motion["enough"] for motion in result["coverage"]]
    console.print(f"coverage: {sum(enough)} of {len(enough)} motions that training wants")
    console.print(
        f"verdict: {result['verdict']}" + ("" if result["fit_for_training"] else "; not fit for training")
    )


def _watch(arguments: argparse.Namespace) -> None:
    """Shows what a file that is being recorded lacks, until it lacks nothing or Ctrl-C is pressed."""
    seen = None
    with Live(console=console, auto_refresh=False) as live:
        try:
            while True:
                stamp = arguments.input.stat().st_mtime_ns if arguments.input.exists() else None
                if stamp != seen:
                    seen = stamp
                    table, complete = _coverage_table(arguments)
                    live.update(table, refresh=True)
                    if complete:
                        return
                time.sleep(_LOOK_EVERY_S)
        except KeyboardInterrupt:
            return


def _coverage_table(arguments: argparse.Namespace) -> tuple[Table, bool]:
    """The motions seen so far and what is still to do, and whether nothing is."""
    try:
        recording, _ = open_recording(
            arguments.input, arguments.side, arguments.format, arguments.unit, arguments.rate
        )
        recording, findings = examine(recording)
        refuse(str(arguments.input), findings)
    except RecordingError as error:
        # While it is being written a file may end within a frame, or be empty still.
        table = Table("waiting", box=None)
        table.add_row(str(error))
        return table, False
    table = Table("motion", "seen", "wanted", "what to do", box=None, title=f"{recording.duration_s:.0f} s")
    motions = coverage(recording)
    for motion in motions:
        color = "green" if motion.enough else "red"
        seen = f"{motion.seen:.0f} {motion.unit}" + (
            "" if motion.frames is None else f", {motion.frames} frames"
        )
        table.add_row(
            f"[{color}]{motion.name}[/]", seen, f"{motion.wanted:.0f}", "" if motion.enough else motion.advice
        )
    return table, all(motion.enough for motion in motions)


def _draw(recording: Recording, hand_name: str, path: Path) -> None:
    import numpy as np

    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.people.keypoints import mirrored
    from geort_drake.people.picture import draw_fingertips

    description = load_hand(hand_name)
    hand = HandModel(description)
    shape = (_ROBOT_SAMPLES, len(hand.joint_names))
    p_BF = hand.fingertips(np.random.default_rng(0).uniform(hand.lower, hand.upper, shape))
    # People are canonical right hands, so a left robot hand is drawn in the mirror.
    p_BF = mirrored(p_BF) if description.side == "left" else p_BF
    tips = {finger: p_BF[:, i] for i, finger in enumerate(hand.finger_names)}
    draw_fingertips(recording, tips, description.name, path)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    formats = "\n".join(
        f"  {name:16} {entry.title} ({', '.join(entry.suffixes)})" for name, entry in FORMATS.items()
    )
    parser = make_parser(__doc__, f"formats:\n{formats}")
    parser.add_argument("input", type=Path, help="recording, in one of the formats below")
    parser.add_argument("output", type=Path, nargs="?", help=".npz to write; without it, only the report")
    parser.add_argument(
        "--format", default=AUTO, metavar="NAME", help="one of those below; auto goes by the file's contents"
    )
    parser.add_argument("--side", choices=SIDES, default="right", help="which hand was recorded")
    parser.add_argument(
        "--mirror", action="store_true", help="make it the other hand's: for a robot hand of the other side"
    )
    parser.add_argument(
        "--unit", choices=list(UNITS_M), help="of lengths in the file (default: the format's)"
    )
    parser.add_argument(
        "--rate", type=positive, metavar="HZ", help="of a file without timestamps (default: 30)"
    )
    add_json_option(parser, "the report")
    parser.add_argument(
        "--picture", type=Path, metavar="FILE", help=".png of the fingertips against a robot's"
    )
    parser.add_argument("--hand", default="allegro_right", help="the picture's robot hand")
    parser.add_argument(
        "--watch", action="store_true", help="first show what is still missing, while the file is recorded"
    )
    arguments = parser.parse_args(argv)
    check_outputs(parser, (arguments.output, ".npz"), (arguments.picture, ".png"))
    return arguments


if __name__ == "__main__":
    run_main(main)

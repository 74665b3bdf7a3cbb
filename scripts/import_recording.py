"""Reads a glove recording, checks it, reports its health and saves it as our own .npz."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake.console import console, run_main
from geort_drake.errors import RecordingError
from geort_drake.files import require_writable
from geort_drake.gloves.keypoints import FINGER_NAMES
from geort_drake.gloves.readers import read_recording
from geort_drake.gloves.recording import SIDES, Recording, check_pinches, check_recording
from geort_drake.gloves.summary import summarize


def main(argv: Sequence[str] | None = None) -> None:
    arguments = _arguments(argv)
    recording = read_recording(arguments.input, arguments.side)
    _report(recording, str(arguments.input))
    if arguments.output is not None:
        recording.save(arguments.output)
        console.print(f"saved to {arguments.output}", markup=False)


def _report(recording: Recording, name: str) -> None:
    valid = int(recording.valid.sum())
    rate = "known" if recording.metadata.get("rate_known", True) else "assumed"
    console.print(f"{name}: {recording.side} hand, {recording.metadata.get('format', 'npz')}", markup=False)
    console.print(
        f"{len(recording)} frames, {valid} valid, {recording.duration_s:.1f} s "
        f"at {recording.rate_hz:.1f} Hz ({rate}); wrist pose: {'no' if recording.X_WH is None else 'yes'}"
    )
    summary = summarize(recording)
    pinches = check_pinches(recording, required=False)
    length, spread = 1e3 * summary.bone_length.reshape(5, 4), 100 * summary.bone_spread.reshape(5, 4)
    table = Table("finger", "bones from the wrist, mm", "vary by", "speed, m/s", "pinch frames", box=None)
    for i, finger in enumerate(FINGER_NAMES):
        table.add_row(
            finger,
            " ".join(f"{value:5.1f}" for value in length[i]),
            f"{spread[i].max():.1f} %",
            f"{summary.speed_median[i]:.2f} (p95 {summary.speed_p95[i]:.2f})",
            f"{pinches[finger]} ({100 * pinches[finger] / valid:.0f} %)" if finger in pinches else "",
        )
    console.print(table)
    for warning in recording.metadata["warnings"]:
        console.print(f"warning: {warning}", markup=False)
    try:
        check_recording(recording, "it", training=True)
        console.print("verdict: fit for training")
    except RecordingError as error:
        console.print(f"verdict: fit for replay, not for training: {error}", markup=False)


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "input", type=Path, help="GeoRT .npy (T, 21, 3), raw MANUS .npz (T, 25, 7), or our own .npz"
    )
    parser.add_argument("output", type=Path, nargs="?", help=".npz to write; without it, only the report")
    parser.add_argument("--side", choices=SIDES, default="right", help="which hand was recorded (right)")
    arguments = parser.parse_args(argv)
    if arguments.output is not None:
        if arguments.output.suffix != ".npz":
            parser.error(f"{arguments.output}: the name must end with .npz")
        require_writable(arguments.output)
    return arguments


if __name__ == "__main__":
    run_main(main)

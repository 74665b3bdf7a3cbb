"""Trains a retargeter for a robot hand on a recording of a person's hand, and evaluates it.

python scripts/train_retargeter.py --hand allegro_right --recording alex.npy --output runs/allegro_right
"""

import argparse
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake.console import console, run_main
from geort_drake.errors import TrainingError
from geort_drake.evaluation.pipeline import METHODS, train_checkpoint
from geort_drake.files import require_writable
from geort_drake.gloves.readers import read_recording
from geort_drake.hands.description import hand_names, load_hand
from geort_drake.retargeting.checkpoint import CONFIG, METRICS, PROVENANCE
from geort_drake.retargeting.training import FORWARD_KINEMATICS, TrainingConfig

EPILOG = """\
The output directory holds weights.safetensors, config.json, hand.json, provenance.json, history.csv and
metrics.json; load it with geort_drake.retargeting.retargeter.load_retargeter(DIR).

Recordings: a GeoRT .npy (T, 21, 3), a raw MANUS .npz, or this package's own .npz. The person should move
every finger to its limits and pinch with the thumb; five minutes are plenty.
"""

# Settings without an option of their own, with their defaults.
SETTINGS = {
    field.name: field.default
    for field in dataclasses.fields(TrainingConfig)
    if field.name not in ("fk", "steps")
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.seed < 0:
        parser.error(f"--seed must be 0 or more, not {arguments.seed}")
    if arguments.robot_samples < 1:
        parser.error(f"--robot_samples must be at least 1, not {arguments.robot_samples}")
    require_writable(arguments.output, directory=True)
    settings = _settings(arguments.set)
    if arguments.steps is not None:
        settings["steps"] = arguments.steps
    recording = None
    if arguments.recording is not None:
        # Read here, where a recording can be held to what training needs.
        recording = read_recording(arguments.recording, load_hand(arguments.hand).side, training=True)
    path = train_checkpoint(
        arguments.hand,
        recording,
        arguments.output,
        method=arguments.method,
        seed=arguments.seed,
        device=arguments.device,
        fk=arguments.fk,
        show_progress=not arguments.quiet,
        settings=settings,
        robot_samples=arguments.robot_samples,
    )
    metrics = json.loads((path / METRICS).read_text(encoding="utf-8"))
    if not arguments.quiet:
        console.print(_table(path, metrics))
    if arguments.json:
        print(json.dumps(metrics, indent=2))
    else:
        print(path)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--hand",
        default="allegro_right",
        help=f"name or file of a hand description; names: {', '.join(hand_names())} (default: %(default)s)",
    )
    parser.add_argument(
        "--recording",
        type=Path,
        help="recording of a human hand; without it, five minutes of play are synthesised",
    )
    parser.add_argument(
        "--output", type=Path, required=True, help="checkpoint directory; replaced if it exists"
    )
    parser.add_argument(
        "--method", default="geort", help=f"one of {', '.join(METHODS)} (default: %(default)s)"
    )
    parser.add_argument(
        "--fk",
        default="exact",
        choices=FORWARD_KINEMATICS,
        help="forward kinematics used in training; neural is the paper's (default: %(default)s)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of everything random (default: %(default)s)"
    )
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"), help="(default: %(default)s)")
    parser.add_argument("--steps", type=int, help=f"descent steps (default: {TrainingConfig.steps})")
    parser.add_argument(
        "--robot_samples",
        type=int,
        default=100_000,
        help="joint positions of the robot (default: %(default)s)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another training setting, repeatable; names: " + ", ".join(SETTINGS),
    )
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON on stdout")
    parser.add_argument("--quiet", action="store_true", help="no progress bars and no table")
    return parser


def _settings(assignments: Sequence[str]) -> dict:
    """TrainingConfig fields from NAME=VALUE texts."""
    settings = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals or name not in SETTINGS:
            raise TrainingError(f"--set wants NAME=VALUE, not '{assignment}'; names: {', '.join(SETTINGS)}")
        kind = type(SETTINGS[name])
        try:
            settings[name] = kind(text)
        except ValueError as error:
            raise TrainingError(f"--set {name}: wants {kind.__name__}, not '{text}'") from error
    return settings


def _table(path: Path, metrics: dict) -> Table:
    config = json.loads((path / CONFIG).read_text(encoding="utf-8"))
    timings = json.loads((path / PROVENANCE).read_text(encoding="utf-8"))["timings"]
    spent = timings["robot_data_s"] + timings["fit_s"]
    table = Table(title=f"{config['method']} on {metrics['hand']}, seed {metrics['seed']}, {spent:.0f} s")
    table.add_column("metric")
    table.add_column("value", justify="right")
    pinch, coverage = metrics["pinch"], metrics["coverage"]
    rows = [
        ("motion preservation", _number(metrics["motion_preservation"])),
        ("motion preservation, recorded steps", _number(metrics["motion_preservation_track"])),
        ("C-space coverage at 5 / 10 / 15 mm", " / ".join(_number(v, "{:.2f}") for v in coverage.values())),
        ("flatness", _number(metrics["flatness"])),
        ("gain, 95th over 5th percentile", _number(metrics["gain_p95_p5"], "{:.1f}")),
        ("pinches closed", _number(pinch["closed"], "{:.1%}")),
        ("pinches too deep", _number(pinch["too_deep"], "{:.1%}")),
        ("pinch distance, mean", _number(pinch["mean_mm"], "{:.1f} mm")),
        ("false pinches", _number(pinch["false"], "{:.2%}")),
        ("self-collision over 2 mm", _number(metrics["self_collision"], "{:.1%}")),
        (
            "latency, median / p99",
            " / ".join(_number(v, "{:.0f}") for v in metrics["latency_us"].values()) + " µs",
        ),
    ]
    for row in rows:
        table.add_row(*row)
    if neural := metrics.get("neural_kinematics"):
        errors = (neural["mean_mm"], neural["p95_mm"], neural["max_mm"])
        text = " / ".join(f"{error:.2f}" for error in errors) + " mm"
        table.add_row("neural kinematics' error, mean / p95 / max", text)
    return table


def _number(value: float | None, form: str = "{:.3f}") -> str:
    return "–" if value is None else form.format(value)


if __name__ == "__main__":
    run_main(main)

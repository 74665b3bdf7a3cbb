"""Trains a retargeter for a robot hand on a recording of a person's hand, and evaluates it.

python scripts/train_retargeter.py --hand allegro_right --recording alex.npy --output runs/allegro_right
"""

import argparse
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from geort_drake.cli.console import console, run_main, warn
from geort_drake.cli.options import (
    TRAINED_METHODS,
    add_json_option,
    at_least,
    check_outputs,
    command,
    make_parser,
    method_help,
    write_json,
)
from geort_drake.comparison.train import (
    CONFIGS,
    DEFAULT_METHOD,
    train_checkpoint,
    training_config,
)
from geort_drake.errors import TrainingError
from geort_drake.files import require_writable
from geort_drake.hands.description import hand_names, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.retargeting.checkpoint import METRICS, Checkpoint, load_checkpoint
from geort_drake.retargeting.methods.geort import FORWARD_KINEMATICS, PRESETS
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.settings import parse_settings, settings_of

EPILOG = f"""\
{method_help(TRAINED_METHODS)}
The output directory holds weights.safetensors, config.json, hand.json, provenance.json, history.csv and
metrics.json; load it with geort_drake.retargeting.retargeter.load_retargeter(DIR).

docs/data_formats.md lists the recordings that are read. The person should move every finger to its limits and
pinch with the thumb; five minutes are plenty.

Exit codes: 0 the checkpoint was written; 2 something asked for is unusable, nothing was written; 3 the
checkpoint was written, but the loss stopped being finite on the way and the last good weights were kept.
"""
STOPPED_EARLY = 3
DEFAULT_HAND = "allegro_right"


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    settings = _settings(arguments)
    recording = None
    if arguments.recording is not None:
        # Read here, where a recording can be held to what training needs.
        recording = read_recording(arguments.recording, load_hand(arguments.hand).side, training=True)
    recorder = None
    if arguments.rrd is not None:
        from geort_drake.rerun.training import TrainingRecorder

        description = load_hand(arguments.hand)
        if recording is None:
            recording = synthesize_play(arguments.seed, side=description.side)
        recorder = TrainingRecorder(HandModel(description), recording, arguments.seed)
    with warnings.catch_warnings():
        # They are in the checkpoint, from where they are shown below.
        warnings.simplefilter("ignore", RuntimeWarning)
        path = train_checkpoint(
            arguments.hand,
            recording,
            arguments.output,
            method=arguments.method,
            seed=arguments.seed,
            device=arguments.device,
            show_progress=not arguments.quiet,
            settings=settings,
            robot_samples=arguments.robot_samples,
            report=recorder and recorder.observe,
        )
    checkpoint = load_checkpoint(path)
    metrics = json.loads((path / METRICS).read_text(encoding="utf-8"))
    if recorder is not None:
        properties = {"method": arguments.method, "hand": metrics["hand"], "seed": arguments.seed}
        recorder.write(arguments.rrd, load_retargeter(path), properties)
    console.print(_table(checkpoint, metrics))
    for text in checkpoint.provenance["warnings"]:
        warn(text)
    write_json(arguments.json, metrics)
    _tell_where(arguments, path)
    return 0 if checkpoint.provenance["training"]["stopped_at"] is None else STOPPED_EARLY


def _tell_where(arguments: argparse.Namespace, path: Path) -> None:
    """Where the results are, and what to do with them."""
    recording = [] if arguments.recording is None else ["--recording", arguments.recording]
    hand = [] if arguments.hand == DEFAULT_HAND else ["--hand", arguments.hand]
    lines = {"Checkpoint": path}
    if arguments.rrd is not None:
        lines["Watch it form"] = command("rerun", arguments.rrd)
    lines["Grasp with it"] = command("simulate_grasp.py", "--retargeter", path, *recording, *hand)
    for what, line in lines.items():
        console.print(f"{what}: {line}", markup=False, soft_wrap=True)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__, EPILOG)
    parser.add_argument(
        "--hand",
        default=DEFAULT_HAND,
        help=f"name or file of a hand description; names: {', '.join(hand_names())}",
    )
    parser.add_argument(
        "--recording",
        type=Path,
        help="of a human hand (default: five minutes of synthetic play)",
    )
    parser.add_argument(
        "--output", type=Path, required=True, help="checkpoint directory; replaced if it exists"
    )
    parser.add_argument(
        "--method", metavar="NAME", default=DEFAULT_METHOD, help="how to train, of those below"
    )
    parser.add_argument(
        "--preset",
        choices=tuple(PRESETS),
        help="settings of geort other than the defaults: public, what the authors' public code does "
        "otherwise than the paper; other options take precedence",
    )
    parser.add_argument(
        "--fk",
        choices=FORWARD_KINEMATICS,
        help="forward kinematics used in training; neural is the paper's (default: exact)",
    )
    parser.add_argument("--seed", type=at_least(0), default=0, help="seed of everything random")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"), help="where to train")
    steps = ", ".join(f"{method} {config.steps}" for method, config in CONFIGS.items())
    parser.add_argument("--steps", type=int, help=f"descent steps (default: {steps})")
    parser.add_argument(
        "--robot_samples",
        type=at_least(1),
        default=100_000,
        help="joint positions of the robot",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another setting of the method, repeatable; "
        + "; ".join(f"{method}: {names}" for method, names in _names_by_method().items()),
    )
    parser.add_argument(
        "--rrd", type=Path, metavar="FILE.rrd", help="also record how the map forms, for the Rerun viewer"
    )
    add_json_option(parser, "the metrics")
    arguments = parser.parse_args(argv)
    require_writable(arguments.output, directory=True)
    check_outputs(parser, (arguments.rrd, ".rrd"))
    return arguments


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Fields of the method's config out of --preset, --set, --steps and --fk, the later ones first."""
    method = arguments.method
    hand = load_hand(arguments.hand)
    config = training_config(method, hand=hand)
    if arguments.preset is not None and method != "geort":
        raise TrainingError(f"--preset {arguments.preset} is a preset of geort, not of {method}")
    settings = dict(PRESETS[arguments.preset]) if arguments.preset else {}
    settings |= parse_settings(arguments.set, config, method)
    settings |= {name: value for name in ("steps", "fk") if (value := getattr(arguments, name)) is not None}
    training_config(method, settings, hand)
    return settings


def _names_by_method() -> dict[str, str]:
    """The settings that --set knows: of geort, and what other methods have besides."""
    common = list(settings_of(CONFIGS["geort"]))
    names = {"geort": ", ".join(common)}
    for method, config in CONFIGS.items():
        more = [name for name in settings_of(config) if name not in common]
        if more:
            names[method] = "also " + ", ".join(more)
    return names


def _table(checkpoint: Checkpoint, metrics: dict) -> Table:
    timings = checkpoint.provenance["timings"]
    spent = timings["robot_data_s"] + timings["fit_s"]
    table = Table(
        title=f"{checkpoint.config['method']} on {metrics['hand']}, seed {metrics['seed']}, {spent:.0f} s"
    )
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

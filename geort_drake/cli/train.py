"""Train a retargeter for a robot hand on a recording of a person's hand.

geort-drake train --hand allegro_right --recording alex.npy --output runs/allegro_right
"""

import argparse
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geort_drake.cli.grasp import try_out
from geort_drake.cli.options import (
    DEFAULT_METHOD,
    CommandParser,
    at_least,
    finish,
    output_folder,
    write_json,
)
from geort_drake.errors import TrainingError

EPILOG = """\
{trained methods}
In the five minutes of a recording, the person should move every finger to its limits and pinch each with the
thumb. The output directory is a checkpoint; geort_drake.load_retargeter(DIR) loads it.

Exit codes: 0 success; 1 the loss became infinite or NaN, and the checkpoint contains the last good weights;
2 the input is invalid, and nothing was written.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_hand()
    add("--recording", type=Path, help="recording of a human hand (default: five minutes of synthetic play)")
    add("--output", type=output_folder, required=True, help="checkpoint directory to write or replace")
    add("--method", metavar="NAME", default=DEFAULT_METHOD, help="method to train, one of those below")
    public = "public: train geort with the settings of the authors' public code; --set takes precedence"
    add("--preset", choices=["public"], help=public)
    kinematics = "forward kinematics in training; neural as in the paper (default: exact)"
    add("--fk", choices=["exact", "neural"], help=kinematics)
    parser.add_seed("robot samples, synthetic play, training and metrics")
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train")
    add("--steps", type=int, help="number of training steps (default: the method's)")
    add("--robot-samples", type=at_least(1), default=100_000, help="number of random robot postures")
    setting = "change a setting of the method; repeatable; an unknown NAME lists all settings"
    add("--set", action="append", default=[], metavar="NAME=VALUE", help=setting)
    parser.add_json("the metrics")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import load_hand, train_checkpoint
    from geort_drake.comparison.train import training_recording
    from geort_drake.console import print_table, warn
    from geort_drake.retargeting.checkpoint import METRICS, load_checkpoint

    description = load_hand(arguments.hand)
    settings = _settings(arguments)
    recording = training_recording(arguments.recording, description.side, arguments.seed)
    with warnings.catch_warnings():
        # The checkpoint stores the warnings, which are shown below.
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
        )
    provenance = load_checkpoint(path).provenance
    metrics = json.loads((path / METRICS).read_text(encoding="utf-8"))
    spent = provenance["timings"]["fit_s"]
    title = f"{arguments.method} on {metrics['hand']}, seed {arguments.seed}, {spent:.0f} s"
    print_table(("metric", "value"), metric_rows(metrics), title)
    for text in provenance["warnings"]:
        warn(text)
    write_json(arguments.json, metrics)
    following = try_out(path, arguments.hand, arguments.recording)
    finish({"Checkpoint": path}, following)
    return 0 if provenance["training"]["stopped_at"] is None else 1


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Returns the method's settings from --preset, --set, --steps and --fk; later ones take precedence."""
    from geort_drake.comparison.train import training_config
    from geort_drake.retargeting.methods.geort import PRESETS
    from geort_drake.settings import parse_settings

    method = arguments.method
    config = training_config(method)
    if arguments.preset is not None and method != "geort":
        raise TrainingError(f"--preset {arguments.preset} is a preset of geort, not of {method}")
    settings = dict(PRESETS[arguments.preset]) if arguments.preset else {}
    settings |= parse_settings(arguments.set, config, method)
    settings |= {name: value for name in ("steps", "fk") if (value := getattr(arguments, name)) is not None}
    return settings


def metric_rows(metrics: dict) -> Iterator[tuple[str, str]]:
    """Yields names of metrics and their values as text."""

    def text(form: str, *values: float | None) -> str:
        return " / ".join("–" if value is None else form.format(value) for value in values)

    pinch = metrics["pinch"]
    yield "motion preservation", text("{:.3f}", metrics["motion_preservation"])
    yield "motion preservation, recorded steps", text("{:.3f}", metrics["motion_preservation_track"])
    yield "C-space coverage at 5 / 10 / 15 mm", text("{:.2f}", *metrics["coverage"].values())
    yield "flatness", text("{:.3f}", metrics["flatness"])
    yield "gain, 95th over 5th percentile", text("{:.1f}", metrics["gain_p95_p5"])
    yield "pinches closed", text("{:.1%}", pinch["closed"])
    yield "pinches too deep", text("{:.1%}", pinch["too_deep"])
    yield "pinch distance, mean", text("{:.1f} mm", pinch["mean_mm"])
    yield "false pinches", text("{:.2%}", pinch["false"])
    yield "self-collision over 2 mm", text("{:.1%}", metrics["self_collision"])
    yield "latency, median / p99", text("{:.0f}", *metrics["latency_us"].values()) + " µs"
    if neural := metrics.get("neural_kinematics"):
        errors = text("{:.2f}", neural["mean_mm"], neural["p95_mm"], neural["max_mm"])
        yield "neural kinematics' error, mean / p95 / max", f"{errors} mm"

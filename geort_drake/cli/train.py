"""Train a retargeter for a robot hand on a recording of a person's hand.

geort-drake train --hand allegro_right --recording alex.npy --output runs/allegro_right
"""

import argparse
import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geort_drake.cli.options import (
    DEFAULT_HAND,
    DEFAULT_METHOD,
    TRAINED_METHODS,
    add_hand_option,
    add_json_option,
    add_seed_option,
    at_least,
    command,
    finish,
    method_help,
    output_file,
    output_folder,
    recording_of,
    view,
    write_json,
)
from geort_drake.errors import TrainingError

if TYPE_CHECKING:
    from rich.table import Table

    from geort_drake.retargeting.checkpoint import Checkpoint

EPILOG = f"""\
{method_help(TRAINED_METHODS)}
The person should move every finger to its limits and pinch with the thumb; five minutes are plenty. The
output directory is a checkpoint, which geort_drake.load_retargeter(DIR) loads.

Exit codes: 0 success; 1 the loss became infinite, and the checkpoint holds the last good weights; 2 the
request cannot be met, and nothing was written.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add_hand_option(parser)
    add("--recording", type=Path, help="of a human hand (default: five minutes of synthetic play)")
    add("--output", type=output_folder, required=True, help="checkpoint directory; replaced if it exists")
    add("--method", metavar="NAME", default=DEFAULT_METHOD, help="method to train, one of those below")
    add(
        "--preset",
        choices=["public"],
        help="public: settings of geort as in the authors' public code; --set takes precedence",
    )
    add(
        "--fk",
        choices=["exact", "neural"],
        help="forward kinematics used in training; neural is the paper's (default: exact)",
    )
    add_seed_option(parser, "robot samples, synthetic play, training and metrics")
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train")
    add("--steps", type=int, help="descent steps (default: the method's)")
    add("--robot-samples", type=at_least(1), default=100_000, help="number of random robot postures")
    add(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another setting of the method, repeatable; an unknown NAME lists them",
    )
    add("--rrd", type=output_file(".rrd"), metavar="FILE.rrd", help="also record the training for Rerun")
    add_json_option(parser, "the metrics")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.comparison.train import train_checkpoint
    from geort_drake.console import console, warn
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.retargeting.checkpoint import METRICS, load_checkpoint
    from geort_drake.retargeting.retargeter import load_retargeter

    description = load_hand(arguments.hand)
    settings = _settings(arguments)
    recording = recording_of(arguments.recording, description.side, arguments.seed)
    recorder = None
    if arguments.rrd is not None:
        from geort_drake.rerun.training import TrainingRecorder

        recorder = TrainingRecorder(HandModel(description), recording, arguments.seed)
    with warnings.catch_warnings():
        # The checkpoint keeps them, and they are shown below.
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
            report=None if recorder is None else recorder.observe,
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
    given = [] if arguments.recording is None else ["--recording", arguments.recording]
    given += [] if arguments.hand == DEFAULT_HAND else ["--hand", arguments.hand]
    watch = [] if arguments.rrd is None else [view(arguments.rrd)]
    finish({"Checkpoint": path}, *watch, command("grasp", "--retargeter", path, *given))
    return 0 if checkpoint.provenance["training"]["stopped_at"] is None else 1


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Settings of the method out of --preset, --set, --steps and --fk; later ones take precedence."""
    from geort_drake.comparison.train import training_config
    from geort_drake.hands.description import load_hand
    from geort_drake.retargeting.methods.geort import PRESETS
    from geort_drake.settings import parse_settings

    method, hand = arguments.method, load_hand(arguments.hand)
    config = training_config(method, hand=hand)
    if arguments.preset is not None and method != "geort":
        raise TrainingError(f"--preset {arguments.preset} is a preset of geort, not of {method}")
    settings = dict(PRESETS[arguments.preset]) if arguments.preset else {}
    settings |= parse_settings(arguments.set, config, method)
    settings |= {name: value for name in ("steps", "fk") if (value := getattr(arguments, name)) is not None}
    training_config(method, settings, hand)
    return settings


def _table(checkpoint: "Checkpoint", metrics: dict) -> "Table":
    from rich.table import Table

    timings = checkpoint.provenance["timings"]
    spent = timings["robot_data_s"] + timings["fit_s"]
    title = f"{checkpoint.config['method']} on {metrics['hand']}, seed {metrics['seed']}, {spent:.0f} s"
    table = Table("metric", title=title)
    table.add_column("value", justify="right")
    pinch, coverage = metrics["pinch"], metrics["coverage"]
    rows = {
        "motion preservation": _text([metrics["motion_preservation"]], "{:.3f}"),
        "motion preservation, recorded steps": _text([metrics["motion_preservation_track"]], "{:.3f}"),
        "C-space coverage at 5 / 10 / 15 mm": _text(coverage.values(), "{:.2f}"),
        "flatness": _text([metrics["flatness"]], "{:.3f}"),
        "gain, 95th over 5th percentile": _text([metrics["gain_p95_p5"]], "{:.1f}"),
        "pinches closed": _text([pinch["closed"]], "{:.1%}"),
        "pinches too deep": _text([pinch["too_deep"]], "{:.1%}"),
        "pinch distance, mean": _text([pinch["mean_mm"]], "{:.1f}", " mm"),
        "false pinches": _text([pinch["false"]], "{:.2%}"),
        "self-collision over 2 mm": _text([metrics["self_collision"]], "{:.1%}"),
        "latency, median / p99": _text(metrics["latency_us"].values(), "{:.0f}", " µs"),
    }
    if neural := metrics.get("neural_kinematics"):
        errors = (neural["mean_mm"], neural["p95_mm"], neural["max_mm"])
        rows["neural kinematics' error, mean / p95 / max"] = _text(errors, "{:.2f}", " mm")
    for row in rows.items():
        table.add_row(*row)
    return table


def _text(values: Any, form: str, unit: str = "") -> str:
    return " / ".join("–" if value is None else form.format(value) for value in values) + unit

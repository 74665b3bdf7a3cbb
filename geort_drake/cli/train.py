"""Train a map for a robot hand on a recording of a person's hand.

geort-drake train --hand allegro_right --recording alex.npy --output runs/alex.safetensors
"""

import argparse
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geort_drake.cli.grasp import try_out
from geort_drake.cli.options import DEFAULT_METHOD, CommandParser, finish, output_file, write_json

EPILOG = """\
{trained methods}
In the five minutes of a recording, the person should move every finger to its limits and pinch each with the
thumb. geort_drake.load_retargeter(FILE) loads the map.

Exit codes: 0 success; 2 the input is invalid or the loss is not finite, and nothing was written.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_hand()
    add("--recording", type=Path, help="recording of a human hand (default: five minutes of synthetic play)")
    add("--output", type=output_file(".safetensors"), required=True, metavar="FILE", help="map to write")
    add("--method", metavar="NAME", default=DEFAULT_METHOD, help="method to train, one of those below")
    kinematics = "forward kinematics in the training of geort (default: neural, as in the paper)"
    add("--fk", choices=["neural", "exact"], help=kinematics)
    parser.add_seed("robot samples, synthetic play, training and metrics")
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train")
    add("--steps", type=int, help="number of training steps (default: the method's)")
    setting = "change a setting of the method; repeatable; an unknown NAME lists all settings"
    add("--set", action="append", default=[], metavar="NAME=VALUE", help=setting)
    parser.add_json("the metrics")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, evaluate, load_hand, train_map
    from geort_drake.console import print_table, progress_bar, warn
    from geort_drake.retargeting.train import training_recording

    hand, settings = HandModel(load_hand(arguments.hand)), _settings(arguments)
    recording = training_recording(arguments.recording, hand.description.side, arguments.seed)
    started = time.perf_counter()
    with warnings.catch_warnings():
        # The map stores the warnings, which are shown below.
        warnings.simplefilter("ignore", RuntimeWarning)
        retargeter = train_map(
            hand,
            recording,
            arguments.method,
            arguments.seed,
            arguments.device,
            settings,
            show_progress=not arguments.quiet,
        )
    spent = time.perf_counter() - started
    with progress_bar(not arguments.quiet) as bars, bars.spinner("evaluation"):
        metrics = evaluate(retargeter, hand, recording, arguments.seed)
    metrics = {
        "hand": hand.description.name,
        "recording_sha256": recording.digest,
        "seed": arguments.seed,
        **metrics,
    }
    retargeter.info["metrics"] = metrics
    retargeter.save(arguments.output)
    title = f"{arguments.method} on {metrics['hand']}, seed {arguments.seed}, {spent:.0f} s"
    print_table(("metric", "value"), metric_rows(metrics), title)
    for text in retargeter.info["provenance"]["warnings"]:
        warn(text)
    write_json(arguments.json, metrics)
    finish({"Map": arguments.output}, try_out(arguments.output, arguments.hand, arguments.recording))
    return 0


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Returns the method's settings from --set, --steps and --fk; later ones take precedence."""
    from geort_drake.retargeting.train import training_config
    from geort_drake.settings import parse_settings

    config = training_config(arguments.method)
    settings = parse_settings(arguments.set, config, arguments.method)
    settings |= {name: value for name in ("steps", "fk") if (value := getattr(arguments, name)) is not None}
    training_config(arguments.method, settings)  # refuses values before the recording is read
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

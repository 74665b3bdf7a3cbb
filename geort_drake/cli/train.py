"""Train a map for a robot hand, on a recording of a person's hand or on synthetic people.

geort-drake train --hand allegro_right --recording alex.npy --output runs/alex.safetensors
geort-drake train --hand my_hand.yaml --universal --output my_hand.safetensors
"""

import argparse
import dataclasses
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geort_drake.cli.options import DEFAULT_METHOD, CommandParser, finish, output_file, write_json
from geort_drake.cli.simulate import try_out

if TYPE_CHECKING:
    from geort_drake.hands.hand import Hand as HandModel
    from geort_drake.retargeting.universal.person import UniversalRetargeter

EPILOG = """\
{trained methods}
In the five minutes of a recording, the person should move every finger to its limits and pinch each with the
thumb. geort_drake.load_retargeter(FILE) loads the map.

--universal trains the map of the method universal, which serves every person, in a quarter of an hour on one
core; the same command resumes it. If a hand of the same name with the other side is known and is the mirror
image, its map is written beside FILE. The same seed gives the same weights bit for bit, with the same package
versions and the same kind of processor.

Exit codes: 0 success; 2 the input is invalid or the loss is not finite, and nothing was written.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_hand()
    add("--recording", type=Path, help="recording of a human hand (default: five minutes of synthetic play)")
    add("--output", type=output_file(".safetensors"), required=True, metavar="FILE", help="map to write")
    add("--method", metavar="NAME", default=DEFAULT_METHOD, help="method to train, one of those below")
    universal = "train a map for every person, on synthetic people, instead of --method"
    add("--universal", action="store_true", help=universal)
    add("--start", type=Path, metavar="MAP", help="universal map of the hand from which --universal starts")
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

    if arguments.universal:
        return _train_universal(arguments)
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


def _train_universal(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, load_hand, load_retargeter
    from geort_drake.console import print_table, progress_bar
    from geort_drake.errors import GeortError
    from geort_drake.hands.collision_shapes import canonical_shapes
    from geort_drake.hands.hand import canonical_kinematics
    from geort_drake.retargeting.universal.losses import UniversalSettings
    from geort_drake.retargeting.universal.person import UniversalRetargeter
    from geort_drake.retargeting.universal.train import mirrored_map, train_universal
    from geort_drake.settings import parse_settings

    if arguments.recording is not None:
        raise GeortError("--universal trains on synthetic people; --recording has no effect with it")
    hand, output = HandModel(load_hand(arguments.hand)), Path(arguments.output)
    changes = parse_settings(arguments.set, UniversalSettings(), "the universal map")
    if arguments.steps is not None:
        changes["steps"] = arguments.steps
    kinematics = canonical_kinematics(hand)
    start = None if arguments.start is None else load_retargeter(arguments.start)
    if not isinstance(start, UniversalRetargeter | None):
        raise GeortError(f"--start: {arguments.start} is no universal map")
    with progress_bar(not arguments.quiet) as bars:
        retargeter = train_universal(
            kinematics,
            canonical_shapes(hand),
            dataclasses.replace(UniversalSettings(), **changes),
            arguments.seed,
            arguments.device,
            bars.losses("training", None),
            output.with_suffix(".state"),
            start,
        )
    written = {"Map": _save_universal(retargeter, hand, output)}
    if (other := _other_side(hand)) is not None:
        converted = mirrored_map(retargeter, kinematics, canonical_kinematics(other))
        if converted is not None:
            path = output.with_name(f"{other.description.name}{output.suffix}")
            written[f"Map for {other.description.name}"] = _save_universal(converted, other, path)
    figures = retargeter.info["figures"]
    rows = [(name.replace("_", " "), f"{value:.4f}") for name, value in figures.items()]
    print_table(("figure of the training", "value"), rows, f"{hand.description.name}, seed {arguments.seed}")
    write_json(arguments.json, figures)
    finish(written, try_out(arguments.output, arguments.hand, None))
    return 0


def _save_universal(retargeter: "UniversalRetargeter", hand: "HandModel", path: Path) -> Path:
    from geort_drake.versions import git_state, versions

    retargeter.robot_hands = (hand.description.name,)
    origin = {"hands": {hand.description.name: hand.digest}, "versions": versions(), "git": git_state()}
    retargeter.info = {**retargeter.info, "provenance": {**retargeter.info["provenance"], **origin}}
    retargeter.save(path)
    return path


def _other_side(hand: "HandModel") -> "HandModel | None":
    """Returns the known hand of the same name with the other side; None if there is none."""
    from geort_drake import HandModel
    from geort_drake.errors import UnknownNameError

    side, name = hand.description.side, hand.description.name
    other = {"right": "left", "left": "right"}[side]
    if side not in name:
        return None
    try:
        model = HandModel(name.replace(side, other))
    except UnknownNameError:
        return None
    return model if model.description.side == other else None


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

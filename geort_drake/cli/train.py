"""The command that trains maps."""

import dataclasses
import itertools
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from tyro.conf import UseAppendAction, arg

from geort_drake.cli.base import (
    Command,
    HandName,
    Json,
    OutputFile,
    Seed,
    finish,
    methods_epilog,
    options,
    write_json,
)
from geort_drake.cli.simulate import try_out

if TYPE_CHECKING:
    import numpy as np

    from geort_drake.hands.hand import Hand
    from geort_drake.retargeting.universal.losses import UniversalSettings
    from geort_drake.retargeting.universal.person import UniversalRetargeter


@options
class Train(Command):
    """Train a map for a robot hand, on a recording of a person's hand or on synthetic people.

      geort-drake train --hand allegro_right --recording alex.npy --output runs/alex.safetensors
      geort-drake train --hand my_hand.yaml --universal --output my_hand.safetensors

    A recording should have five minutes in which the person moves every finger to its limits, and pinches
    each with the thumb. In a program, geort_drake.load_retargeter(FILE) loads the map.

    --universal trains a universal map, which serves every person, in a quarter of an hour on one core. If the
    training is interrupted, the same command resumes it. A first training is followed by a second one, which
    refines the map. If the hand of the other side is known by name and is the mirror image, its map is
    written beside FILE. The same seed gives the same weights bit for bit, with the same package versions and
    the same kind of processor.

    Exit codes: 0 success; 2 the input is invalid or the loss is not finite, and nothing was written.
    """

    output: Annotated[Path, arg(metavar="FILE"), OutputFile(".safetensors")]
    """map to write (.safetensors)"""
    hand: HandName = "allegro_right"
    recording: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of a human hand (default: five minutes of synthetic play)"""
    method: Annotated[str, arg(metavar="NAME")] = "geort"
    """method to train, one of those above"""
    universal: bool = False
    """train a map for every person, on synthetic people, instead of --method"""
    start: Annotated[Path | None, arg(metavar="MAP")] = None
    """universal map of the hand from which --universal starts"""
    seed: Seed = 0
    """seed of robot samples, synthetic play, training and metrics"""
    device: Literal["cpu", "cuda"] = "cpu"
    """where to train"""
    set: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="NAME=VALUE")]] = ()
    """change a setting of the method; repeatable; an unknown NAME lists all settings"""
    json: Json = None

    @staticmethod
    def epilog() -> str:
        return methods_epilog(trained_only=True)

    def run(self) -> int:
        from geort_drake import Hand, evaluate, train_map
        from geort_drake.console import console, print_table, warn
        from geort_drake.retargeting.train import training_recording

        if self.universal:
            return self._train_universal()
        hand, settings = Hand(self.hand), self._settings()
        recording = training_recording(self.recording, hand.description.side, self.seed)
        start = time.perf_counter()
        with warnings.catch_warnings():
            # The map stores the warnings, which are shown below.
            warnings.simplefilter("ignore", RuntimeWarning)
            retargeter = train_map(hand, recording, self.method, self.seed, self.device, settings)
        duration = time.perf_counter() - start
        with console.status("evaluation"):
            metrics = evaluate(retargeter, hand, recording, self.seed)
        metrics = {
            "hand": hand.description.name,
            "recording_sha256": recording.digest,
            "seed": self.seed,
            **metrics,
        }
        retargeter.info["metrics"] = metrics
        retargeter.save(self.output)
        title = f"{self.method} on {metrics['hand']}, seed {self.seed}, {duration:.0f} s"
        print_table(("metric", "value"), _rows(metrics), title)
        for text in retargeter.info["provenance"]["warnings"]:
            warn(text)
        write_json(self.json, metrics)
        finish({"Map": self.output}, try_out(self.output, self.hand, self.recording))
        return 0

    def _train_universal(self) -> int:
        from geort_drake import Hand, load_retargeter
        from geort_drake.console import console, print_table
        from geort_drake.errors import GeortError
        from geort_drake.people.synthetic.population import sample_population
        from geort_drake.retargeting.base import thumb_and_others
        from geort_drake.retargeting.universal.losses import UniversalSettings
        from geort_drake.retargeting.universal.person import UniversalRetargeter
        from geort_drake.settings import parse_settings

        if self.recording is not None:
            raise GeortError("--universal trains on synthetic people; --recording has no effect with it")
        changes = parse_settings(self.set, UniversalSettings(), "the universal map")
        settings = dataclasses.replace(UniversalSettings(), **changes)
        settings.validate()
        hand = Hand(self.hand)
        thumb_and_others(hand.finger_names)  # raises HandError
        start = None if self.start is None else load_retargeter(self.start, hand)
        if not isinstance(start, UniversalRetargeter | None):
            raise GeortError(f"--start: {self.start} is no universal map")
        with console.status("synthetic people"):
            p_HK = sample_population(settings.people, self.seed, settings.play_s)
        figures, outputs = self._train_map(hand, settings, p_HK, start)
        rows = [(figure.replace("_", " "), f"{value:.4f}") for figure, value in figures.items()]
        print_table(("figure of the training", "value"), rows, f"{self.hand}, seed {self.seed}")
        write_json(self.json, figures)
        finish(outputs, try_out(self.output, self.hand, None))
        return 0

    def _train_map(
        self,
        hand: "Hand",
        settings: "UniversalSettings",
        p_HK: "np.ndarray",
        start: "UniversalRetargeter | None",
    ) -> tuple[dict[str, float], dict[str, Path]]:
        """Trains the hand's map; returns the training's figures, and the files with what they contain.

        A map that starts from none is trained twice, see `UniversalSettings.refined`.
        """
        from geort_drake import load_retargeter
        from geort_drake.console import progress_bar
        from geort_drake.hands.collision import collision_shapes
        from geort_drake.retargeting.base import kinematics_of
        from geort_drake.retargeting.universal.train import train_universal

        output = self.output
        kinematics, shapes = kinematics_of(hand), collision_shapes(hand)

        def train(
            settings: "UniversalSettings", start: Any, stage: str, state: Path
        ) -> "UniversalRetargeter":
            with progress_bar() as bars:
                report = bars.losses(f"{hand.description.name}, {stage}")
                return train_universal(
                    kinematics, shapes, settings, p_HK, self.seed, self.device, report, state, start
                )

        first = output.with_suffix(".first")
        if start is None:
            if not first.is_file():
                train(settings, None, "training", output.with_suffix(".state")).save(first)
            start, settings = cast("UniversalRetargeter", load_retargeter(first)), settings.refined()
        retargeter = train(settings, start, "refinement", output.with_suffix(".refined.state"))
        retargeter.info = {**retargeter.info, "first_config": start.info.get("config")}
        outputs = {f"Map for {hand.description.name}": _save_universal(retargeter, hand, output)}
        first.unlink(missing_ok=True)
        if (other := _other_side(hand)) is not None:
            mirror_image = retargeter.mirrored(kinematics, kinematics_of(other))
            if mirror_image is not None:
                path = output.with_name(f"{other.description.name}{output.suffix}")
                outputs[f"Map for {other.description.name}"] = _save_universal(mirror_image, other, path)
        return retargeter.info["figures"], outputs

    def _settings(self) -> dict[str, Any]:
        """Returns the method's settings from --set; later ones take precedence."""
        from geort_drake.retargeting.train import training_config
        from geort_drake.settings import parse_settings

        settings = parse_settings(self.set, training_config(self.method), self.method)
        training_config(self.method, settings)  # refuses values before the recording is read
        return settings


def _save_universal(retargeter: "UniversalRetargeter", hand: "Hand", path: Path) -> Path:
    from geort_drake.versions import git_state, versions

    retargeter.robot_hands = (hand.description.name,)
    if order := [joint for joint in hand.description.motor_order if joint in hand.joint_names]:
        retargeter.info = {**retargeter.info, "motor_order": order}
    origin = {"hands": {hand.description.name: hand.digest}, "versions": versions(), "git": git_state()}
    retargeter.info = {**retargeter.info, "provenance": {**retargeter.info["provenance"], **origin}}
    retargeter.save(path)
    return path


def _other_side(hand: "Hand") -> "Hand | None":
    """Returns the known hand of the same name with the other side; None without it or its model."""
    from geort_drake import Hand
    from geort_drake.errors import HandError, UnknownNameError
    from geort_drake.people.recording import OTHER_SIDE

    side, name = hand.description.side, hand.description.name
    other = OTHER_SIDE[side]
    if side not in name:
        return None
    try:
        model = Hand(name.replace(side, other))
    except (UnknownNameError, HandError):
        return None
    return model if model.description.side == other else None


def _rows(metrics: dict) -> Iterator[tuple[str, str]]:
    """Yields names and values of the metrics that `geort-drake evaluate` shows."""
    from geort_drake.metrics.compare import TABLES, flat

    values = dict(flat(metrics))
    for metric, _, form in itertools.chain.from_iterable(TABLES.values()):
        if (value := values.get(metric)) is not None:
            yield metric.translate(str.maketrans("_.", "  ")), form.format(value)

"""Scores a universal map on unseen people, adapted to one second and to thirty seconds of play.

python studies/universal_map.py models/maps/allegro_right.safetensors --people 40 \
    --recordings alex.npy manus.npz

The people follow those of the training in the population. Each code is estimated from the start of a
recording; figures are of the whole recording.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from geort_drake.console import print_table
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.metrics.metrics import evaluate_frames, robot_space
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting.store import load_retargeter

SECONDS = (1.0, 30.0)
COLUMNS = ("MP", "steps", "cov 10", "closed", "deep", "false", "collision", "gain", "cross-talk")
BEST = (max, max, max, max, min, min, min, min, min)


def figures_of(metrics: dict) -> list[float]:
    """Returns the columns of one person; NaN for a figure that does not exist."""
    pinch = metrics["pinch"]
    values = (
        metrics["motion_preservation"],
        metrics["motion_preservation_track"],
        metrics["coverage"]["10mm"],
        *(pinch[name] for name in ("closed", "too_deep", "false")),
        metrics["self_collision"],
        metrics["gain_p95_p5"],
        metrics["cross_talk"],
    )
    return [np.nan if value is None else value for value in values]


def people_of(
    arguments: argparse.Namespace, first: int, seed: int, side: str
) -> Iterator[tuple[str, Recording]]:
    for number in range(first, first + arguments.people):
        person = sample_person(seed, number)
        name = f"person {number}{', camera' if person.device.is_camera else ''}"
        yield name, person.record(arguments.duration, side=side)
    for path in arguments.recordings:
        yield path.stem, read_recording(path, side)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("map", type=Path)
    parser.add_argument("--hand", help="name or file of the robot hand (default: the first of the map)")
    parser.add_argument("--people", type=int, default=12)
    parser.add_argument("--duration", type=float, default=60.0, help="duration of each person's play, s")
    parser.add_argument("--recordings", nargs="*", type=Path, default=[])
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(argv)
    file = load_retargeter(arguments.map)
    hand = HandModel(load_hand(arguments.hand or file.robot_hands[0]))
    retarget, space = load_retargeter(arguments.map, hand), robot_space(hand)
    rows: dict[float, dict[str, list[float]]] = {seconds: {} for seconds in SECONDS}
    training = file.info["config"]
    for name, recording in people_of(arguments, training["people"], training["seed"], hand.description.side):
        p_HK = recording.p_HK[recording.valid].astype(float)
        p_HF = p_HK[:, list(file.human_keypoints)]
        for seconds in SECONDS:
            own = retarget.for_person(p_HK[: max(round(seconds * recording.rate_hz), 1)])
            metrics, _ = evaluate_frames(own, hand, p_HF, recording.rate_hz, 0, space)
            rows[seconds][name] = figures_of(metrics)
    for seconds, people in rows.items():
        drawn = np.array([row for name, row in people.items() if name.startswith("person")])
        shown = dict(people)
        if len(drawn):
            shown["people, mean"] = np.nanmean(drawn, axis=0).tolist()
            seen_by_cameras = [row for name, row in people.items() if name.endswith("camera")]
            if seen_by_cameras:
                shown["cameras, mean"] = np.nanmean(seen_by_cameras, axis=0).tolist()
            worst = [
                (np.nanmin if best is max else np.nanmax)(column)
                for best, column in zip(BEST, drawn.T, strict=True)
            ]
            shown["people, worst"] = worst
        table = [(name, *(f"{value:.3f}" for value in row)) for name, row in shown.items()]
        print_table(("", *COLUMNS), table, f"{arguments.map.stem}, code from {seconds:g} s")
    if arguments.json:
        arguments.json.write_text(json.dumps({f"{s:g}": people for s, people in rows.items()}, indent=2))


if __name__ == "__main__":
    main()

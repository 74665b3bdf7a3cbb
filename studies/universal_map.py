"""Scores universal maps on people whom no training has seen, beside the affine map fitted to each of them.

python studies/universal_map.py models/maps/allegro_right.safetensors --people 8 \
    --recordings alex.npy manus.npz

Universal maps get the first second of a recording, `affine_ik` all of it. Figures are of the whole recording.
With --save, the mean figures of the synthetic people are written into the maps' files, for the docs' table.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from geort_drake.console import print_table
from geort_drake.files import finite_json
from geort_drake.hands.hand import Hand
from geort_drake.metrics.evaluation import adapt, distal_phalanges, evaluate_frames
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting.affine_ik import AffineIK
from geort_drake.retargeting.base import Retargeter, kinematics_of
from geort_drake.retargeting.store import load_retargeter

UNSEEN = 1000  # seed of people who are in no training
COLUMNS = (
    "motion", "steps", "gain by finger", "least over affine", "gain p95/p5", "closed", "too deep", "false",
    "collision", "cross-talk", "posture", "p90", "jitter",
)  # fmt: skip


def figures_of(metrics: dict) -> list[float | list[float]]:
    """Returns the columns of one map for one person; NaN for a figure that does not exist."""
    size, pinch, posture = metrics["size"], metrics["pinch"], metrics["posture"]
    values = [
        metrics["motion_preservation"],
        metrics["motion_preservation_track"],
        list(size["fingers"].values()),
        size["least_over_affine"],
        metrics["gain_p95_p5"],
        *(pinch[name] for name in ("closed", "too_deep", "false")),
        metrics["self_collision"],
        metrics["cross_talk"],
        *(posture[name] for name in ("median", "p90")),
        metrics["jitter"],
    ]
    return [np.nan if value is None else value for value in values]


def people_of(arguments: argparse.Namespace, side: str) -> Iterator[tuple[str, Recording]]:
    for path in arguments.recordings:
        yield path.stem, read_recording(path, side).tracked()
    for number in range(arguments.people):
        yield f"person {number}", sample_person(UNSEEN, number).record(10.0, 30.0, side)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--people", type=int, default=40, help="number of synthetic people, 10 s each")
    parser.add_argument("--affine", action="store_true", help="score affine_ik, which takes minutes, too")
    parser.add_argument("--save", action="store_true", help="write the mean figures into the maps' files")
    parser.add_argument("--recordings", nargs="*", type=Path, default=[])
    arguments = parser.parse_args(argv)
    maps: dict[str, Retargeter] = {str(path): load_retargeter(path) for path in arguments.maps}
    hand = Hand(next(iter(maps.values())).robot_hands[0])
    rows: dict[str, dict[str, list]] = {}
    for person, recording in people_of(arguments, hand.description.side):
        p_HF = recording.fingertips(hand.description.human_keypoints)
        distal = distal_phalanges(recording, hand.description.human_keypoints)
        methods = dict(maps)
        if arguments.affine:
            methods["affine_ik"] = AffineIK(kinematics_of(hand), p_HF)
        for name, retarget in methods.items():
            own = adapt(retarget, recording)
            metrics = evaluate_frames(own, hand, p_HF, recording.rate_hz, distal=distal)
            rows.setdefault(name, {})[person] = figures_of(metrics)
    for name, people in rows.items():
        drawn = [row for person, row in people.items() if person.startswith("person ")]
        shown = {person: row for person, row in people.items() if not person.startswith("person ")}
        if drawn:
            columns = zip(*drawn, strict=True)
            means = shown["synthetic, mean"] = [np.nanmean(column, axis=0) for column in columns]
            if arguments.save and name in maps:
                saved = {
                    title: np.round(value, 4).tolist() for title, value in zip(COLUMNS, means, strict=True)
                }
                maps[name].info = {**maps[name].info, "unseen_people": finite_json(saved)}
                maps[name].save(name)
        table = [(person, *map(_text, row)) for person, row in shown.items()]
        print_table(("person", *COLUMNS), table, name)


def _text(value: float | Sequence[float]) -> str:
    return " ".join(f"{each:.2f}" for each in np.ravel(value)) if np.ndim(value) else f"{value:.3f}"


if __name__ == "__main__":
    main()

"""Compares the universal map, before and after a refit, with a map trained on one person alone.

python studies/refit.py --people 0 1 2 4 --json refit.json

People of a population that no training has seen play for a minute, and for another minute that is scored with
three maps: the universal map, adapted to the first minute; the universal map, refitted to that minute; and a
map trained on that minute alone, in which the person must pinch.
"""

import argparse
import dataclasses
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from geort_drake.comparison.metrics import evaluate_frames, robot_space
from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.comparison.train import cached_checkpoint
from geort_drake.console import print_table
from geort_drake.hands.model import HandModel
from geort_drake.people.population import sample_person
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter

SEED = 9  # of the population, different from that of the map's training
END_S, SCORED_S = 300.0, 60.0  # end of the play to fit to, and duration of the scored play
COLUMNS = {
    "motion preservation": lambda m: f"{m['motion_preservation']:.3f}",
    "along steps": lambda m: f"{m['motion_preservation_track']:.3f}",
    "pinches closed": lambda m: "–" if m["pinch"]["closed"] is None else f"{m['pinch']['closed']:.1%}",
    "coverage": lambda m: f"{m['coverage']['10mm']:.3f}",
    "self-collision": lambda m: f"{m['self_collision']:.1%}",
    "cross-talk": lambda m: f"{m['cross_talk']:.3f}",
}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hand", default="allegro_right")
    parser.add_argument("--map", type=Path, help="universal map (default: the shipped one)")
    parser.add_argument("--people", type=int, nargs="+", default=[0, 1, 2], help="numbers in the population")
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of play to fit to, s")
    parser.add_argument("--rate", type=float, default=30.0, help="frame rate, Hz")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(argv)
    hand = HandModel(arguments.hand)
    universal, space = load_retargeter(arguments.map or arguments.hand, hand), robot_space(hand)
    keypoints = hand.description.human_keypoints
    rows = []
    for number in arguments.people:
        person = sample_person(SEED, number).record(END_S + SCORED_S, arguments.rate, hand.description.side)
        t = person.t - person.t[0]
        parts = (t >= END_S - arguments.seconds) & (t < END_S), t >= END_S
        seen, unseen = (dataclasses.replace(person, valid=person.valid & part) for part in parts)
        maps = {"universal": (universal.for_person(seen.p_HK[seen.valid]), None)}
        with tempfile.TemporaryDirectory() as folder:
            paths = {
                "refit": refit_checkpoint(seen, Path(folder) / "refit", arguments.hand, arguments.map),
                "own training": cached_checkpoint(arguments.hand, seen),
            }
            for name, path in paths.items():
                seconds = load_checkpoint(path).provenance["timings"]["training_s"]
                maps[name] = load_retargeter(path), seconds
        for name, (retarget, seconds) in maps.items():
            frames = unseen.fingertips(keypoints)
            metrics, _ = evaluate_frames(retarget, hand, frames, unseen.rate_hz, 0, space)
            rows.append({"person": number, "map": name, "training_s": seconds, "metrics": metrics})
    table = [
        (f"{row['person']}", row["map"], *(form(row["metrics"]) for form in COLUMNS.values())) for row in rows
    ]
    print_table(("person", "map", *COLUMNS), table, f"after {arguments.seconds:g} s of play")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()

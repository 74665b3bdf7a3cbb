"""Re-fit: how much of a map survives on another person's hand, and how much does a re-fit restore?

python studies/refit.py ben.npz alex.npy --json refit.json

The map trained on each recording is given to every other person. It is fitted to every other block of seven
seconds of that person's recording, and evaluated on the rest: as it is, after the affine step, after both
steps, and compared with the map trained on all of that person's recording. Prints a Markdown table; --json
keeps all metrics. Times are of the re-fit; measure them on an idle machine.
"""

import argparse
import dataclasses
import itertools
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from geort_drake.comparison.metrics import RobotSpace, evaluate_frames, robot_space
from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.comparison.train import cached_checkpoint
from geort_drake.console import console, run_main
from geort_drake.files import write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.methods.coupled import FINE_TUNING_STEPS
from geort_drake.retargeting.retargeter import load_retargeter

BLOCK_S = 7.0
STEPS = {"affine": 0, "re-fit": FINE_TUNING_STEPS}
COLUMNS = {
    "motion preservation": lambda m: f"{m['motion_preservation']:.3f}",
    "along steps": lambda m: f"{m['motion_preservation_track']:.3f}",
    "coverage": lambda m: f"{m['coverage']['10mm']:.2f}",
    "pinches closed": lambda m: f"{m['pinch']['closed']:.1%}",
    "too deep": lambda m: f"{m['pinch']['too_deep']:.1%}",
    "self-collision": lambda m: f"{m['self_collision']:.1%}",
    "cross-talk": lambda m: f"{m['cross_talk']:.3f}",
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="+", type=Path, help="of different people's hands, two or more")
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--seed", type=int, default=0, help="of training and re-fit (default: 0)")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    arguments = parser.parse_args(argv)
    if len(arguments.recordings) < 2:
        parser.error("a map is given to another person: name two recordings or more")
    description = load_hand(arguments.hand)
    hand, seed = HandModel(description), arguments.seed
    people = {path: read_recording(path, description.side, training=True) for path in arguments.recordings}
    own = {}
    for path, recording in people.items():
        console.print(f"training on {path.name}, or finding what was trained", markup=False)
        own[path], _ = cached_checkpoint(arguments.hand, recording, seed=seed)
    space = robot_space(hand, seed)
    headings = ["trained on → used by", "map", *COLUMNS, "time of the fit"]
    console.print(f"| {' | '.join(headings)} |\n|{'---|' * len(headings)}", markup=False, soft_wrap=True)
    rows = []
    for trained_on, used_by in itertools.permutations(people, 2):
        minute, rest = _split(people[used_by])
        with tempfile.TemporaryDirectory() as folder:
            maps = {"as is": own[trained_on]}
            for name, steps in STEPS.items():
                maps[name] = refit_checkpoint(
                    own[trained_on], minute, Path(folder) / name, arguments.hand, steps, seed
                )
            maps["own"] = own[used_by]
            for name, checkpoint in maps.items():
                row = {"trained_on": trained_on.name, "used_by": used_by.name, "map": name}
                if name in STEPS:
                    row["fit_s"] = load_checkpoint(checkpoint).provenance["timings"]["fit_s"]
                row["metrics"] = _figures(checkpoint, hand, rest, seed, space)
                rows.append(row)
                console.print(_line(row), markup=False, highlight=False, soft_wrap=True)
    if arguments.json:
        write_text(arguments.json, json.dumps(rows, indent=2) + "\n")
    return 0


def _split(recording: Recording) -> tuple[Recording, Recording]:
    """Every other block of a recording, and the others."""
    even = (recording.t - recording.t[0]) // BLOCK_S % 2 == 0
    return tuple(dataclasses.replace(recording, valid=recording.valid & some) for some in (even, ~even))


def _figures(checkpoint: Path, hand: HandModel, recording: Recording, seed: int, space: RobotSpace) -> dict:
    frames = recording.fingertips(hand.description.human_keypoints)
    retarget = load_retargeter(checkpoint, hand)
    return evaluate_frames(retarget, hand, frames, recording.rate_hz, seed, space)[0]


def _line(row: dict) -> str:
    """A row of a Markdown table: from, to, map, figures, seconds."""
    figures = [form(row["metrics"]) for form in COLUMNS.values()]
    cells = [f"{row['trained_on']} → {row['used_by']}", row["map"], *figures]
    return "| " + " | ".join([*cells, f"{row['fit_s']:.1f} s" if "fit_s" in row else ""]) + " |"


if __name__ == "__main__":
    run_main(main)

"""Calibrates the simulated person: how well does it grasp through known affine maps?

python studies/calibrate_operator.py --json calibration.json

The person's parameters are chosen by this table alone, without any method under test: maps of known gain,
rotation and offset, objects of each grip, a few seeds. Prints the number of successful grasps; --json saves
every trial.
"""

import argparse
import copy
import datetime
import itertools
import json
import logging
import statistics
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from rich.table import Table
from scipy.spatial.transform import Rotation

from geort_drake.console import console, progress_bar, run_main
from geort_drake.files import write_text

# Name → gain, rotation vector (degrees, in B), offset of all fingertips (m, in B).
MAPS = {
    "gain 0.7": (0.7, (0, 0, 0), (0, 0, 0)),
    "gain 1": (1.0, (0, 0, 0), (0, 0, 0)),
    "gain 1.5": (1.5, (0, 0, 0), (0, 0, 0)),
    "gain 2.2": (2.2, (0, 0, 0), (0, 0, 0)),
    "gain 1.5, 20° about y": (1.5, (0, 20, 0), (0, 0, 0)),
    "gain 1.5, 20° about z": (1.5, (0, 0, 20), (0, 0, 0)),
    "gain 1.5, 15 mm off": (1.5, (0, 0, 0), (0.010, 0.005, -0.010)),
}
# Three for a tripod, two for a pinch, one for the whole hand.
OBJECTS = ("cylinder", "cube", "sphere", "block_tiny", "rod", "bottle")


def trial(map_name: str, object_name: str, seed: int, scenario_text: str | None) -> dict:
    """Simulates a grasp through a map and returns its record."""
    from affine_map import AffineMap

    from geort_drake.hands.description import load_hand
    from geort_drake.hands.hand import Hand
    from geort_drake.people.synthetic.hand import HumanHand
    from geort_drake.people.synthetic.play import synthesize_play
    from geort_drake.simulation.plan.grasp import GraspPlanner
    from geort_drake.simulation.scenario_files import load_scenario
    from geort_drake.simulation.trial import run_trial, seen_fingertips, select_reachable

    # Drake repeats the same warnings in every trial.
    logging.getLogger("drake").setLevel(logging.ERROR)
    scenario = copy.deepcopy(load_scenario(text=scenario_text))
    scenario.object.name, scenario.random_seed = object_name, seed
    description = load_hand(scenario.hand)
    hand = Hand(description)
    play = synthesize_play(seed=0, duration_s=60)
    # Maps the centre of the person's fingertip positions to the centre of the robot's.
    rest = play.fingertips(description.human_keypoints).mean(axis=0)
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (2000, len(hand.lower)))
    shift = hand.fingertips(q).mean(axis=0) - hand.fingertips(hand.default_position)
    gain, turn, offset = MAPS[map_name]
    R = Rotation.from_rotvec(turn, degrees=True).as_matrix()
    retarget = AffineMap(hand, rest, gain, R, shift + np.array(offset))
    person = HumanHand.fit(play)
    plans = GraspPlanner(scenario, description).plans()
    goal, _ = select_reachable(plans, seen_fingertips(retarget, hand, person))
    result, _ = run_trial(scenario, retarget, (person, goal))
    return {"map": map_name, **result.to_json()}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objects", nargs="+", default=list(OBJECTS), metavar="OBJECT")
    parser.add_argument("--maps", nargs="+", default=list(MAPS), choices=list(MAPS), metavar="MAP")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scenario-text", help="YAML merged into the scenario, such as an operator's field")
    parser.add_argument("--json", type=Path, help="file for date, table and every trial")
    arguments = parser.parse_args(argv)
    cases = list(itertools.product(arguments.maps, arguments.objects, range(arguments.seeds)))
    results = []
    with progress_bar() as progress:
        task = progress.add_task("trials", total=len(cases), note="")
        for result in Parallel(arguments.jobs, return_as="generator")(
            delayed(trial)(*case, arguments.scenario_text) for case in cases
        ):
            results.append(result)
            progress.update(task, advance=1)
    date = datetime.date.today().isoformat()
    counts = {
        name: {each: _success(results, name, each) for each in arguments.objects} for name in arguments.maps
    }
    table = Table("map", *arguments.objects, "median time", title=f"grasps that succeeded, {date}")
    for name, row in counts.items():
        times = [r["completion_time"] for r in results if r["map"] == name and r["success"]]
        shares = [f"{count['successes']}/{count['trials']}" for count in row.values()]
        table.add_row(name, *shares, f"{statistics.median(times):.1f} s" if times else "–")
    console.print(table)
    console.print(f"{sum(r['success'] for r in results)} of {len(results)} grasps succeeded")
    if arguments.json is not None:
        write_text(arguments.json, json.dumps({"date": date, "successes": counts, "trials": results}))
    return 0


def _success(results: Sequence[dict], map_name: str, object_name: str) -> dict[str, int]:
    trials = [r["success"] for r in results if r["map"] == map_name and r["object"] == object_name]
    return {"successes": sum(trials), "trials": len(trials)}


if __name__ == "__main__":
    run_main(main)

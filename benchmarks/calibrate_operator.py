"""Tries the simulated person out on known affine maps, which are no method under test.

The person's parameters are chosen by looking at this table alone: maps of known gain, rotation and
offset, a few objects, a few seeds. Trials run in parallel processes.
"""

import argparse
import copy
import itertools
import json
import statistics
from collections.abc import Sequence

import numpy as np
from joblib import Parallel, delayed
from rich.table import Table
from scipy.spatial.transform import Rotation

from geort_drake.console import console, progress_bar, run_main

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


def trial(map_name: str, object_name: str, seed: int, scenario_text: str | None) -> dict:
    """One grasp through one map."""
    from geort_drake.gloves.human_hand import HumanHand
    from geort_drake.gloves.play import synthesize_play
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.model import HandModel
    from geort_drake.operators.affine_map import AffineMap
    from geort_drake.simulation.grasp_planner import GraspPlanner
    from geort_drake.simulation.scenario import load_scenario
    from geort_drake.simulation.trial import run_trial

    scenario = copy.deepcopy(load_scenario(text=scenario_text))
    scenario.object.name, scenario.random_seed = object_name, seed
    description = load_hand(scenario.hand)
    hand = HandModel(description)
    play = synthesize_play(seed=0, duration_s=60)
    # The middle of what the person's fingertips reach meets the middle of what the robot's reach.
    rest = play.fingertips(description.human_keypoints).mean(axis=0)
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (2000, len(hand.lower)))
    shift = hand.fingertips(q).mean(axis=0) - hand.fingertips(hand.default_position)
    gain, turn, offset = MAPS[map_name]
    R = Rotation.from_rotvec(turn, degrees=True).as_matrix()
    retarget = AffineMap(hand, rest, gain, R, shift + np.array(offset))
    goal = GraspPlanner(scenario, description).plan()
    result, _ = run_trial(scenario, retarget, (HumanHand.fit(play), goal))
    return {"map": map_name, **result.to_json()}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", nargs="+", default=["cylinder", "sphere", "cube"])
    parser.add_argument("--maps", nargs="+", default=list(MAPS), choices=list(MAPS), metavar="MAP")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scenario_text", help="YAML merged into the scenario, such as an operator's field")
    parser.add_argument("--json", action="store_true", help="print every trial as JSON")
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
    table = Table("map", *arguments.objects, "median time")
    for name in arguments.maps:
        row = [name]
        for thing in arguments.objects:
            mine = [r for r in results if r["map"] == name and r["object"] == thing]
            row.append(f"{sum(r['success'] for r in mine)}/{len(mine)}")
        times = [r["completion_time"] for r in results if r["map"] == name and r["success"]]
        row.append(f"{statistics.median(times):.1f} s" if times else "–")
        table.add_row(*row)
    console.print(table)
    console.print(f"{sum(r['success'] for r in results)} of {len(results)} grasps succeeded")
    if arguments.json:
        print(json.dumps(results, indent=1))
    return 0


if __name__ == "__main__":
    run_main(main)

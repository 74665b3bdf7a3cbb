"""Gates: is a task neither too hard nor too easy, before any method is tried?

python studies/gates.py --task keys --seeds 20 --json gates.json

Printed, and written to --json: successes of a scripted robot without a person, which must be at least 18 of
20; successes of a person with a hand that holds still, at most 1 of 20; and mean scores of an affine map
with inverse kinematics in which every fingertip also moves by a fraction of its neighbours' motion, 0 to
0.75, which must not rise with the fraction, for each kind of person. `studies/scripted` has the robots.
"""

import argparse
import functools
import importlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geort_drake.comparison.retargeters import retargeter_of
from geort_drake.console import run_main
from geort_drake.files import write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.play import synthesize_play
from geort_drake.people.recording import Recording
from geort_drake.simulation.free_play import seen_fingertips
from geort_drake.simulation.scenario import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import run_trial

FRACTIONS = (0.0, 0.25, 0.5, 0.75)


class CrossTalk:
    """A map in which every fingertip also moves by a fraction of its neighbours' mean motion."""

    def __init__(self, retarget, rest: np.ndarray, keypoints: Sequence[int], fraction: float):
        self._retarget, self._rest, self._keypoints = retarget, rest, list(keypoints)
        self._fraction, self.joint_names = fraction, retarget.joint_names

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        p_HF = p_HK[self._keypoints]
        moved = (p_HF - self._rest)[1:]
        others = (moved.sum(axis=0) - moved) / (len(moved) - 1)
        mixed = p_HF.copy()
        mixed[1:] += self._fraction * others
        return self._retarget(mixed)


@functools.cache
def setting(task_name: str, hand_name: str) -> tuple[HandModel, Recording, HumanHand, list]:
    """The robot hand, the person's play and hand, and the ways to do the task."""
    hand, task = HandModel(load_hand(hand_name)), find_task(task_name)
    recording = synthesize_play(seed=0, side=hand.description.side)
    plans = task.plans(load_scenario(*task.scenario, hand=hand_name), hand.description)
    return hand, recording, HumanHand.fit(recording), plans


def trial(task_name: str, hand_name: str, kind: str, method: str, fraction: float, seed: int) -> dict:
    """Record of one trial of a person with the affine map, or with a hand that holds still."""
    task = find_task(task_name)
    scenario = load_scenario(*task.scenario, hand=hand_name)
    scenario.kind, scenario.random_seed = kind, seed
    hand, recording, person, plans = setting(task_name, hand_name)
    retarget, _ = retargeter_of(method, hand, recording, 0, lambda *_: Path())
    if fraction:
        keypoints = hand.description.human_keypoints
        retarget = CrossTalk(retarget, recording.fingertips(keypoints).mean(axis=0), keypoints, fraction)
    goal, _ = task.keep(plans, seen_fingertips(retarget, hand, person))
    result, _ = run_trial(scenario, retarget, (person, goal))
    return {"kind": kind, "method": method, "fraction": fraction, **result.to_json()}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="keys", help="name of a task with a scripted robot")
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--seeds", type=int, default=20, help="of the scripted robot and the still hand")
    parser.add_argument("--map-seeds", type=int, default=2, help="of each affine map and kind of person")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    arguments = parser.parse_args(argv)
    task, seeds = find_task(arguments.task), range(arguments.seeds)
    robot = importlib.import_module(f"scripted.{task.name}")
    scenario = load_scenario(*task.scenario, hand=arguments.hand)
    plan = robot.plans(scenario, load_hand(arguments.hand))[0]
    scores = [robot.scripted(scenario, plan, seed) for seed in seeds]
    done = sum(score > 0 for score in scores)
    print(f"scripted robot: {done} of {len(scores)}; wanted at least {0.9 * len(scores):.0f}", flush=True)
    one = functools.partial(trial, task.name, arguments.hand)
    records = [one(task.kinds[0], "hold", 0.0, seed) for seed in seeds]
    held = sum(record["success"] for record in records)
    print(f"hold: {held} of {len(records)}; wanted at most {0.05 * len(records):.0f}", flush=True)
    ordered = {}
    for kind in task.kinds if arguments.map_seeds else ():
        own = [
            [one(kind, "affine_ik", fraction, seed) for seed in range(arguments.map_seeds)]
            for fraction in FRACTIONS
        ]
        records += [record for group in own for record in group]
        means = ordered[kind] = [float(np.mean([r["score"] for r in group])) for group in own]
        right = all(np.diff(means) <= 0) and means[-1] < means[0]
        shown = ", ".join(f"{mean:.2f}" for mean in means)
        print(f"affine maps, {kind}: {shown}; ordered: {right}", flush=True)
    figures = {"scripted": scores, "affine": ordered, "records": records}
    if arguments.json:
        write_text(arguments.json, json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))

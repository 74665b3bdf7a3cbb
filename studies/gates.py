"""Validates a task before any method is tried: it is neither too hard nor too easy, and reveals bad maps.

python studies/gates.py --task keys --json gates.json

Prints, and writes to --json: successes of a scripted robot without a person, which must be at least 18 of 20;
successes of a person with a hand that holds still, at most 1 of 20; and, for each kind of person, scores with
an affine map and three worsened ones. `WORSENED` states the faults and why the task's mechanics must reveal
them. Kendall's tau must be significantly positive (p < 0.05 in a permutation test within seeds). The same
command resumes an interrupted run. The robots are in `studies/scripted`.
"""

import argparse
import functools
import importlib
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import permutation_test

from geort_drake.console import run_main
from geort_drake.files import write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.hand import Hand
from geort_drake.methods import resolve
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.simulation.free_play import keep_reached, seen_fingertips
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import run_trial

MIXED, TURNED, SHRUNK = "mixed", "turned", "shrunk"


class Worsening(NamedTuple):
    """Amounts of a fault of a map, and why the task must reveal it."""

    amounts: tuple[float, ...]
    reason: str


_MIXED = (0.0, 0.25, 0.5, 0.75)
_TURNED = (0.0, 20.0, 40.0, 60.0)
_SHRUNK = (0.0, 0.5, 0.75, 0.875)
_CONE = Worsening(
    _TURNED, "a squeeze that is turned beyond the friction cone, 39° at the mean friction of 0.8, slides"
)
_REACH = Worsening(
    _SHRUNK,
    "fingertips open by 25 mm and squeeze by 20 mm; own fingertips move by about 50 mm either way",
)

# Task → fault → its worsening. MIXED: every finger but the thumb also moves by this fraction of the mean
# motion of the other such fingers. TURNED: all directions are turned by this angle, degrees, about an axis in
# the palm's plane that the seed draws. SHRUNK: all motions are smaller by this fraction. A person who learns
# the response to each own fingertip can compensate turned motion, but lacks the reach for shrunken motion.
WORSENED = {
    "keys": {
        MIXED: Worsening(_MIXED, "a press of 8 mm moves the others by 1, 2 and 3 mm; 2.5 mm are allowed"),
        SHRUNK: Worsening(
            _SHRUNK, "three fingertips press keys 45 mm apart; own fingertips move by about 50 mm either way"
        ),
    },
    "grasp": {TURNED: _CONE, SHRUNK: _REACH},
    "pick_place": {TURNED: _CONE, SHRUNK: _REACH},
    "peg": {TURNED: _CONE, SHRUNK: _REACH},
    "cap": {TURNED: Worsening(_TURNED, "a turned stroke leaves the circle around the cap, and slides")},
}


class WorsenedMap:
    """A map whose input motion about a posture has a fault; see `WORSENED`."""

    def __init__(
        self, retarget: Any, rest: np.ndarray, keypoints: Sequence[int], fault: str, amount: float, seed: int
    ):
        self._retarget, self._rest, self._keypoints = retarget, rest, list(keypoints)
        self.joint_names = retarget.joint_names
        self._mixing, self._linear = np.eye(len(rest)), np.eye(3)
        if fault == MIXED:
            others = len(rest) - 2
            self._mixing[1:, 1:] += amount / others * (1 - np.eye(others + 1))
        elif fault == SHRUNK:
            self._linear *= 1 - amount
        else:
            turn = np.random.default_rng(seed).uniform(0, 2 * np.pi)
            axis = np.array([0.0, np.cos(turn), np.sin(turn)])  # x of H points out of the palm
            self._linear = Rotation.from_rotvec(np.radians(amount) * axis).as_matrix()

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        moved = p_HK[self._keypoints] - self._rest
        return self._retarget(self._rest + self._mixing @ moved @ self._linear.T)


@functools.cache
def setting(task_name: str, hand_name: str) -> tuple[Hand, Recording, HumanHand, list]:
    """Returns the robot hand, the person's play and hand, and the plans for the task."""
    hand, task = Hand(hand_name), find_task(task_name)
    recording = synthesize_play(seed=0, side=hand.description.side)
    plans = task.plans(load_scenario(task=task.name, hand=hand_name), hand.description)
    return hand, recording, HumanHand.fit(recording), plans


@functools.cache
def map_and_goal(
    task_name: str, hand_name: str, method: str, fault: str, amount: float, seed: int
) -> tuple[Any, Any]:
    """Returns the map, worsened by an amount, and the goal that the person selects after free play."""
    hand, recording, person, plans = setting(task_name, hand_name)
    retarget, _ = resolve(method, hand, recording)
    if amount:
        keypoints = hand.description.human_keypoints
        rest = recording.fingertips(keypoints).mean(axis=0)
        retarget = WorsenedMap(retarget, rest, keypoints, fault, amount, seed)
    goal, _ = keep_reached(plans, seen_fingertips(retarget, hand, person))
    return retarget, goal


def trial(
    task_name: str, hand_name: str, fault: str, kind: str, method: str, amount: float, seed: int
) -> dict:
    """Returns the record of a trial of a person with the affine map, or with a hand that holds still."""
    scenario = load_scenario(task=task_name, hand=hand_name)
    scenario.kind, scenario.random_seed = kind, seed
    retarget, goal = map_and_goal(task_name, hand_name, method, fault, amount, seed if amount else 0)
    result, _ = run_trial(scenario, retarget, (setting(task_name, hand_name)[2], goal))
    return {"fault": fault, "kind": kind, "method": method, "amount": amount, **result.to_json()}


def tau(*scores: np.ndarray) -> float:
    """Returns Kendall's tau-a of scores (trials,) of each map, expected best first; 1 if ordered so."""
    return float(np.mean([np.sign(better - worse) for better, worse in itertools.combinations(scores, 2)]))


def ordering(records: Sequence[dict], kinds: Sequence[str], amounts: Sequence[float]) -> dict[str, Any]:
    """Returns mean scores by map, tau, and its p-values against no effect, of a high and of a low tau.

    A kind of person with a seed, for whom all maps were tried, is a block; scores are permuted within blocks.
    """
    scores = {(r["kind"], r["seed"], r["amount"]): r["score"] for r in records if r["kind"] in kinds}
    blocks = list(dict.fromkeys((kind, seed) for kind, seed, _ in scores))
    blocks = [block for block in blocks if all((*block, amount) in scores for amount in amounts)]
    if len(blocks) < 2:  # too few for a test
        return {"blocks": len(blocks)}
    table = [np.array([scores[*block, amount] for block in blocks]) for amount in amounts]
    chances = [
        permutation_test(table, tau, permutation_type="samples", alternative=side, rng=0).pvalue
        for side in ("greater", "less")
    ]
    return {
        "blocks": len(blocks),
        "means": [round(float(scores.mean()), 3) for scores in table],
        "tau": round(tau(*table), 3),
        "p": round(float(chances[0]), 4),
        "p_reversed": round(float(chances[1]), 4),
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="keys", choices=WORSENED, help="a task with a scripted robot")
    parser.add_argument("--fault", help="fault of the worsened maps (default: the task's first)")
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--kinds", nargs="+", help="kinds of people (default: all of the task)")
    parser.add_argument("--seeds", type=int, default=20, help="seeds of scripted robot and still hand")
    parser.add_argument("--map-seeds", type=int, default=4, help="seeds per map and kind of person")
    parser.add_argument("--json", type=Path, required=True, help="file for the figures")
    arguments = parser.parse_args(argv)
    task, path = find_task(arguments.task), arguments.json
    faults, kinds = WORSENED[task.name], arguments.kinds or task.kinds
    fault = arguments.fault or next(iter(faults))
    if fault not in faults:
        parser.error(f"--fault of task {task.name} is one of {', '.join(faults)}, not {fault}")
    worsened = faults[fault]
    figures = json.loads(path.read_text()) if path.exists() else {"scripted": {}, "records": []}
    scripted, records = figures["scripted"], figures["records"]
    robot = importlib.import_module(f"scripted.{task.name}")
    scenario = load_scenario(task=task.name, hand=arguments.hand)
    plan = robot.plans(scenario, load_hand(arguments.hand))[0]
    known = {(r["fault"], r["kind"], r["method"], r["amount"], r["seed"]) for r in records}
    # Seed by seed, so that an interrupted run is balanced. Maps without a fault serve every fault.
    wanted = [
        (fault if amount else "", kind, "affine_ik", amount, seed)
        for seed in range(arguments.map_seeds)
        for kind in kinds
        for amount in worsened.amounts
    ] + [("", task.kinds[0], "hold", 0.0, seed) for seed in range(arguments.seeds)]
    for each in wanted:
        if each not in known:
            records.append(trial(task.name, arguments.hand, *each))
            write_text(path, json.dumps(figures, indent=1) + "\n")
    for seed in range(arguments.seeds):
        if str(seed) not in scripted:
            scripted[str(seed)] = robot.scripted(scenario, plan, seed)
            write_text(path, json.dumps(figures, indent=1) + "\n")
    if arguments.seeds:
        done = sum(score > 0 for score in scripted.values())
        print(f"scripted robot: {done} of {len(scripted)}; wanted at least {0.9 * len(scripted):.0f}")
        held = [record["success"] for record in records if record["method"] == "hold"]
        print(f"hold: {sum(held)} of {len(held)}; wanted at most {0.05 * len(held):.0f}")
    print(f"{fault} by {', '.join(f'{amount:g}' for amount in worsened.amounts)}: {worsened.reason}")
    affine = [r for r in records if r["method"] == "affine_ik" and r["fault"] in ("", fault)]
    groups = {kind: [kind] for kind in kinds} | {"all kinds": kinds}
    figures["ordered"] = {name: ordering(affine, group, worsened.amounts) for name, group in groups.items()}
    for kind, found in figures["ordered"].items():
        print(f"{kind}: {json.dumps(found)}")
    write_text(path, json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))

"""Validates tasks before methods are compared by them: which task reveals bad maps, to which kind of person?

python studies/gates.py --tasks keys --output gates

A scripted robot must succeed in at least 90 % of the trials, and a hand that holds still in at most 5 %.
Then people of each kind do the task through three maps of different families, and through copies of each
with faults of known sizes. `FAULTS` states faults and sizes, before anything runs. A fault is revealed if
scores fall as it grows: Kendall's tau must be positive in a permutation test within seeds, with p < 0.05
after Holm's correction. A task speaks for a kind of person if it reveals a fault of at least two families.
Each task and kind is a claim of its own, so the correction is for the fifteen tests that decide it. Trials
are rows of trials.jsonl, as in a benchmark; the same command resumes an interrupted run, and adds tasks and
seeds. The scripted robots are in `studies/scripted`.
"""

import argparse
import importlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import permutation_test

from geort_drake.benchmark.analysis import frame_of, holm
from geort_drake.benchmark.log import Row, TrialKey, TrialLog, read_rows
from geort_drake.benchmark.workers import call_in_workers, simulate
from geort_drake.console import console, progress_bar, run_main
from geort_drake.hands.description import load_hand
from geort_drake.hands.hand import Hand
from geort_drake.methods import resolve
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.base import forget
from geort_drake.simulation.free_play import after_play, keep_reached, seen_fingertips
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import Trial

FAMILIES = ("affine_ik", "geort", "universal")
LEVEL = 0.05
# Distances of the own thumb and finger at which they pinch fully, and not at all, m.
PINCHED, APART = 0.02, 0.06
# The case of a task that has several; the others have one.
CASES = {"grasp": "cylinder", "pick_place": "block_25"}


class Fault(NamedTuple):
    """A fault of maps, in sizes from small to large, and what it spoils."""

    sizes: tuple[float, ...]
    reason: str


FAULTS = {
    "turned": Fault(
        (20.0, 40.0, 60.0),
        "all directions turn by this angle, degrees, about an axis in the palm's plane that the seed draws; "
        "a squeeze that is turned by more than 39° leaves the friction cone at the mean friction of 0.8",
    ),
    "mixed": Fault(
        (0.25, 0.5, 0.75),
        "every finger but the thumb also moves by this fraction of the mean motion of the other such "
        "fingers; a press of 8 mm moves the others by 1 to 3 mm",
    ),
    "shrunk": Fault(
        (0.5, 0.75, 0.875),
        "all motion is smaller by this fraction; own fingertips move by about 50 mm either way",
    ),
    "gapped": Fault((10.0, 20.0, 30.0), "pinches of the person stay open by this distance, mm"),
    "jittering": Fault(
        (1.0, 2.0, 4.0), "white noise of this deviation, mm, in every coordinate of each frame"
    ),
}


class WorsenedMap:
    """A map whose inputs have a fault of `FAULTS`.

    Args:
        retarget: the map.
        rest: (F, 3) fingertips in H about which the person moves, m; the first is the thumb's.
        keypoints: F numbers of the keypoints that are the fingertips.
        fault, size: name and size of the fault.
        seed: of the axis of a turn, and of noise.
    """

    def __init__(
        self, retarget: Any, rest: np.ndarray, keypoints: Sequence[int], fault: str, size: float, seed: int
    ):
        self._retarget, self._rest, self._keypoints = retarget, rest, list(keypoints)
        self.joint_names = retarget.joint_names
        self._fault, self._size, self._seed = fault, size, seed
        self.reset()

    def reset(self) -> None:
        """Begins anew, with the same noise."""
        forget(self._retarget)
        self._rng = np.random.default_rng(self._seed)

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        return self._retarget(self.inputs(p_HK[self._keypoints]))

    def inputs(self, p_HF: np.ndarray) -> np.ndarray:
        """Returns the fingertips (F, 3), m, that the map gets instead of these."""
        moved, size, others = p_HF - self._rest, self._size, len(p_HF) - 1
        if self._fault == "turned":
            turn = np.random.default_rng(self._seed).uniform(0, 2 * np.pi)
            axis = np.array([0.0, np.cos(turn), np.sin(turn)])  # x of H points out of the palm
            moved = moved @ Rotation.from_rotvec(np.radians(size) * axis).as_matrix().T
        elif self._fault == "mixed":
            total = moved[1:].sum(axis=0)
            moved = np.concatenate([moved[:1], moved[1:] + size / (others - 1) * (total - moved[1:])])
        elif self._fault == "shrunk":
            moved = (1 - size) * moved
        elif self._fault == "gapped":
            distance = np.linalg.norm(p_HF[1:] - p_HF[0], axis=1, keepdims=True)
            pinching = np.clip((APART - distance) / (APART - PINCHED), 0.0, 1.0)
            away = self._rest[1:] - self._rest[0]
            away /= np.linalg.norm(away, axis=1, keepdims=True)
            moved = np.concatenate([moved[:1], moved[1:] + 1e-3 * size * pinching * away])
        elif self._fault == "jittering":
            moved = moved + self._rng.normal(0.0, 1e-3 * size, moved.shape)
        return self._rest + moved


def condition_of(fault: str, size: float) -> str:
    """Returns the field `condition` of a row; empty for the map itself."""
    return f"{fault}={size:g}"


def keys_of(tasks: Sequence[str], kinds: Sequence[str], seeds: int, scripted_seeds: int) -> list[TrialKey]:
    """Returns the trials, seed by seed, so that every prefix is balanced."""
    conditions = ["", *(condition_of(name, size) for name, fault in FAULTS.items() for size in fault.sizes)]
    keys = []
    for seed in range(max(seeds, scripted_seeds)):
        for task in tasks:
            case = CASES.get(task) or find_task(task).cases()[0]
            kind = find_task(task).kinds[0]
            if seed < scripted_seeds:
                keys += [TrialKey(name, 0, task, kind, "", case, 0, seed) for name in ("scripted", "hold")]
            if seed < seeds:
                keys += [
                    TrialKey(family, 0, task, each, condition, case, 0, seed)
                    for family, each, condition in itertools.product(FAMILIES, kinds, conditions)
                ]
    return keys


class Trials:
    """Makes the trials of keys, for one hand."""

    def __init__(self, hand_name: str):
        self._hand = Hand(hand_name)
        self._play = synthesize_play(seed=0, side=self._hand.description.side)
        self._person = HumanHand.measured_adult()
        self._maps: dict[str, Any] = {"hold": METHODS["hold"].fit(self._hand)}
        self._plans: dict[str, Sequence[Any]] = {}
        self._goals: dict[tuple, Any] = {}

    def arguments(self, keys: Iterable[TrialKey]) -> Iterator[tuple[TrialKey, Trial]]:
        """Yields the arguments of `run`; a scripted trial has the first plan and no person."""
        for key in keys:
            yield key, self.trial(key)

    def trial(self, key: TrialKey) -> Trial:
        """Returns the trial of a key; the goal is the one that free play showed to be attainable."""
        scenario = load_scenario(task=key.task, hand=self._hand.description.name)
        find_task(key.task).choose(scenario, key.object)
        scenario.kind, scenario.random_seed = key.kind, key.seed
        if key.task not in self._plans:
            self._plans[key.task] = find_task(key.task).plans(scenario, self._hand.description)
        if key.method == "scripted":
            return Trial(scenario, self._map("hold"), (self._person, self._plans[key.task][0]))
        retarget = self._map(key.method)
        # Only what the seed draws differs from seed to seed.
        seed = key.seed if key.condition.startswith(("turned", "jittering")) else 0
        if key.condition:
            fault, _, size = key.condition.partition("=")
            keypoints = self._hand.description.human_keypoints
            rest = self._play.fingertips(keypoints).mean(axis=0)
            retarget = WorsenedMap(retarget, rest, keypoints, fault, float(size), seed)
        same = key.task, key.method, key.condition, seed
        if same not in self._goals:
            seen = seen_fingertips(retarget, self._hand, self._person)
            self._goals[same] = keep_reached(self._plans[key.task], seen)
        goal, attainable = self._goals[same]
        return Trial(scenario, retarget, (self._person, goal), attainable)

    def _map(self, method: str) -> Any:
        if method not in self._maps:
            retarget, _ = resolve(method, self._hand, self._play)
            self._maps[method] = after_play(retarget, self._person)
        return self._maps[method]


def run(key: TrialKey, trial: Trial) -> Row:
    """Returns the row of a trial."""
    if key.method != "scripted":
        return simulate(key, trial)
    robot = importlib.import_module(f"scripted.{key.task}")
    plan = robot.plans(trial.scenario, load_hand(trial.scenario.hand))[0]
    score = robot.scripted(trial.scenario, plan, key.seed)
    result = {"success": score > 0, "score": score, "completion_time": None, "outcome": "scripted"}
    return {**key._asdict(), **result, "timeout": trial.scenario.timeout}


def tau(*scores: np.ndarray) -> float:
    """Returns Kendall's tau-a of scores (trials,) of each map, expected best first; 1 if ordered so."""
    return float(np.mean([np.sign(better - worse) for better, worse in itertools.combinations(scores, 2)]))


def ordering(scores: np.ndarray) -> tuple[float, float]:
    """Returns tau of scores (seeds, maps), expected best first, and its p-value against no order.

    Scores are permuted within seeds.
    """
    if len(scores) < 2:  # too few for a test
        return np.nan, 1.0
    options: Any = {"permutation_type": "samples", "alternative": "greater", "rng": 0}
    return tau(*scores.T), float(permutation_test(scores.T, tau, **options).pvalue)


def tests_of(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns a row per task, kind, family and fault: mean scores by size, seeds, tau, and p by Holm."""
    rows = []
    people = frame[frame["method"].isin(FAMILIES)]
    for (task, kind, family), group in people.groupby(["task", "kind", "method"]):
        scores = group.pivot(index="seed", columns="condition", values="score")
        for name, fault in FAULTS.items():
            columns = ["", *(condition_of(name, size) for size in fault.sizes)]
            table = scores.reindex(columns=columns).dropna().to_numpy(float)
            if len(table) == 0:
                continue
            order, p = ordering(table)
            means = ", ".join(f"{100 * mean:.0f}" for mean in table.mean(axis=0))
            rows.append((task, kind, family, name, len(table), means, order, p))
    columns = ["task", "kind", "family", "fault", "seeds", "score", "tau", "p"]
    tests = pd.DataFrame(rows, columns=columns)
    tests["p_holm"] = tests.groupby(["task", "kind"])["p"].transform(lambda p: holm(p.tolist()))
    tests["revealed"] = tests["p_holm"] < LEVEL
    return tests


def report(rows: Iterable[Row]) -> str:
    """Returns the gates of all tasks in Markdown."""
    frame = frame_of(rows)
    frame = frame[frame["error"].isna()]
    lines = ["| task | scripted robot | hold |", "|---|---|---|"]
    for task, group in frame.groupby("task"):
        cells = (group.loc[group["method"] == name, "success"] for name in ("scripted", "hold"))
        lines.append(f"| {task} | " + " | ".join(f"{cell.sum()} of {len(cell)}" for cell in cells) + " |")
    tests = tests_of(frame)
    lines += [
        "",
        "| task | kind | family | fault | seeds | score, % | τ | p (Holm) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for test in tests.itertuples():
        p = f"**{test.p_holm:.3g}**" if test.revealed else f"{test.p_holm:.2g}"
        names = f"{test.task} | {test.kind} | {test.family} | {test.fault}"
        lines.append(f"| {names} | {test.seeds} | {test.score} | {test.tau:.2f} | {p} |")
    lines += ["", "| task | kind | families with a revealed fault | speaks |", "|---|---|---|---|"]
    for (task, kind), group in tests.groupby(["task", "kind"]):
        families = sorted(group.loc[group["revealed"], "family"].unique())
        verdict = "yes" if len(families) >= 2 else "no"
        lines.append(f"| {task} | {kind} | {', '.join(families) or '–'} | {verdict} |")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ["grasp", "pick_place", "peg", "keys", "cap"]
    parser.add_argument("--tasks", nargs="+", default=names, choices=names, help="default: all")
    parser.add_argument("--kinds", nargs="+", default=["adaptive", "mimicry", "servo"], metavar="KIND")
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--seeds", type=int, default=4, help="seeds of each map and kind of person")
    parser.add_argument(
        "--scripted-seeds", type=int, default=20, help="seeds of scripted robot and still hand"
    )
    parser.add_argument("--jobs", type=int, default=2, help="number of parallel trials")
    parser.add_argument("--output", type=Path, required=True, help="folder of trials.jsonl and report.md")
    arguments = parser.parse_args(argv)
    keys = keys_of(arguments.tasks, arguments.kinds, arguments.seeds, arguments.scripted_seeds)
    with TrialLog(arguments.output) as log, progress_bar() as progress:
        pending = log.unfinished(keys)
        bar = progress.add_task("trials", total=len(pending), note="")
        trials = Trials(arguments.hand).arguments(pending)
        for row in call_in_workers(run, trials, arguments.jobs) if pending else ():
            log.append(row)
            progress.update(bar, advance=1)
        text = report(read_rows(log.path))
    (arguments.output / "report.md").write_text(text + "\n")
    console.print(text)
    return 0


if __name__ == "__main__":
    run_main(main)

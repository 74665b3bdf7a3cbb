"""Copies of a map with faults of known kinds and sizes, and the trials that people do through them."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.benchmark.log import Row, TrialKey, TrialLog, read_rows
from geort_drake.benchmark.workers import call_in_workers
from geort_drake.console import console, progress_bar
from geort_drake.hands.hand import Hand
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.methods import resolve
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.base import forget
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import Trial, after_play, seen_fingertips, select_reachable

# What each fault does, and the unit of its size. The seed draws axes, directions and noise.
FAULTS = {
    "turned": "all directions turn by this angle, degrees, about an axis in the palm's plane",
    "mixed": "every finger but the thumb moves by this fraction of the mean motion of the others, too",
    "shrunk": "all motion is smaller by this fraction",
    "uneven": "along an axis of each finger, the gain rises to this many times its least value",
    "gapped": "pinches of the person stay open by this distance, mm",
    "jittering": "white noise of this deviation, mm, in every coordinate of each frame",
    "drifting": "every fingertip is displaced by up to this distance, mm, and back, with a period of 20 s",
    "twisted": "fingers of four joints bend by this distance of joint angles, rad, around a still fingertip",
}
# Faults that are not the same for all seeds.
DRAWN = {"turned", "uneven", "jittering", "drifting"}
# Distances of the own thumb and finger at which they pinch fully, and not at all, m.
PINCHED, APART = 0.02, 0.06
UNEVEN_RANGE = 0.03  # m, distance from the rest at which the gain has nearly its least or largest value
DRIFT_PERIOD_S, RATE_HZ = 20.0, 100.0
TWIST_STEPS = 5
# The case of a task that has several; the others have one.
CASES = {"grasp": "cylinder", "pick_place": "block_25"}


def case_of(task: str, cases: Mapping[str, str] = CASES) -> str:
    """Returns the case of a task in `cases`, or its first."""
    return cases.get(task) or find_task(task).cases()[0]


def condition_of(faults: Mapping[str, float]) -> str:
    """Returns the field `condition` of a row, such as "shrunk=0.4+turned=30"; empty for the map itself."""
    return "+".join(f"{name}={size:g}" for name, size in faults.items())


def faults_of(condition: str) -> dict[str, float]:
    """Returns the sizes of the faults in a condition, by name."""
    parts = (part.partition("=") for part in condition.split("+") if part)
    return {name: float(size) for name, _, size in parts}


class WorsenedMap:
    """A map with faults of `FAULTS`: in its inputs, or (`twisted`) in its postures.

    Args:
        retarget: the map.
        rest: (F, 3) fingertips in H about which the person moves, m; the first is the thumb's.
        keypoints: F numbers of the keypoints that are the fingertips.
        faults: sizes of the faults, by name.
        seed: of axes, directions and noise.
        kinematics: the robot hand's, with the joints of the map; only `twisted` needs them.
    """

    def __init__(
        self,
        retarget: Any,
        rest: np.ndarray,
        keypoints: Sequence[int],
        faults: Mapping[str, float],
        seed: int,
        kinematics: HandKinematics | None = None,
    ):
        self._retarget, self._rest, self._keypoints = retarget, rest, list(keypoints)
        self.joint_names = retarget.joint_names
        self._faults, self._seed, self._kinematics = dict(faults), seed, kinematics
        if kinematics is not None:
            self._order = [self.joint_names.index(name) for name in kinematics.joint_names]
            self._solver = NumpyKinematics(kinematics)
            _, J = self._solver.fingertips_and_jacobians(0.5 * (kinematics.lower + kinematics.upper)[None])
            moves = np.abs(J[0]).max(axis=1) > 0  # which joint moves which finger
            fingers = np.flatnonzero(moves.sum(axis=1) == 4)
            joints = [np.flatnonzero(moves[finger]) for finger in fingers]
            self._redundant = fingers, np.array(joints, dtype=int).reshape(-1, 4)
        self.reset()

    def reset(self) -> None:
        """Begins anew, with the same noise."""
        forget(self._retarget)
        self._rng = np.random.default_rng(self._seed)
        self._calls = 0

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        q = self._retarget(self.inputs(p_HK[self._keypoints]))
        return self.twisted(q) if "twisted" in self._faults else q

    def inputs(self, p_HF: np.ndarray) -> np.ndarray:
        """Returns the fingertips (F, 3), m, that the map gets instead of these."""
        moved, others = p_HF - self._rest, len(p_HF) - 1
        self._calls += 1
        for fault, size in self._faults.items():
            drawn = np.random.default_rng(self._seed)
            if fault == "turned":
                turn = drawn.uniform(0, 2 * np.pi)
                axis = np.array([0.0, np.cos(turn), np.sin(turn)])  # x of H points out of the palm
                moved = moved @ Rotation.from_rotvec(np.radians(size) * axis).as_matrix().T
            elif fault == "mixed":
                total = moved[1:].sum(axis=0)
                moved = np.concatenate([moved[:1], moved[1:] + size / (others - 1) * (total - moved[1:])])
            elif fault == "shrunk":
                moved = (1 - size) * moved
            elif fault == "uneven":
                axes = _directions(drawn, len(moved))
                along = (moved * axes).sum(axis=1, keepdims=True)
                # The derivative of along + b · range · log cosh is 1 + b · tanh, from 1 − b to 1 + b.
                bend = (size - 1) / (size + 1) * UNEVEN_RANGE * np.log(np.cosh(along / UNEVEN_RANGE))
                moved = moved + bend * axes
            elif fault == "gapped":
                distance = np.linalg.norm(p_HF[1:] - p_HF[0], axis=1, keepdims=True)
                pinching = np.clip((APART - distance) / (APART - PINCHED), 0.0, 1.0)
                away = self._rest[1:] - self._rest[0]
                away /= np.linalg.norm(away, axis=1, keepdims=True)
                moved = np.concatenate([moved[:1], moved[1:] + 1e-3 * size * pinching * away])
            elif fault == "jittering":
                moved = moved + self._rng.normal(0.0, 1e-3 * size, moved.shape)
            elif fault == "drifting":
                phase = 2 * np.pi * self._calls / (DRIFT_PERIOD_S * RATE_HZ)
                moved = moved + 1e-3 * size * np.sin(phase) * _directions(drawn, len(moved))
        return self._rest + moved

    def twisted(self, q: np.ndarray) -> np.ndarray:
        """Returns joint angles (n,), rad, with the same fingertips and other angles of the redundant joints.

        Each finger with four joints moves along the null space of its Jacobian, towards larger angles of its
        last joint, until one of its joints meets a limit.
        """
        assert self._kinematics is not None
        hand, solver, result = self._kinematics, self._solver, np.array(q, dtype=float)
        q, fingers, joints = result[self._order], *self._redundant
        length = self._faults["twisted"] / TWIST_STEPS
        wanted = solver.fingertips(q[None])[0]
        for _ in range(TWIST_STEPS):
            tips, J = (each[0] for each in solver.fingertips_and_jacobians(q[None]))
            U, sizes, V = np.linalg.svd(np.take_along_axis(J[fingers], joints[:, None], axis=2))
            step = length * V[:, 3] * np.sign(V[:, 3, 3:])
            room = np.where(step > 0, hand.upper[joints] - q[joints], q[joints] - hand.lower[joints])
            step *= np.clip(room / np.maximum(np.abs(step), 1e-9), 0.0, 1.0).min(axis=1, keepdims=True)
            # The fingertips go back, except in directions that are almost singular.
            inverse = np.where(sizes > 0.05 * sizes[:, :1], 1.0 / sizes, 0.0)
            missed = (wanted - tips)[fingers]
            step += np.einsum("fij,fi,fki,fk->fj", V[:, :3], inverse, U, missed)
            q[joints] += step
            q = np.clip(q, hand.lower, hand.upper)
        result[self._order] = q
        return result


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draws unit vectors (count, 3)."""
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


class Trials:
    """Makes the trials of keys, for one hand."""

    def __init__(self, hand_name: str):
        self._hand = Hand(hand_name)
        self._play = synthesize_play(seed=0, side=self._hand.description.side)
        self._person = HumanHand.measured_adult()
        self._maps: dict[str, Any] = {"hold": METHODS["hold"].fit(self._hand)}
        self._kinematics = self._hand.kinematics()
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
        faults = faults_of(key.condition)
        # Only what the seed draws differs from seed to seed.
        seed = key.seed if DRAWN & faults.keys() else 0
        if faults:
            keypoints = self._hand.description.human_keypoints
            rest = self._play.fingertips(keypoints).mean(axis=0)
            retarget = WorsenedMap(retarget, rest, keypoints, faults, seed, self._kinematics)
        same = key.task, key.method, key.condition, seed
        if same not in self._goals:
            seen = seen_fingertips(retarget, self._hand, self._person)
            self._goals[same] = select_reachable(self._plans[key.task], seen)
        goal, attainable = self._goals[same]
        return Trial(scenario, retarget, (self._person, goal), attainable)

    def _map(self, method: str) -> Any:
        if method not in self._maps:
            retarget, _ = resolve(method, self._hand, self._play)
            self._maps[method] = after_play(retarget, self._person)
        return self._maps[method]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options that `run_trials` reads."""
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--jobs", type=int, default=2, help="number of parallel trials")
    parser.add_argument("--output", type=Path, required=True, help="folder of trials.jsonl and report.md")


def run_trials(
    run: Callable[[TrialKey, Trial], Row],
    keys: Sequence[TrialKey],
    report: Callable[[Iterable[Row]], str],
    options: argparse.Namespace,
    trials: Trials,
) -> list[Row]:
    """Runs the trials of which the log has no result, writes and prints the report, and returns all rows."""
    with TrialLog(options.output) as log, progress_bar() as progress:
        pending = log.unfinished(keys)
        bar = progress.add_task("trials", total=len(pending), note="")
        arguments = trials.arguments(pending)
        for row in call_in_workers(run, arguments, options.jobs) if pending else ():
            log.append(row)
            progress.update(bar, advance=1)
        rows = read_rows(log.path)
    text = report(rows)
    (options.output / "report.md").write_text(text + "\n")
    console.print(text)
    return rows

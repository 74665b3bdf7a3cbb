"""How much of a hand's C-space affine maps of a person's fingertips could cover, one map per finger.

python benchmarks/measure_bounds.py --recording human_alex.npy --hands allegro_right leap_right

A map that preserves every direction of motion is x → s x + t; one that is flat and keeps directions to a
mean cosine of 0.97 is x → A x + t with some stretch in A. Good s, A and t are searched for, which proves no
bound, whether or not the robot's joints can put its fingertips there; coverage is that of
evaluate_retargeting.py. Maps that bend may cover more.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from rich.table import Table
from scipy.optimize import differential_evolution
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from side_by_side import parse, parser, write_json

from geort_drake.cli.console import console, run_main
from geort_drake.hands.canonical import canonical_kinematics
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.training.map_figures import ROBOT_SAMPLES, robot_voxels

NEAR = 0.010  # m
COSINE = 0.97
PLACES, VOXELS = 4000, 2000  # of a finger that are looked at
PARALLEL, STRETCHED = "parallel", f"cosine {COSINE}"


def main(argv: Sequence[str] | None = None) -> int:
    made = parser(__doc__)
    made.add_argument("--recording", type=Path, help="of a right hand (default: synthetic play)")
    made.add_argument("--hands", nargs="+", default=["allegro_right", "leap_right"])
    made.add_argument("--seed", type=int, default=0, help="of samples and searches (default: %(default)s)")
    arguments = parse(made, argv)
    recording = (
        read_recording(arguments.recording, "right") if arguments.recording else synthesize_play(seed=0)
    )
    table = Table(title="C-space coverage at 10 mm within reach of affine maps")
    for heading in ("hand", "finger", PARALLEL, STRETCHED):
        table.add_column(heading, justify="left" if heading in ("hand", "finger") else "right")
    results: dict[str, dict] = {}
    for name in arguments.hands:
        description = load_hand(name)
        tips = recording.fingertips(description.human_keypoints)
        voxels = _voxels(HandModel(description), arguments.seed)
        results[name] = {}
        for i, finger in enumerate(description.finger_names):
            found = bounds(tips[:, i], voxels[i], arguments.seed)
            results[name][finger] = found
            table.add_row(name, finger, *(f"{found[kind]:.2f}" for kind in (PARALLEL, STRETCHED)))
        mean = {kind: float(np.mean([f[kind] for f in results[name].values()])) for kind in found}
        results[name]["mean"] = mean
        table.add_row(name, "mean", *(f"{mean[kind]:.2f}" for kind in (PARALLEL, STRETCHED)))
    console.print(table)
    if arguments.json:
        write_json(arguments.json, results=results)
    return 0


def bounds(tips: np.ndarray, voxels: np.ndarray, seed: int) -> dict[str, float]:
    """The best coverage of voxels (M, 3) by maps of fingertips (T, 3), m, by kind of map."""
    rng = np.random.default_rng(seed)
    human = some(voxel_thinned(tips, 0.002), PLACES, rng)
    robot = some(voxels, VOXELS, rng)
    human, centre = human - human.mean(0), robot.mean(0)
    directions = rng.standard_normal((500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def missed(A: np.ndarray, shift: np.ndarray) -> float:
        distance, _ = cKDTree(human @ A.T + centre + shift).query(robot, distance_upper_bound=NEAR)
        return 1.0 - float(np.isfinite(distance).mean())

    def parallel(x: np.ndarray) -> float:
        return missed(np.exp(x[0]) * np.eye(3), x[1:])

    def stretched(x: np.ndarray) -> float:
        R = Rotation.from_rotvec(x[6:]).as_matrix()
        A = R @ np.diag(np.exp(x[:3])) @ R.T  # a turn would cost more than it gives
        moved = directions @ A.T
        cosine = float(((directions * moved).sum(1) / np.linalg.norm(moved, axis=1)).mean())
        return missed(A, x[3:6]) + 100.0 * max(0.0, COSINE - cosine)

    scale, shift = (-1.0, 1.2), (-0.05, 0.05)
    searched = {
        PARALLEL: (parallel, [scale] + [shift] * 3),
        STRETCHED: (stretched, [scale] * 3 + [shift] * 3 + [(-1.6, 1.6)] * 3),
    }
    return {
        kind: 1.0
        - float(differential_evolution(function, limits, maxiter=60, popsize=8, rng=seed, polish=False).fun)
        for kind, (function, limits) in searched.items()
    }


def some(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return points if len(points) <= count else rng.choice(points, count, replace=False)


def _voxels(hand: HandModel, seed: int) -> list[np.ndarray]:
    """Per finger, the centres of its C-space's voxels, m, as the evaluation has them."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(hand.lower, hand.upper, (ROBOT_SAMPLES, len(hand.joint_names)))
    tips = canonical_kinematics(hand).fingertips(torch.tensor(q, dtype=torch.float32))
    return robot_voxels(tips.numpy())


if __name__ == "__main__":
    run_main(main)

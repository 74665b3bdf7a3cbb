"""Computes how far direction and size of motion can agree on a robot hand, whatever the map.

python studies/size_limit.py --hand allegro_right --people 6

The fingertips of synthetic people whom no training has seen are enlarged and moved into the robot's
workspace, p_BF = g p_HF + t: by one translation t for all fingers of a person, or by one for each finger.
Where thumb and finger touch and the robot's shall touch, too, the translations must be equal. The program
finds the translations with which the most fingertips are within the workspace, for several gains g.

The others would slide along the edge of the workspace. There, motion in random directions and its part along
a surface have a mean cosine of π/4, so the motion figure is 1 − (1 − π/4) times the fraction outside. The
workspace is that of random postures in cells of 4 mm; self-collision is ignored, and axes are not turned.
"""

import argparse
import math
from collections.abc import Sequence

import numpy as np
import torch
from scipy.ndimage import binary_closing
from scipy.optimize import differential_evolution
from universal_map import UNSEEN

from geort_drake.console import run_main
from geort_drake.hands.hand import Hand
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting.base import kinematics_of
from geort_drake.retargeting.kinematics import fingertips

GAINS = (0.9, 1.0, 1.2, 1.4)
CELL = 0.004  # m
POSTURES = 400_000
_LOST = 1 - math.pi / 4  # of the cosine, outside of the workspace


class Workspace:
    """The places that a robot's fingertip reaches.

    Args:
        p_BF: fingertips of random postures (N, 3), m.
    """

    def __init__(self, p_BF: np.ndarray):
        self.lower, self.upper = p_BF.min(axis=0), p_BF.max(axis=0)
        self._origin = self.lower - 5 * CELL
        cells = self._cells(p_BF)
        reached = np.zeros(cells.max(axis=0) + 6, dtype=bool)
        reached[tuple(cells.T)] = True
        self._reached = binary_closing(reached, iterations=2)  # cells that random postures missed

    def _cells(self, p_BF: np.ndarray) -> np.ndarray:
        return np.floor((p_BF - self._origin) / CELL).astype(int)

    def outside(self, p_BF: np.ndarray) -> float:
        """Returns the fraction of positions (N, 3), m, that are not reached."""
        cells = self._cells(p_BF)
        inside = ((cells >= 0) & (cells < self._reached.shape)).all(axis=1)
        inside[inside] = self._reached[tuple(cells[inside].T)]
        return 1.0 - inside.mean()


def least_outside(p_BF: np.ndarray, workspaces: Sequence[Workspace]) -> float:
    """Returns the least fraction of fingertips (T, F, 3), m, outside of F workspaces for any translation."""
    middle = p_BF.mean(axis=(0, 1))
    lower = np.min([workspace.lower for workspace in workspaces], axis=0) - middle
    upper = np.max([workspace.upper for workspace in workspaces], axis=0) - middle

    def outside(t: np.ndarray) -> float:
        fractions = [workspace.outside(p_BF[:, f] + t) for f, workspace in enumerate(workspaces)]
        return float(np.mean(fractions))

    bounds = list(zip(lower, upper, strict=True))
    return differential_evolution(outside, bounds, seed=0, tol=1e-6, maxiter=60, polish=False).fun


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hand", default="allegro_right")
    parser.add_argument("--people", type=int, default=6, help="number of synthetic people, 20 s each")
    arguments = parser.parse_args(argv)
    hand = Hand(arguments.hand)
    kinematics, description = kinematics_of(hand), hand.description
    postures = np.random.default_rng(0).uniform(
        kinematics.lower, kinematics.upper, (POSTURES, len(kinematics.lower))
    )
    tips = fingertips(kinematics, torch.from_numpy(postures)).numpy()
    workspaces = [Workspace(tips[:, finger]) for finger in range(tips.shape[1])]
    people = [
        sample_person(UNSEEN, number)
        .record(20.0, 30.0, description.side)
        .fingertips(description.human_keypoints)[::3]
        for number in range(arguments.people)
    ]
    print("| gain | one translation | one for each finger |\n|---|---|---|")
    for gain in GAINS:
        together = [least_outside(gain * p_HF, workspaces) for p_HF in people]
        apart = [
            least_outside(gain * p_HF[:, [finger]], [workspace])
            for p_HF in people
            for finger, workspace in enumerate(workspaces)
        ]
        motion = [1 - _LOST * np.mean(fractions) for fractions in (together, apart)]
        print(f"| {gain} | {motion[0]:.3f} | {motion[1]:.3f} |", flush=True)
    return 0


if __name__ == "__main__":
    run_main(main)

"""Finds human fingertips for a given robot posture, by gradients through the map."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.solvers import MathematicalProgram, Solve

from geort_drake import load_retargeter
from geort_drake.people.human_hand import HumanHand
from geort_drake.systems.retargeting_map import RetargetingMap

open_hand = HumanHand.anatomical().keypoints(np.zeros(20))
retarget = load_retargeter("allegro_right").for_person(open_hand)
tips = [4, 8, 12, 16]
systems = {float: RetargetingMap(retarget)}
systems[AutoDiffXd] = systems[float].ToAutoDiffXd()
contexts = {T: system.CreateDefaultContext() for T, system in systems.items()}


def positions(p_HF):
    """Returns joint positions (16,), rad, for twelve fingertip coordinates, m, as float or AutoDiffXd."""
    T = AutoDiffXd if p_HF.dtype == object else float
    keypoints = np.zeros((21, 3), dtype=p_HF.dtype) + p_HF[0] * 0
    keypoints[tips] = p_HF.reshape(4, 3)
    systems[T].get_input_port().FixValue(contexts[T], keypoints.ravel())
    return systems[T].get_output_port().Eval(contexts[T])


start = open_hand[tips].ravel()
target = positions(start + 0.005)

program = MathematicalProgram()
p_HF = program.NewContinuousVariables(12, "p_HF")
program.AddCost(lambda p: ((positions(p) - target) ** 2).sum(), vars=p_HF)
result = Solve(program, start)
error = np.abs(positions(result.GetSolution(p_HF)) - target).max()  # rad

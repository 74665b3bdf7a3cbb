"""Finds human fingertips for a given robot posture, by gradients through the map in a Drake system."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram, Solve
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from geort_drake import load_retargeter
from geort_drake.people.synthetic.hand import HumanHand


@TemplateSystem.define("RetargetingMap_", T_list=[float, AutoDiffXd])
def RetargetingMap_(T):
    class Impl(LeafSystem_[T]):
        """Maps fingertips p_HF (3F), m, to joint positions (n), rad, without memory, checks or limits."""

        def _construct(self, retarget, converter=None):
            super().__init__(converter=converter)
            self.retarget = retarget
            self.DeclareVectorInputPort("fingertips", 3 * len(retarget.finger_names))
            self.DeclareVectorOutputPort("positions", len(retarget.joint_names), self.calc)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other.retarget, converter=converter)

        def calc(self, context, output):
            p_HF = self.get_input_port().Eval(context)
            if T is AutoDiffXd:
                value = ExtractValue(p_HF).reshape(-1, 3)
                q, J = self.retarget(value), self.retarget.jacobian(value)
                gradient = J.reshape(len(q), -1) @ ExtractGradient(p_HF)
                output.SetFromVector(InitializeAutoDiff(q, gradient).ravel())
            else:
                output.SetFromVector(self.retarget(p_HF.reshape(-1, 3)))

    return Impl


open_hand = HumanHand.anatomical().keypoints(np.zeros(20))
retarget = load_retargeter("allegro_right").for_person(open_hand)
system = RetargetingMap_[float](retarget)
systems = {np.dtype(float): system, np.dtype(object): system.ToAutoDiffXd()}
contexts = {dtype: each.CreateDefaultContext() for dtype, each in systems.items()}


def positions(p_HF):
    """Returns joint positions (16,), rad, for twelve fingertip coordinates, m, as float or AutoDiffXd."""
    dtype, context = p_HF.dtype, contexts[p_HF.dtype]
    systems[dtype].get_input_port().FixValue(context, p_HF)
    return systems[dtype].get_output_port().Eval(context)


start = open_hand[list(retarget.human_keypoints)].ravel()
target = positions(start + 0.005)

program = MathematicalProgram()
p_HF = program.NewContinuousVariables(12, "p_HF")
program.AddCost(lambda p: ((positions(p) - target) ** 2).sum(), vars=p_HF)
program.AddBoundingBoxConstraint(start - 0.03, start + 0.03, p_HF)  # the map refuses other points
result = Solve(program, start)
error = np.abs(positions(result.GetSolution(p_HF)) - target).max()  # rad

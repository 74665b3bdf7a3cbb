"""The inverse kinematics of all planners: the most comfortable posture with fingertips at given places."""

from collections.abc import Iterable, Mapping

import numpy as np
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.solvers import SnoptSolver, SolverOptions
from pydrake.systems.framework import Context

from geort_drake.hands.description import HandDescription

# Fraction of its range that a joint keeps from either limit, to be able to squeeze.
_LIMIT_MARGIN = 0.1


class TipKinematics:
    """Finds postures of a hand in a plant; all positions q are those of the plant, rad.

    Attributes:
        index: joint of the hand → its index in q.
        low, high: limits of q.

    Args:
        context: the plant's context, in which programs compute.
        model: the hand's model in the plant.
    """

    def __init__(
        self, plant: MultibodyPlant, context: Context, description: HandDescription, model: ModelInstanceIndex
    ):
        self.plant, self.context, self.description, self.model = plant, context, description, model
        joints = map(plant.get_joint, plant.GetJointIndices(model))
        self.index = {joint.name(): joint.position_start() for joint in joints if joint.num_positions()}
        self.low, self.high = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()

    def program(
        self,
        frame: Frame,
        places: Mapping[str, tuple[np.ndarray, np.ndarray]],
        weight: np.ndarray,
        q_comfortable: np.ndarray,
    ) -> InverseKinematics:
        """Returns a program for q, which may get further constraints before `solve`.

        Args:
            places: finger → lowest and highest coordinates (3,) of its fingertip point in `frame`, m.
            weight: (q,) weights of the squared distances from `q_comfortable`, the discomfort that `solve`
                minimises; followers follow and have none.
        """
        ik = InverseKinematics(self.plant, self.context)
        for finger in self.description.fingers:
            if finger.name in places:
                tip = self.plant.GetBodyByName(finger.tip_link, self.model).body_frame()
                point = np.asarray(finger.tip_point, float)
                ik.AddPositionConstraint(tip, point, frame, *places[finger.name])
        weight = weight.copy()
        for c in self.description.followers:
            weight[self.index[c.joint]] = 0.0  # it follows its leader, which has a weight
            difference = ik.q()[self.index[c.joint]] - c.ratio * ik.q()[self.index[c.follows]]
            ik.get_mutable_prog().AddLinearEqualityConstraint(difference == c.offset)
        ik.get_mutable_prog().AddQuadraticErrorCost(np.diag(weight), q_comfortable, ik.q())
        return ik

    def keep_from_limits(self, ik: InverseKinematics, joints: Iterable[str]) -> None:
        """Constrains joints to a margin from their limits."""
        for index in map(self.index.__getitem__, joints):
            low, high = self.low[index], self.high[index]
            margin = _LIMIT_MARGIN * (high - low)
            ik.get_mutable_prog().AddBoundingBoxConstraint(low + margin, high - margin, ik.q()[index])


def solve(ik: InverseKinematics, guess: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Returns discomfort and positions of the posture near a guess, or None if none is found."""
    # A solution takes about 30 iterations; a guess that needs many more rarely leads to one.
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major iterations limit", 60)
    options.SetOption(SnoptSolver.id(), "Iterations limit", 1000)
    result = SnoptSolver().Solve(ik.prog(), guess, options)
    return (result.get_optimal_cost(), result.GetSolution(ik.q())) if result.is_success() else None

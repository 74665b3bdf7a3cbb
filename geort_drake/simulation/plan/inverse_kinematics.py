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


def position_index(plant: MultibodyPlant, joint: str, model: ModelInstanceIndex) -> int:
    """Returns the index of a joint in the plant's positions."""
    return plant.GetJointByName(joint, model).position_start()


def tip_program(
    plant: MultibodyPlant,
    context: Context,
    description: HandDescription,
    hand: ModelInstanceIndex,
    frame: Frame,
    places: Mapping[str, tuple[np.ndarray, np.ndarray]],
    weight: np.ndarray,
    q_comfortable: np.ndarray,
) -> InverseKinematics:
    """Returns a program for the plant's positions q, which may get further constraints before `solve`.

    Args:
        context: the plant's context, in which the program computes.
        places: finger → lowest and highest coordinates (3,) of its fingertip point in `frame`, m.
        weight: (q,) weights of the squared distances from `q_comfortable`, the discomfort that `solve`
            minimises; followers follow and have none.
    """
    ik = InverseKinematics(plant, context)
    for finger in description.fingers:
        if finger.name in places:
            tip = plant.GetBodyByName(finger.tip_link, hand).body_frame()
            ik.AddPositionConstraint(tip, np.asarray(finger.tip_point, float), frame, *places[finger.name])
    weight = weight.copy()
    for c in description.followers:
        index = position_index(plant, c.joint, hand)
        weight[index] = 0.0  # it follows its leader, which has a weight
        difference = ik.q()[index] - c.ratio * ik.q()[position_index(plant, c.follows, hand)]
        ik.get_mutable_prog().AddLinearEqualityConstraint(difference == c.offset)
    ik.get_mutable_prog().AddQuadraticErrorCost(np.diag(weight), q_comfortable, ik.q())
    return ik


def keep_from_limits(
    ik: InverseKinematics, indices: Iterable[int], low: np.ndarray, high: np.ndarray
) -> None:
    """Constrains joints to a margin from their limits, rad; all arrays have the order of the positions."""
    for index in indices:
        margin = _LIMIT_MARGIN * (high[index] - low[index])
        ik.get_mutable_prog().AddBoundingBoxConstraint(
            low[index] + margin, high[index] - margin, ik.q()[index]
        )


def solve(ik: InverseKinematics, guess: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Returns discomfort and positions of the posture near a guess, or None if none is found."""
    # A solution takes about 30 iterations; a guess that needs many more rarely leads to one.
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major iterations limit", 60)
    options.SetOption(SnoptSolver.id(), "Iterations limit", 1000)
    result = SnoptSolver().Solve(ik.prog(), guess, options)
    return (result.get_optimal_cost(), result.GetSolution(ik.q())) if result.is_success() else None

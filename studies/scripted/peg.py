"""The scripted robot of the peg."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.analysis import Simulator

from geort_drake.people.recording import Recording
from geort_drake.simulation.diagram import make_trial_diagram
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import peg
from geort_drake.simulation.trial import run_trial
from geort_drake.systems.port_values import vector_to_pose
from scripted.oracle import HOLDING, Oracle, oracle, script
from scripted.pick_place import plans

__all__ = ["plans", "scripted"]

SQUEEZE = 0.02  # m, depth of the squeeze


def scripted(scenario: Scenario, goal: GraspGoal, seed: int) -> float:
    """Returns the score of a robot that knows dowel and hole and carries out the plan; 0 without success.

    A first run ends with the lift and gives the dowel's pose in the hand.
    """
    transfer, robot = peg.TRANSFER, oracle(scenario.hand)
    scenario.random_seed = seed
    squeeze = SQUEEZE
    X_WB, X_WO = _lifted(scenario, robot, script(scenario, robot, goal, squeeze))
    X_WP = transfer.place(scenario, robot.description.side, np.random.default_rng(seed))
    R_WO = RotationMatrix.MakeZRotation(RollPitchYaw(X_WO.rotation()).yaw_angle())  # upright
    X_BO = X_WB.inverse() @ X_WO
    above = RigidTransform(R_WO, X_WP.translation()) @ X_BO.inverse() @ goal.X_OB.inverse()
    result, _ = run_trial(scenario, robot, script(scenario, robot, goal, squeeze, (above, transfer.hover)))
    return result.score if result.success else 0.0


def _lifted(scenario: Scenario, robot: Oracle, motion: Recording) -> tuple[RigidTransform, RigidTransform]:
    """Returns X_WB and X_WO after the lift."""
    parts = make_trial_diagram(scenario, robot, motion)
    simulator = Simulator(parts.diagram)
    root = simulator.get_mutable_context()
    parts.initialize(root)
    robot.reset()
    simulator.AdvanceTo(float(motion.t[-1]) - HOLDING)
    view = parts.diagram.GetSubsystemByName("scene_view")
    context = view.GetMyContextFromRoot(root)
    X_WB, X_WO = (
        vector_to_pose(view.GetOutputPort(name).Eval(context)) for name in ("hand_pose", "object_pose")
    )
    return X_WB, X_WO

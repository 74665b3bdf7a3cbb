"""Plans grasps for described hands, and checks whether a scripted oracle can carry them out.

python studies/plans.py allegro_right leap_right my_hand.yaml --json plans.json

The oracle knows where the object is. It moves the hand along the plan, brings the fingertips to the planned
contacts by inverse kinematics, squeezes and lifts. It tries the plans of an object one after another, with
the scenario's physics and monitor, and without corrections.
"""

import argparse
import json
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.console import print_table, say
from geort_drake.errors import ScenarioError
from geort_drake.files import write_text
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.resources import object_names
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.simulation.object_shape import object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.trial import run_trial
from geort_drake.simulation.world import HAND, add_object, add_robot, draw_placement
from geort_drake.simulation.wrist_motion import WristMovement, minimum_jerk
from geort_drake.systems.port_values import pose_to_vector

RATE = 50.0  # Hz, rate of the script
# Ends of the first two parts of the script, and durations of the others, s: the hand reaches its waiting
# pose, reaches the object, closes (longer if its joints are slow), squeezes, lifts and holds.
WAITING, THERE = 2.0, 3.5
CLOSING, SQUEEZING, LIFTING, HOLDING = 1.0, 0.5, 1.0, 3.5
CARRYING = 1.5  # s, duration of carrying the object above its place, and of lowering it
DEPTH, HEIGHT = 0.03, 0.15  # m, depth of the squeeze and height of the lift
ITERATIONS, LARGEST_STEP, DAMPING = 10, 0.1, 5e-3  # of inverse kinematics; steps in rad, damping in m/rad


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("hands", nargs="+", help="names or files of hand descriptions")
    parser.add_argument("--objects", nargs="+", default=object_names())
    parser.add_argument("--scenario", default="Grasp", help="name of the scenario (default: %(default)s)")
    parser.add_argument("--plans", type=int, default=6, help="most plans per object (default: %(default)s)")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(argv)
    logging.getLogger("drake").setLevel(logging.ERROR)
    rows = []
    for name in arguments.hands:
        oracle = Oracle(HandModel(name))
        for object_name in arguments.objects:
            scenario = load_scenario(name=arguments.scenario, hand=name)
            scenario.object.name = object_name
            row = {
                "hand": oracle.description.name,
                "object": object_name,
                **_try(scenario, oracle, arguments.plans),
            }
            rows.append(row)
            say(f"{row['hand']} {object_name}: {_mark(row)} ({', '.join(row['outcomes'])})")
            if arguments.json:
                write_text(arguments.json, json.dumps(rows, indent=2) + "\n")
    hands = list(dict.fromkeys(row["hand"] for row in rows))
    marks = {(row["hand"], row["object"]): _mark(row) for row in rows}
    table = [(name, *(marks[hand, name] for hand in hands)) for name in arguments.objects]
    for text, counted in (("planned", "plans"), ("held", "held")):
        numbers = (sum(row[counted] > 0 for row in rows if row["hand"] == hand) for hand in hands)
        table.append((text, *(f"{number} of {len(arguments.objects)}" for number in numbers)))
    print_table(("object", *hands), table, "the first plan that the oracle held, of the plans found")


class Oracle:
    """Inverse kinematics in place of a retargeter: keypoints are the robot's target fingertips in B."""

    def __init__(self, hand: HandModel):
        self.description, self.joint_names = hand.description, hand.joint_names
        self._hand = NumpyKinematics(hand.kinematics())
        # Not the default posture, whose straight fingers are singular.
        self._start = 0.5 * (hand.lower + hand.upper)
        joints = [hand.plant.GetJointByName(name, hand.instance) for name in hand.joint_names]
        self.speed = np.array([joint.velocity_upper_limit() for joint in joints])
        self.reset()

    def reset(self) -> None:
        self._q = self._start

    def closing_time(self, p_BF_open: np.ndarray, p_BF_touch: np.ndarray) -> float:
        """Returns the duration of a minimum-jerk movement of the joints between fingertip positions, s."""
        q_open = self._solve(self._start, p_BF_open, 100)
        q_touch = self._solve(q_open, p_BF_touch, 100)
        # The movement peaks at 15/8 of its mean speed.
        return max(CLOSING, float((1.875 * np.abs(q_touch - q_open) / self.speed).max()))

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        targets = np.asarray(p_HK, float)[self.description.human_keypoints]
        self._q = self._solve(self._q, targets, ITERATIONS)
        return self._q

    def _solve(self, q: np.ndarray, targets: np.ndarray, iterations: int) -> np.ndarray:
        n = len(q)
        for _ in range(iterations):
            tips, J = self._hand.fingertips_and_jacobians(q[None])
            J = J.reshape(-1, n)
            step = J.T @ np.linalg.solve(J @ J.T + DAMPING**2 * np.eye(len(J)), (targets - tips[0]).ravel())
            q = np.clip(q + np.clip(step, -LARGEST_STEP, LARGEST_STEP), self._hand.lower, self._hand.upper)
        return q


def _try(scenario: Scenario, oracle: Oracle, most: int) -> dict:
    """Returns the number of plans, that of the first with a successful hold from 1 or 0, and outcomes."""
    try:
        goals = GraspPlanner(scenario, oracle.description).plans(most)
    except ScenarioError as error:
        return {"plans": 0, "held": 0, "outcomes": [str(error)]}
    # Of the openings of a grasp, the oracle uses the first, with the nearest thumb.
    grasps = {goal.X_OB.GetAsMatrix4().tobytes(): goal for goal in reversed(goals)}
    plans = list(grasps.values())[::-1]
    outcomes: list[str] = []
    for goal in plans:
        recording = script(scenario, oracle, goal)
        scenario.timeout = float(recording.t[-1])
        result, _ = run_trial(scenario, oracle, recording)
        outcomes.append(result.outcome)
        if result.success:
            break
    return {"plans": len(plans), "held": len(outcomes) * (outcomes[-1] == "success"), "outcomes": outcomes}


def script(
    scenario: Scenario,
    oracle: Oracle,
    goal: GraspGoal,
    squeeze: float = DEPTH,
    place: tuple[RigidTransform, float] | None = None,
) -> Recording:
    """Returns the oracle's motion for the object as the scenario's seed places it.

    Args:
        squeeze: depth of the squeeze, m.
        place: pose X_WP to which to bring the frame O of the goal after the lift, and the height above it
            from which to lower it, m.
    """
    X_WO = goal.object_frame(object_pose(scenario))
    X_start = _start_pose(scenario, oracle)
    X_before, X_WB = X_WO @ goal.X_OB_before, X_WO @ goal.X_OB
    X_BO = goal.X_OB.inverse()
    touching, inwards = X_BO.multiply(goal.p_OF_touch.T).T, goal.n_OF @ X_BO.rotation().matrix().T
    touching[~goal.touches] = goal.p_BF_open[~goal.touches]
    closed = THERE + oracle.closing_time(goal.p_BF_open, touching)
    squeezed = closed + SQUEEZING
    movements = [
        WristMovement(X_start, X_before, 0.0, WAITING - 0.5),
        WristMovement(X_before, X_WB, WAITING, THERE - WAITING - 0.5),
        WristMovement(X_WB, RigidTransform([0, 0, HEIGHT]) @ X_WB, squeezed, LIFTING),
    ]
    end, opening = squeezed + LIFTING + HOLDING, np.inf
    if place is not None:
        X_WP, hover = place
        X_above = RigidTransform([0, 0, hover]) @ X_WP
        opening = squeezed + LIFTING + 2 * CARRYING
        movements += [
            WristMovement(movements[-1].X_end, X_above @ goal.X_OB, squeezed + LIFTING, CARRYING - 0.5),
            WristMovement(X_above @ goal.X_OB, X_WP @ goal.X_OB, opening - CARRYING, CARRYING - 0.5),
            WristMovement(X_WP @ goal.X_OB, X_WP @ goal.X_OB_before, opening + CLOSING + 0.3, LIFTING),
        ]
        end = opening + CLOSING + LIFTING + 1.0
    t = np.arange(0.0, end, 1 / RATE)
    keypoints, poses = np.zeros((len(t), 21, 3)), []
    for number, time in enumerate(t):
        opened = minimum_jerk((time - opening) / CLOSING)
        share = minimum_jerk((time - THERE) / (closed - THERE)) * (1 - opened)
        depth = squeeze * minimum_jerk((time - closed) / SQUEEZING) * (1 - opened)
        p_BF = goal.p_BF_open + share * (touching - goal.p_BF_open) + depth * inwards
        keypoints[number, oracle.description.human_keypoints] = p_BF
        begun = [movement for movement in movements if time >= movement.t_start]
        poses.append(pose_to_vector(begun[-1].pose(time)))
    return Recording(t, keypoints, np.full(len(t), True), np.array(poses), {"side": oracle.description.side})


def object_pose(scenario: Scenario) -> RigidTransform:
    """Returns X_WO of the object as the seed places it."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    body = add_object(plant, scenario.object.name)
    lowest = object_shape(plant, scene_graph.model_inspector(), body).lowest_point(RigidTransform())
    return draw_placement(scenario, lowest, np.random.default_rng(scenario.random_seed)).X_WO


def _start_pose(scenario: Scenario, oracle: Oracle) -> RigidTransform:
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.0)
    add_robot(plant, scenario, oracle.description)
    plant.Finalize()
    base = plant.GetFrameByName(oracle.description.base_frame, plant.GetModelInstanceByName(HAND))
    return base.CalcPoseInWorld(plant.CreateDefaultContext())


def _mark(row: dict) -> str:
    held = f"held by plan {row['held']}" if row["held"] else "not held"
    return f"{held} of {row['plans']}" if row["plans"] else "no plan"


if __name__ == "__main__":
    main()

"""The task of the cap: its places, its thread and brake, its judgement and its people."""

import numpy as np
import pytest
from grasp_setup import allegro
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from task_bench import plans

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.tasks.cap.goal import RADIUS
from geort_drake.simulation.tasks.cap.monitor import CapOutcome
from geort_drake.simulation.tasks.cap.planner import GAP, SQUEEZE
from geort_drake.simulation.world import actuated_joints

UP = np.array([-1.0, 0.0, 0.0])  # of the bottle, for a hand base with the world's axes


def test_every_plan_moves_three_fingertips_around_the_cap():
    hand = allegro()
    for plan in plans("cap"):
        goal = plan.goal
        turns = np.linspace(0.0, goal.stroke, len(plan.q_open))
        assert goal.stroke > np.deg2rad(39)
        for turn, q_open, q_held in zip(turns, plan.q_open, plan.q_held, strict=True):
            off = (goal.fingertips(turn, 0.0) - goal.p_BC)[goal.touches]
            np.testing.assert_allclose(np.linalg.norm(off, axis=1), RADIUS + hand.tip_radius, atol=1e-9)
            for q, depth in ((q_open, -GAP), (q_held, SQUEEZE)):
                wanted = goal.fingertips(turn, depth)[goal.touches]
                np.testing.assert_allclose(hand.fingertips(q)[goal.touches], wanted, atol=2e-3)


def test_the_mirror_turns_the_other_way():
    goal = plans("cap")[0].goal
    seen = goal.mirrored()
    for share in (0.0, 0.4, 1.0):
        np.testing.assert_allclose(
            seen.fingertips(share * seen.stroke, 0.003), mirrored(goal.fingertips(share * goal.stroke, 0.003))
        )


def after(torque: float) -> tuple[float, float, CapOutcome]:
    """Turn, rad, and rise, m, of a cap after half a second of a torque, N m, and how it is judged."""
    task, builder = find_task("cap"), DiagramBuilder()
    scenario = load_scenario(*task.scenario, "{task_settings: {turn: 45}}")
    rng = np.random.default_rng(0)
    goal, X_WB = plans("cap")[0].goal, RigidTransform([0, 0, 1.0])
    stage = task.add_stage(builder, scenario, allegro().description, goal, X_WB, rng)
    plant = stage.scene.plant
    thread = plant.GetJointByName("thread")
    forces = np.zeros(plant.num_velocities())
    forces[thread.velocity_start()] = torque
    sources = {plant.get_applied_generalized_force_input_port(): forces}
    for model in (stage.scene.hand, stage.scene.arm):
        q = [joint.default_positions()[0] for joint in actuated_joints(plant, model)]
        sources[plant.get_desired_state_input_port(model)] = np.concatenate([q, np.zeros(len(q))])
    for port, value in sources.items():
        builder.Connect(builder.AddSystem(ConstantVectorSource(value)).get_output_port(), port)
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    height = plant.GetBodyByName("cap").EvalPoseInWorld(plant.GetMyContextFromRoot(root)).translation() @ UP
    simulator.AdvanceTo(0.5)
    context = plant.GetMyContextFromRoot(root)
    rise = plant.GetBodyByName("cap").EvalPoseInWorld(context).translation() @ UP - height
    outcome = stage.monitor.outcome(stage.monitor.GetMyContextFromRoot(root))
    return plant.GetPositions(context)[thread.position_start()], rise, outcome


def test_the_thread_rises_and_its_brake_holds_up_to_its_torque():
    """30 mN m ± 20 %."""
    still, _, outcome = after(0.02)
    assert abs(still) < np.deg2rad(1) and outcome.score < 0.03 and not outcome.over
    turned, rise, outcome = after(0.04)
    assert turned > np.deg2rad(45) and rise == pytest.approx(0.004 * turned / (2 * np.pi), rel=1e-6)
    assert outcome.success and outcome.over and outcome.score == 1.0 and outcome.completion_time < 0.5

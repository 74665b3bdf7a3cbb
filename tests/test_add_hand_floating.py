"""A hand without an arm: the base of the scenario `Floating` follows the wrist, that of `Fixed` stays."""

import dataclasses as dc

import numpy as np
import pytest
from grasp_setup import Constant, allegro, resting_glove, started
from pydrake.math import RigidTransform, RollPitchYaw

from geort_drake.cli import run_command
from geort_drake.errors import ScenarioError
from geort_drake.people.play import synthesize_play
from geort_drake.simulation.diagram import make_trial_diagram
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.world import HAND
from geort_drake.systems.port_values import pose_to_vector


def moved(name: str) -> tuple[RigidTransform, RigidTransform, float]:
    """The hand base before and after a motion of the wrist, and the largest motion of a joint, rad."""
    glove = resting_glove(1.5)
    part = np.clip(glove.t / 0.8, 0.0, 1.0)
    wrist = [RigidTransform(RollPitchYaw(0, 0, 0.3 * s), [0, 0.05 * s, 0.05 * s]) for s in part]
    glove = dc.replace(glove, X_WH=np.array([pose_to_vector(X) for X in wrist]))
    middle = Constant(q=0.5 * (allegro().lower + allegro().upper))
    parts = make_trial_diagram(load_scenario(name=name), middle, glove)
    simulator = started(parts)
    hand = parts.plant.GetModelInstanceByName(HAND)
    base = parts.plant.GetFrameByName("base_link", hand)
    context = parts.plant.GetMyContextFromRoot(simulator.get_context())
    before, q = base.CalcPoseInWorld(context), parts.plant.GetPositions(context, hand)
    simulator.AdvanceTo(1.5)
    joints = np.abs(parts.plant.GetPositions(context, hand) - q).max()
    return before, base.CalcPoseInWorld(context), joints


def test_the_floating_base_carries_the_hand_after_the_wrist():
    """5 cm up and to the side, and 0.3 rad about the vertical, to 2 mm and 0.02 rad."""
    before, after, _ = moved("Floating")
    np.testing.assert_allclose(after.translation() - before.translation(), [0, 0.05, 0.05], atol=0.002)
    turned = after.rotation() @ before.rotation().inverse()
    wanted = RollPitchYaw(0, 0, 0.3).ToRotationMatrix()
    np.testing.assert_allclose(turned.matrix(), wanted.matrix(), atol=0.02)


def test_on_a_fixed_base_only_the_fingers_move():
    """The base does not move at all with the wrist; the fingers follow."""
    before, after, joints = moved("Fixed")
    assert after.IsExactlyEqualTo(before) and joints > 0.2


def test_a_replay_without_wrist_poses_needs_a_fixed_base(tmp_path):
    """And a fixed base needs a replay."""
    play = synthesize_play(seed=0, duration_s=2.0, rate_hz=60.0)
    play.save(tmp_path / "play.npz")
    words = ["--output", str(tmp_path / "out"), "--objects", "cube"]
    with pytest.raises(ScenarioError, match=r"play\.npz: .* needs wrist poses .* --scenario-name Fixed"):
        run_command("grasp", [*words, "--replay", str(tmp_path / "play.npz")])
    with pytest.raises(ScenarioError, match="scenario 'Fixed': the operator cannot grasp with a fixed base"):
        run_command("grasp", [*words, "--scenario-name", "Fixed"])

"""A hand without an arm: the base of the scenario `Floating` follows the wrist, that of `Fixed` stays."""

import dataclasses as dc

import numpy as np
import pytest
from grasp_setup import Constant, allegro, started
from pydrake.math import RigidTransform, RollPitchYaw

from geort_drake.cli import run_command
from geort_drake.errors import ScenarioError
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.simulation.diagram import make_grasp_diagram
from geort_drake.simulation.scenario import load_scenario
from geort_drake.simulation.world import HAND
from geort_drake.systems.port_values import pose_to_vector


def test_the_floating_base_carries_the_hand_after_the_wrist():
    """5 cm up and to the side, and 0.3 rad about the vertical, to 2 mm and 0.02 rad."""
    play = synthesize_play(seed=0, duration_s=1.5, rate_hz=60.0)
    part = np.clip(play.t / 0.8, 0.0, 1.0)
    wrist = [RigidTransform(RollPitchYaw(0, 0, 0.3 * s), [0, 0.05 * s, 0.05 * s]) for s in part]
    moving = dc.replace(play, X_WH=np.array([pose_to_vector(X) for X in wrist]))
    parts = make_grasp_diagram(load_scenario(name="Floating"), Constant(), moving)
    simulator = started(parts)
    root = simulator.get_context()
    base = parts.plant.GetFrameByName("base_link", parts.plant.GetModelInstanceByName(HAND))
    context = parts.plant.GetMyContextFromRoot(root)
    before = base.CalcPoseInWorld(context)
    simulator.AdvanceTo(1.5)
    after = base.CalcPoseInWorld(context)
    np.testing.assert_allclose(after.translation() - before.translation(), [0, 0.05, 0.05], atol=0.002)
    turned = after.rotation() @ before.rotation().inverse()
    np.testing.assert_allclose(
        turned.matrix(), RollPitchYaw(0, 0, 0.3).ToRotationMatrix().matrix(), atol=0.02
    )


class _Closing:
    """Closes the hand as far as the person's index finger."""

    def __init__(self, hand: HandModel):
        self.joint_names, self._hand = hand.joint_names, hand

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        share = np.clip(1.0 - 5.0 * np.asarray(p_HK)[8, 2], 0.1, 0.9)
        return self._hand.lower + share * (self._hand.upper - self._hand.lower)


def test_on_a_fixed_base_only_the_fingers_move():
    """The base does not move at all with the wrist; the fingers follow the recording."""
    play = synthesize_play(seed=0, duration_s=0.5, rate_hz=60.0)
    wrist = np.array([pose_to_vector(RigidTransform([0, 0, 0.2 * t])) for t in play.t])
    parts = make_grasp_diagram(load_scenario(name="Fixed"), _Closing(allegro()), dc.replace(play, X_WH=wrist))
    simulator = started(parts)
    root = simulator.get_context()
    model = parts.plant.GetModelInstanceByName(HAND)
    base = parts.plant.GetFrameByName("base_link", model)
    context = parts.plant.GetMyContextFromRoot(root)
    before, q = base.CalcPoseInWorld(context), parts.plant.GetPositions(context, model)
    simulator.AdvanceTo(0.5)
    assert base.CalcPoseInWorld(context).IsExactlyEqualTo(before)
    assert np.abs(parts.plant.GetPositions(context, model) - q).max() > 0.2


def test_a_replay_without_wrist_poses_needs_a_fixed_base(tmp_path):
    """And a fixed base needs a replay."""
    play = synthesize_play(seed=0, duration_s=2.0, rate_hz=60.0)
    play.save(tmp_path / "play.npz")
    words = ["--output", str(tmp_path / "out"), "--objects", "cube"]
    with pytest.raises(ScenarioError, match=r"play\.npz: .* needs wrist poses .* --scenario-name Fixed"):
        run_command("grasp", [*words, "--replay", str(tmp_path / "play.npz")])
    with pytest.raises(ScenarioError, match="scenario 'Fixed': the operator cannot grasp with a fixed base"):
        run_command("grasp", [*words, "--scenario-name", "Fixed"])

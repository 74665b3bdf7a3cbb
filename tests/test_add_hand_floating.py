"""A hand without an arm: the floating base of the scenario `Floating` follows the wrist as an arm does."""

import dataclasses as dc

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from geort_drake.gloves.play import synthesize_play
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.simulation.diagram import make_grasp_diagram
from geort_drake.simulation.scenario import load_scenario
from geort_drake.simulation.world import HAND
from geort_drake.systems.poses import pose_to_vector


class _Still:
    """Keeps the hand as it starts."""

    def __init__(self, hand: HandModel):
        self.joint_names, self._q = hand.joint_names, hand.default_position

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        return self._q


def test_the_floating_base_carries_the_hand_after_the_wrist():
    """5 cm up and to the side, and 0.3 rad about the vertical, to 2 mm and 0.02 rad."""
    play = synthesize_play(seed=0, duration_s=1.5, rate_hz=60.0)
    part = np.clip(play.t / 0.8, 0.0, 1.0)
    wrist = [RigidTransform(RollPitchYaw(0, 0, 0.3 * s), [0, 0.05 * s, 0.05 * s]) for s in part]
    moving = dc.replace(play, X_WH=np.array([pose_to_vector(X) for X in wrist]))
    retarget = _Still(HandModel(load_hand("allegro_right")))
    parts = make_grasp_diagram(load_scenario(name="Floating"), retarget, moving)
    simulator = Simulator(parts.diagram)
    root = simulator.get_mutable_context()
    parts.initialize(root)
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

"""The exact hand model: fingertips, kinematics, contacts and digest."""

import numpy as np
import pytest
import torch
from model_scene import SHIPPED_HANDS

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.description import load_hand
from geort_drake.hands.importers.checks import nearest_pinch
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics


def _uniform(hand: HandModel, rng, count: int) -> np.ndarray:
    return rng.uniform(hand.lower, hand.upper, (count, len(hand.joint_names)))


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_shipped_hands_start_free_and_pinch(name):
    """No self-collision at the start; the thumb's tip reaches every other one."""
    hand = HandModel(load_hand(name))
    assert not hand.collides(hand.default_position)
    kinematics = NumpyKinematics(hand.kinematics())
    for number in range(1, len(hand.finger_names)):
        assert nearest_pinch(kinematics, number) < 1.8 * hand.tip_radius


def test_a_mirrored_left_hand_equals_the_right_one(allegro, rng):
    """In the mirror, kinematics, wrist and collision shapes of a left hand are those of the right one."""
    left = HandModel(load_hand("allegro_left"))
    q = torch.tensor(_uniform(allegro, rng, 20))
    ours, theirs = left.kinematics().mirrored(), allegro.kinematics()
    torch.testing.assert_close(ours.fingertips(q), theirs.fingertips(q), rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.p_BW, theirs.p_BW, atol=1e-12)
    ours, theirs = collision_shapes(left).mirrored(), collision_shapes(allegro)
    for field in ("joint", "half", "radius", "pairs"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    np.testing.assert_allclose(ours.X_JS, theirs.X_JS, atol=1e-12)


def test_the_mount_is_the_wrist_and_not_part_of_the_hand(allegro_copy):
    """It defines the wrist, is optional, and does not change the digest."""
    facts, load = allegro_copy
    mounted = HandModel(load())
    np.testing.assert_allclose(mounted.p_BW, [0, 0, -0.095], atol=1e-12)
    del facts["mount"]
    bare = HandModel(load())
    np.testing.assert_array_equal(bare.p_BW, np.zeros(3))
    assert bare.digest == mounted.digest


def test_torch_kinematics_agree_with_drake(allegro, rng):
    """The serial chains give Drake's fingertips to 1e-9 m."""
    q = _uniform(allegro, rng, 300)
    tips = allegro.kinematics().fingertips(torch.tensor(q))
    np.testing.assert_allclose(tips.numpy(), allegro.fingertips(q), atol=1e-9)


def test_kinematics_survive_an_offset_base_and_welded_links(allegro_copy, rng, tmp_path):
    """With a base frame away from its link, and a tip on a welded link, they still agree."""
    facts, load = allegro_copy
    sdf = tmp_path / "hand.sdf"
    extra = """
    <frame name="tilted_base" attached_to="base_link"><pose>0.01 -0.02 0.03 0.3 -0.2 0.5</pose></frame>
    <link name="nail">
      <pose relative_to="index_tip">0.001 0.002 0.003 0.1 0.2 0.3</pose>
      <inertial><mass>0.001</mass></inertial>
    </link>
    <joint name="nail_weld" type="fixed"><parent>link_3</parent><child>nail</child></joint>
  </model>"""
    sdf.write_text(sdf.read_text(encoding="utf-8").replace("  </model>", extra), encoding="utf-8")
    facts["base_frame"] = "tilted_base"
    facts["fingers"][1].update(tip_link="nail", tip_point=[0.004, -0.003, 0.002])
    hand = HandModel(load())
    q = _uniform(hand, rng, 50)
    tips = hand.kinematics().fingertips(torch.tensor(q))
    np.testing.assert_allclose(tips.numpy(), hand.fingertips(q), atol=1e-9)


def test_one_configuration_and_a_batch_give_the_same(allegro, rng):
    """Single rows and batches agree in value; their shapes follow the input's."""
    q = _uniform(allegro, rng, 5)
    assert allegro.fingertips(q).shape == (5, 4, 3)
    np.testing.assert_array_equal(allegro.fingertips(q[2]), allegro.fingertips(q)[2])
    assert allegro.collides(q).shape == (5,)
    assert np.ndim(allegro.collides(q[2])) == 0
    for bad in (q[:, :15], q[None], np.full(16, np.nan)):
        with pytest.raises(ValueError, match="q "):
            allegro.fingertips(bad)


def test_contacts_between_tips_are_distinguished(allegro, rng):
    """Labels agree with penetrations at every sample."""
    q = _uniform(allegro, rng, 400)
    collides, beyond = allegro.collides(q), allegro.collides_beyond_tips(q)
    kinds = set()
    for row, any_contact, beyond_tips in zip(q, collides, beyond, strict=True):
        contacts = allegro.penetrations(row)
        assert any_contact == bool(contacts)
        assert beyond_tips == any(not tip_tip for *_, tip_tip in contacts)
        assert [depth for depth, *_ in contacts] == sorted((c[0] for c in contacts), reverse=True)
        kinds.update(tip_tip for *_, tip_tip in contacts)
    assert kinds == {True, False}


def test_a_joint_that_no_finger_lists_is_held_at_its_default(allegro_copy, rng):
    """The finger has one joint less, and moves like the whole one with that joint at this angle."""
    facts, load = allegro_copy
    whole = HandModel(load())
    facts["fingers"][1]["joints"].remove("joint_0")
    facts["default_positions"]["joint_0"] = 0.2
    hand = HandModel(load())
    q = _uniform(hand, rng, 20)
    np.testing.assert_allclose(hand.kinematics().fingertips(torch.tensor(q)), hand.fingertips(q), atol=1e-9)
    at = whole.joint_names.index("joint_0")
    np.testing.assert_allclose(whole.fingertips(np.insert(q, at, 0.2, axis=1)), hand.fingertips(q), atol=1e-9)

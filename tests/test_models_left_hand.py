"""The left Allegro hand in models/sdf: the right one's mirror image."""

import numpy as np
import pytest
from pydrake.multibody.tree import BodyIndex

from geort_drake.errors import HandError
from geort_drake.hands.mirror import left_sdf
from geort_drake.resources import models_dir


def test_left_allegro_is_made_from_the_right_one():
    """The committed file equals the output of `left_sdf`."""
    folder = models_dir() / "sdf"
    made = left_sdf((folder / "allegro_right.sdf").read_text(encoding="utf-8"))
    assert (folder / "allegro_left.sdf").read_text(encoding="utf-8") == made


def test_models_that_cannot_be_mirrored_are_refused():
    """For meshes, other units, and other names than a right hand's."""
    text = (models_dir() / "sdf" / "allegro_right.sdf").read_text(encoding="utf-8")
    for change, message in (
        (("<sphere>", "<mesh>"), "<mesh"),
        (("<pose>0 0", '<pose degrees="true">0 0'), "degrees="),
        (('name="allegro_right"', 'name="allegro"'), "ends in '_right'"),
        (("<xyz>0 0 1<", "<xyz>0 1<"), "'0 1' must be 3 numbers"),
    ):
        with pytest.raises(HandError, match=message):
            left_sdf(text.replace(*change))


def test_left_allegro_moves_as_the_mirror_image(allegro, allegro_left, rng):
    """With equal limits; at equal angles every body has the reflected pose, to 1e-9."""
    np.testing.assert_array_equal(allegro_left.lower, allegro.lower)
    np.testing.assert_array_equal(allegro_left.upper, allegro.upper)
    assert allegro_left.joint_names == allegro.joint_names
    M = np.diag([1.0, -1.0, 1.0, 1.0])
    hands, contexts = (allegro, allegro_left), []
    for hand in hands:
        contexts.append(hand.plant.GetMyMutableContextFromRoot(hand.diagram.CreateDefaultContext()))
    for q in rng.uniform(allegro.lower, allegro.upper, (50, 16)):
        for hand, context in zip(hands, contexts, strict=True):
            for name, angle in zip(hand.joint_names, q, strict=True):
                hand.plant.GetJointByName(name).set_angle(context, angle)
        for index in range(1, allegro.plant.num_bodies()):
            name = allegro.plant.get_body(BodyIndex(index)).name()
            X, X_left = (
                hand.plant.GetBodyByName(name).EvalPoseInWorld(context).GetAsMatrix4()
                for hand, context in zip(hands, contexts, strict=True)
            )
            np.testing.assert_allclose(X_left, M @ X @ M, atol=1e-9)
    q = rng.uniform(allegro.lower, allegro.upper, (200, 16))
    np.testing.assert_allclose(
        allegro_left.fingertips(q), allegro.fingertips(q) * [1, -1, 1], rtol=0, atol=1e-9
    )

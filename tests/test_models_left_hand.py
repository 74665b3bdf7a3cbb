"""The left Allegro hand in models/sdf: the right one's mirror image."""

import numpy as np
import pytest
from pydrake.geometry import Role
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


def test_left_allegro_weighs_and_looks_as_the_mirror_image(allegro, allegro_left):
    """Masses, centres, inertias, and every shape's kind, size and place are reflected."""
    M = np.diag([1.0, -1.0, 1.0])
    X_M = np.diag([1.0, -1.0, 1.0, 1.0])
    inspectors = [hand.scene_graph.model_inspector() for hand in (allegro, allegro_left)]
    for index in range(1, allegro.plant.num_bodies()):
        body = allegro.plant.get_body(BodyIndex(index))
        left = allegro_left.plant.GetBodyByName(body.name())
        assert left.default_mass() == body.default_mass()
        np.testing.assert_allclose(left.default_com(), M @ body.default_com(), atol=1e-12)
        J, J_left = (
            b.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3() for b in (body, left)
        )
        np.testing.assert_allclose(J_left, M @ J @ M, atol=1e-12)
        for role in (Role.kProximity, Role.kIllustration):
            shapes, shapes_left = (
                {
                    inspector.GetName(id).split("::")[-1]: (
                        inspector.GetShape(id),
                        inspector.GetPoseInFrame(id),
                    )
                    for id in inspector.GetGeometries(hand.plant.GetBodyFrameIdOrThrow(b.index()), role)
                }
                for hand, b, inspector in zip((allegro, allegro_left), (body, left), inspectors, strict=True)
            )
            assert shapes.keys() == shapes_left.keys()
            for name, (shape, X) in shapes.items():
                shape_left, X_left = shapes_left[name]
                assert str(shape_left) == str(shape)
                # A primitive is its own mirror image, so its pose may be reflected like a frame.
                np.testing.assert_allclose(X_left.GetAsMatrix4(), X_M @ X.GetAsMatrix4() @ X_M, atol=1e-12)

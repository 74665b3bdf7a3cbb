"""The Panda in models/sdf against Franka's data sheet."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

READY = [0.0, -0.7854, 0.0, -2.35619, 0.0, 1.5708, 0.7854]
# Franka's modified Denavit-Hartenberg parameters a, d in m and alpha in rad, frame 1 to flange.
PANDA_DH = [
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
    (0.0, 0.107, 0.0),
]


def test_panda_agrees_with_its_denavit_hartenberg_table(panda, rng):
    """The flange's pose is the product of Franka's link transforms, for any joint positions."""
    for q in rng.uniform(-2, 2, (20, 7)):
        panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(q)})
        X = RigidTransform()
        for (a, d, alpha), theta in zip(PANDA_DH, [*q, 0.0], strict=True):
            X = X @ RigidTransform(RotationMatrix.MakeXRotation(alpha), [a, 0, 0])
            X = X @ RigidTransform(RotationMatrix.MakeZRotation(theta), [0, 0, 0])
            X = X @ RigidTransform([0, 0, d])
        flange = panda.plant.GetFrameByName("panda_link8").CalcPoseInWorld(panda.context)
        np.testing.assert_allclose(flange.GetAsMatrix4(), X.GetAsMatrix4(), atol=1e-9)


def test_panda_collides_with_itself_as_often_as_its_meshes_do(panda, rng):
    """3.2 % of uniform joint positions collide; exact triangle tests of Franka's meshes give 2.9 %."""
    joints = [panda.plant.GetJointByName(f"panda_joint{i}") for i in range(1, 8)]
    limits = [(joint.position_lower_limit(), joint.position_upper_limit()) for joint in joints]
    hits = 0
    for q in rng.uniform(*np.transpose(limits), (5000, 7)):
        panda.set_joints({joint.name(): angle for joint, angle in zip(joints, q, strict=True)})
        hits += panda.collides()
    assert hits / 5000 == pytest.approx(0.0321, abs=0.01)


def test_panda_actuators_hold_their_position(panda):
    """All seven joints have the stiffness of the arm's own controller, and settle without swinging."""
    panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(READY)})
    inertia = panda.plant.CalcMassMatrix(panda.context)
    assert panda.plant.num_actuators() == 7
    for i, stiffness in enumerate([3000, 3000, 3000, 2500, 2500, 2000, 2000]):
        actuator = panda.plant.GetJointActuatorByName(f"panda_joint{i + 1}")
        gains = actuator.get_controller_gains()
        assert gains.p == stiffness
        row = actuator.joint().velocity_start()
        assert 0.7 < gains.d / (2 * np.sqrt(gains.p * inertia[row, row])) < 1.4

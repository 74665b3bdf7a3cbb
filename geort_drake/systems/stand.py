"""Holds a body in place and releases it at a set time."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context

from geort_drake.systems.python_system import PythonSystem

_STIFFNESS, _DAMPING = 1000.0, 15.0  # N/m and N s/m
_TURN_STIFFNESS, _TURN_DAMPING = 0.5, 0.005  # N m/rad and N m s/rad


class Stand(PythonSystem):
    """A spring and a damper that hold a body in place until a release time.

    Unlike a constraint of the plant, it is released from inside the diagram.

    Input ports:
        body_poses (abstract list of RigidTransform), body_spatial_velocities (abstract list of
            SpatialVelocity): the plant's ports of these names.
    Output port:
        force (abstract list of ExternallyAppliedSpatialForce): on the body.

    Parameter: the release time, s.

    Args:
        X_WP: pose at which the body is held.
        duration: how long the body is held after the start or a restart, s.
    """

    def __init__(self, body: BodyIndex, X_WP: RigidTransform, duration: float):
        super().__init__()
        self._body, self._X_WP, self._duration = body, X_WP, duration
        self._until = self.DeclareNumericParameter(BasicVector([duration]))
        poses = AbstractValue.Make([RigidTransform()])
        self._poses = self.DeclareAbstractInputPort("body_poses", poses)
        velocities = AbstractValue.Make([SpatialVelocity()])
        self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", velocities)
        nothing = AbstractValue.Make([ExternallyAppliedSpatialForce()])
        self.DeclareAbstractOutputPort("force", lambda: nothing, self._calc_force)

    def restart(self, context: Context) -> None:
        """Holds the body again, from the present time on."""
        until = context.get_time() + self._duration
        context.get_mutable_numeric_parameter(self._until).SetAtIndex(0, until)

    def _calc_force(self, context: Context, output: AbstractValue) -> None:
        if context.get_time() >= context.get_numeric_parameter(self._until)[0]:
            output.set_value([])
            return
        X_WO, V_WO = self._poses.Eval(context)[self._body], self._velocities.Eval(context)[self._body]
        turn = (self._X_WP.rotation() @ X_WO.rotation().inverse()).ToAngleAxis()
        applied = ExternallyAppliedSpatialForce()
        applied.body_index, applied.p_BoBq_B = self._body, np.zeros(3)
        applied.F_Bq_W = SpatialForce(
            tau=_TURN_STIFFNESS * turn.angle() * turn.axis() - _TURN_DAMPING * V_WO.rotational(),
            f=_STIFFNESS * (self._X_WP.translation() - X_WO.translation()) - _DAMPING * V_WO.translational(),
        )
        output.set_value([applied])

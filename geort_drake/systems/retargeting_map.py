"""Runs a retargeter as a memoryless system that Drake can differentiate."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.framework import BasicVector_, Context, LeafSystem_
from pydrake.systems.scalar_conversion import SystemScalarConverter, TemplateSystem

from geort_drake.errors import GeortError, HandError
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.retargeting.retargeter import Retargeter, UniversalRetargeter
from geort_drake.systems.python_system import Freeable, weak_callback


@TemplateSystem.define("RetargetingMap_", T_list=[float, AutoDiffXd])
def RetargetingMap_(T: type) -> type:
    """See `RetargetingMap`."""

    class Impl(LeafSystem_[T], metaclass=Freeable):
        """Maps keypoints to joint positions without memory, checks or limits, for optimisation and analysis.

        `RetargetingSystem` has a discrete state, so no gradient passes through it. This system has direct
        feedthrough and, after `ToAutoDiffXd()`, the exact derivative.

        Input port:
            keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        Output port:
            positions (n): joint positions, rad, in the order of `actuated_joints`.

        Args:
            retarget: a `Retargeter`; of a universal map, the one that `for_person` returns.
            actuated_joints: the retargeter's joints in the order of the output; None keeps its order.

        Raises:
            HandError: the actuated joints are not the retargeter's.
            GeortError: the retargeter is a universal map, which has no Jacobian.
        """

        def _construct(
            self,
            retarget: Retargeter,
            actuated_joints: Sequence[str] | None = None,
            converter: SystemScalarConverter | None = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            if isinstance(retarget, UniversalRetargeter):
                raise GeortError("a universal map has no Jacobian: give the map that its for_person returns")
            joints = list(retarget.joint_names)
            ordered = joints if actuated_joints is None else list(actuated_joints)
            if sorted(joints) != sorted(ordered):
                raise HandError(
                    f"the retargeter moves {', '.join(sorted(joints))}; given: {', '.join(sorted(ordered))}"
                )
            self._arguments = (retarget, actuated_joints)
            self._retarget = retarget
            self._order = np.array([joints.index(name) for name in ordered])
            self._tips = list(retarget.human_keypoints)
            self._keypoints = self.DeclareVectorInputPort("keypoints", 3 * KEYPOINT_COUNT)
            self.DeclareVectorOutputPort(
                "positions", len(joints), weak_callback(self, self._calc), {self.all_input_ports_ticket()}
            )

        def _construct_copy(self, other: Any, converter: SystemScalarConverter | None = None) -> None:
            retarget, actuated_joints = other._arguments
            Impl._construct(self, retarget, actuated_joints, converter)

        def _calc(self, context: Context, output: BasicVector_[T]) -> None:
            p_HF = self._keypoints.Eval(context).reshape(KEYPOINT_COUNT, 3)[self._tips]
            if T is float:
                output.SetFromVector(self._retarget(p_HF)[self._order])
                return
            p_HF = p_HF.reshape(-1, 1)
            q, J = self._retarget.value_and_jacobian(ExtractValue(p_HF).reshape(-1, 3))
            gradient = J[self._order].reshape(len(q), -1) @ ExtractGradient(p_HF)
            output.SetFromVector(InitializeAutoDiff(q[self._order], gradient)[:, 0])

    return Impl


RetargetingMap = RetargetingMap_[None]  # the default instantiation, for float

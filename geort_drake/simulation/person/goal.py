"""Base class of goals: what a person intends to do with the robot's fingers."""

import abc
import dataclasses as dc
import math
from collections.abc import Sequence
from typing import Any, Self, TypeVar

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.person.perception import FreePlay
from geort_drake.systems.port_values import mirrored_pose


@dc.dataclass(frozen=True)
class Goal(abc.ABC):
    """Target positions of F fingertips, relative to the robot hand or to the object.

    Tasks add fields: points and directions (..., 3), m, by names that begin with p_ or n_, and poses. Every
    goal has `p_BF_open` (F, 3), fingertips in B before they touch, NaN for fingers whose positions do not
    matter.
    """

    # Robot fingers, in the hand description's order, and (F,) whether they touch the object.
    finger_names: tuple[str, ...]
    touches: np.ndarray
    # Distance by which free play may miss the fingertips' places, m.
    clearance: float
    # Free play that the person saw before the task; None if it does not matter.
    play: FreePlay | None = dc.field(default=None, kw_only=True)
    # Weight of what the fingers lift, N, which the person knows from earlier lifts; 0 if they lift nothing.
    weight: float = dc.field(default=0.0, kw_only=True)

    @abc.abstractmethod
    def places(self) -> Sequence[np.ndarray]:
        """Returns sets of fingertip positions (F, 3), m in B, that free play must reach."""

    def mirrored(self) -> Self:
        """Returns the goal reflected in the xz-planes of its frames, for a left hand; `play.p_HF` stays."""
        values = {field.name: getattr(self, field.name) for field in dc.fields(self)}
        changed: dict[str, Any] = {"play": self.play and self.play._replace(p_BF=mirrored(self.play.p_BF))}
        changed |= {name: mirrored(p) for name, p in values.items() if name.startswith(("p_", "n_"))}
        changed |= {name: mirrored_pose(X) for name, X in values.items() if isinstance(X, RigidTransform)}
        return dc.replace(self, **changed)


Intended = TypeVar("Intended", bound=Goal)


@dc.dataclass(frozen=True)
class GraspGoal(Goal):
    """A grasp of one object by one robot hand.

    Frames: O the object, upright, its x axis at the grasp's yaw; B the hand base; F a fingertip point. The
    clearance is the least distance between the fingers of the open hand and the object on the way to it.
    """

    # Pose of the hand base at the grasp, and while waiting before it, clear of the object.
    X_OB: RigidTransform
    X_OB_before: RigidTransform
    # (F, 3) fingertips of the open hand in B, m.
    p_BF_open: np.ndarray
    # (F, 3) touching fingertips in O, m, and inward unit vectors.
    p_OF_touch: np.ndarray
    n_OF: np.ndarray
    # Turn about the vertical after which the object looks the same, rad; 0 for any turn.
    yaw_symmetry: float

    def places(self) -> tuple[np.ndarray]:
        return (self.p_BF_open,)

    def object_frame(self, X_WO: RigidTransform) -> RigidTransform:
        """Returns the upright frame O of the grasp for an object at X_WO.

        Of equivalent yaws it has the one nearest to zero, so that the wrist turns least.
        """
        yaw = yaw_of(X_WO.rotation())
        yaw = 0.0 if self.yaw_symmetry == 0 else math.remainder(yaw, self.yaw_symmetry)
        return RigidTransform(RotationMatrix.MakeZRotation(yaw), X_WO.translation())


def yaw_of(R_WO: RotationMatrix) -> float:
    """Returns the yaw of an object, rad, by the one of its x and y axes that is nearer to the horizontal.

    A vertical axis has no yaw, so a block that has tumbled onto a side is turned by the other one.
    """
    R = R_WO.matrix()
    if np.hypot(*R[:2, 0]) >= np.hypot(*R[:2, 1]):
        return math.atan2(R[1, 0], R[0, 0])
    return math.atan2(-R[0, 1], R[1, 1])

"""Base class of goals: what a person intends to do with the robot's fingers."""

import abc
import dataclasses as dc
from collections.abc import Sequence
from typing import Any, Self, TypeVar

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.systems.port_values import mirrored_pose


@dc.dataclass(frozen=True)
class Goal(abc.ABC):
    """Target positions of F fingertips, relative to the robot hand or to the object.

    Tasks add fields: points and directions (..., 3), m, by names that begin with p_ or n_, and poses.
    """

    # Robot fingers, in the hand description's order, and (F,) whether they touch the object. The positions of
    # the others do not matter.
    finger_names: tuple[str, ...]
    touches: np.ndarray
    # Distance by which free play may miss the fingertips' places, m.
    clearance: float
    # Free play that the person saw before the task; None if it does not matter.
    play: FreePlay | None = dc.field(default=None, kw_only=True)

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

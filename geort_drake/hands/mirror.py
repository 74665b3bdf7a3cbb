"""Kinematics and shapes of a hand as those of a right hand, like all human hands here."""

from typing import TYPE_CHECKING

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.model import HandModel

if TYPE_CHECKING:
    from geort_drake.retargeting.training.collision_geometry import CollisionShapes
    from geort_drake.retargeting.training.kinematics import HandKinematics


def canonical_kinematics(hand: HandModel) -> "HandKinematics":
    """The hand's kinematics, of a left hand mirrored in the plane y = 0 of the hand base."""
    return hand.kinematics().mirrored() if hand.description.side == "left" else hand.kinematics()


def canonical_shapes(hand: HandModel) -> "CollisionShapes":
    """The hand's collision shapes, of a left hand mirrored likewise.

    Raises:
        HandError: as for `collision_shapes`.
    """
    shapes = collision_shapes(hand)
    return shapes.mirrored() if hand.description.side == "left" else shapes

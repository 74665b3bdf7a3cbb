"""Kinematics and shapes in the convention of human hands, in which left hands are mirrored."""

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.kinematics import CollisionShapes, HandKinematics
from geort_drake.hands.model import HandModel


def canonical_kinematics(hand: HandModel) -> HandKinematics:
    """Returns the hand's kinematics; a left hand's are mirrored in the plane y = 0 of the hand base."""
    return hand.kinematics().mirrored() if hand.description.side == "left" else hand.kinematics()


def canonical_shapes(hand: HandModel) -> CollisionShapes:
    """Returns the hand's collision shapes; a left hand's are mirrored as well.

    Raises:
        HandError: as `collision_shapes`.
    """
    shapes = collision_shapes(hand)
    return shapes.mirrored() if hand.description.side == "left" else shapes

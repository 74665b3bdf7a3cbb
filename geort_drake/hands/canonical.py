"""A hand as a canonical right one: people are right hands, so a left robot hand is
trained and measured in the mirror."""

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.training.collision_geometry import CollisionShapes
from geort_drake.retargeting.training.kinematics import HandKinematics


def canonical_kinematics(hand: HandModel) -> HandKinematics:
    """The hand's kinematics, a left hand's in the mirror y → −y of the hand base."""
    return hand.kinematics().mirrored() if hand.description.side == "left" else hand.kinematics()


def canonical_shapes(hand: HandModel) -> CollisionShapes:
    """The hand's collision shapes, likewise.

    Raises:
        HandError: see `collision_shapes`.
    """
    shapes = collision_shapes(hand)
    return shapes.mirrored() if hand.description.side == "left" else shapes

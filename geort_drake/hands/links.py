"""Which joint moves which link: the links of a hand in a plant that are a finger's, and the palm's."""

from collections.abc import Collection, Mapping

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, ModelInstanceIndex, RigidBody

from geort_drake.hands.couplings import followers
from geort_drake.hands.description import HandDescription


def inboard_joints(plant: MultibodyPlant, model: ModelInstanceIndex | None = None) -> dict[BodyIndex, Joint]:
    """Index of each link → the joint on its side of the base, of one model or of all."""
    indices = plant.GetJointIndices() if model is None else plant.GetJointIndices(model)
    return {joint.child_body().index(): joint for joint in map(plant.get_joint, indices)}


def moving_joint(link: RigidBody, inboard: Mapping[BodyIndex, Joint], names: Collection[str]) -> Joint | None:
    """The nearest joint of those names between a link and the base; None where none of them moves it."""
    joint = inboard.get(link.index())
    while joint is not None and joint.name() not in names:
        joint = inboard.get(joint.parent_body().index())
    return joint


def finger_links(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex
) -> list[list[RigidBody]]:
    """The links of each finger, in the description's order: all that its joints move, or followers of these.

    Args:
        hand: the model instance of the hand in `plant`, as `add_hand_model` adds it.
    """
    finger_of = {
        joint: number for number, finger in enumerate(description.fingers) for joint in finger.joints
    }
    finger_of |= {follower: finger_of[leader] for follower, leader, *_ in followers(description)}
    inboard = inboard_joints(plant, hand)
    links: list[list[RigidBody]] = [[] for _ in description.fingers]
    for link in map(plant.get_body, plant.GetBodyIndices(hand)):
        joint = moving_joint(link, inboard, finger_of)
        if joint is not None:
            links[finger_of[joint.name()]].append(link)
    return links


def palm_links(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex
) -> list[RigidBody]:
    """The links that no finger moves; see `finger_links`."""
    moved = {body.index() for links in finger_links(plant, description, hand) for body in links}
    return [plant.get_body(index) for index in plant.GetBodyIndices(hand) if index not in moved]

"""Which links of a hand in a plant are a finger's, and which the palm's."""

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody

from geort_drake.hands.couplings import followers
from geort_drake.hands.description import HandDescription


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
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(hand)]
    inboard = {joint.child_body().index(): joint for joint in joints}
    links: list[list[RigidBody]] = [[] for _ in description.fingers]
    for index in plant.GetBodyIndices(hand):
        # What is welded to a link goes along with it.
        joint = inboard.get(index)
        while joint is not None and joint.name() not in finger_of:
            joint = inboard.get(joint.parent_body().index())
        if joint is not None:
            links[finger_of[joint.name()]].append(plant.get_body(index))
    return links


def palm_links(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex
) -> list[RigidBody]:
    """The links that no finger moves; see `finger_links`."""
    moved = {body.index() for links in finger_links(plant, description, hand) for body in links}
    return [plant.get_body(index) for index in plant.GetBodyIndices(hand) if index not in moved]

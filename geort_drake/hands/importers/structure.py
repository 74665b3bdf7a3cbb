"""Finds the palm and the fingers of a hand's model.

Links with the same movable joints between them and the root are welded together. The tuple of these joints'
names thus identifies a group of links; a group carries all groups whose tuples begin with its own.
"""

import itertools
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, ModelInstanceIndex, RevoluteJoint, RigidBody
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError, UnknownNameError, naming
from geort_drake.hands.assembly import detach_from_world, joint_paths, parse_model
from geort_drake.hands.description import CouplingDescription, resolved_couplings
from geort_drake.hands.model_files import read_couplings

MAX_FINGERS = 5
# A second branch of a finger is a separate finger if it has this many joints of its own.
_MIN_BRANCH_JOINTS = 2
# This many joints in a row that move several chains form an arm; folding palms have one such joint.
_MIN_ARM_JOINTS = 4
_MIN_PALM_CHAINS = 3  # a link that carries this many chains is the palm of another hand

Group = tuple[str, ...]


@dataclass(frozen=True)
class Chain:
    """The joints of a finger, from the palm to its end.

    Attributes:
        joints: names of the joints that move independently.
        moving: names of these joints and their followers.
        bodies: links that move with the last joint, beginning with that joint's own link.
        names: names of all its joints and links.
    """

    joints: list[str]
    moving: list[str]
    bodies: list[RigidBody]
    names: list[str]


@dataclass(frozen=True)
class HandStructure:
    """A model in a plant of its own, with its root link R welded to the world.

    Attributes:
        path: the model's file.
        plant, scene_graph, hand: the plant, its scene graph and the model instance.
        root: name of R.
        palm: links of the palm, beginning with the one that carries most fingers.
        chains: the 2 to 5 fingers.
        couplings: the joints that follow others.
        held: joints that cannot belong to a finger, and the reason for each.
        notes: sentences on couplings that are guessed or ignored.
    """

    path: Path
    plant: MultibodyPlant
    scene_graph: SceneGraph
    hand: ModelInstanceIndex
    root: str
    palm: list[RigidBody]
    chains: list[Chain]
    couplings: list[CouplingDescription]
    held: dict[str, str]
    notes: list[str]


def read_structure(path: Path, palm: str | None = None) -> HandStructure:
    """Loads a model and finds its palm and fingers.

    Args:
        path: path of the model.
        palm: link that carries the fingers; by default the one from which most chains start.

    Raises:
        HandError: the model cannot be loaded, has fewer than two fingers, or is more than one hand.
        UnknownNameError: the model has no such link.
    """
    if not path.is_file():
        raise HandError(f"the model file {path} is missing")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    hand, (couplings, notes) = parse_model(plant, path), read_couplings(path)
    with naming(f"model {path}", HandError):
        root, links, chains, held = _find_hand(plant, hand, palm, couplings)
    return HandStructure(path, plant, scene_graph, hand, root, links, chains, couplings, held, notes)


def _find_hand(
    plant: MultibodyPlant, hand: ModelInstanceIndex, palm: str | None, couplings: list[CouplingDescription]
) -> tuple[str, list[RigidBody], list[Chain], dict[str, str]]:
    """Finalizes the plant; returns root, palm, chains and held joints, see `HandStructure`."""
    for constraint in plant.GetConstraintIds():
        plant.RemoveConstraint(constraint)
    detach_from_world(plant, hand)
    all_joints = map(plant.get_joint, plant.GetJointIndices(hand))
    joints = {joint.name(): joint for joint in all_joints if joint.num_positions()}
    root, groups = _groups(plant, hand, palm)
    plant.WeldFrames(plant.world_frame(), root.body_frame())
    plant.Finalize()
    carrier = _palm(groups, palm)
    if palm is None:
        _require_one_hand(groups, carrier, joints)
    for coupling in couplings:
        for name in (coupling.joint, coupling.follows):
            if name not in joints:
                raise HandError(
                    f"joint '{coupling.joint}' follows '{coupling.follows}', but the model has "
                    f"no movable joint '{name}'"
                )
    where = f"its palm, the link '{groups[carrier][0].name()}'"
    fingers = _fingers(groups, carrier, joints)
    longest = sorted(fingers, key=len, reverse=True)
    if len(fingers) > MAX_FINGERS and len(longest[MAX_FINGERS]) == len(longest[MAX_FINGERS - 1]):
        raise HandError(
            f"{len(fingers)} chains of joints start at {where}; expected one hand of 2 to "
            f"{MAX_FINGERS} fingers"
        )
    fingers = [finger for finger in fingers if finger in longest[:MAX_FINGERS]]
    leaders = {c.joint: c.follows for c in resolved_couplings(couplings)}
    held = _held_joints(joints, fingers, leaders)
    found = [_chain(groups, carrier, finger, leaders, held) for finger in fingers]
    chains = [chain for chain in found if chain is not None]
    if len(chains) < 2:
        in_chains = set(itertools.chain(*fingers))
        reasons = "".join(f"; '{name}' {why}" for name, why in held.items() if name in in_chains)
        raise HandError(
            f"{len(chains)} chains of movable revolute joints start at {where}; expected a hand "
            f"of 2 to {MAX_FINGERS} fingers{reasons}"
        )
    carried = Counter(joints[finger[0]].parent_body().index() for finger in fingers)
    links = sorted(groups[carrier], key=lambda body: -carried[body.index()])
    return root.name(), links, chains, held


def _groups(
    plant: MultibodyPlant, hand: ModelInstanceIndex, palm: str | None
) -> tuple[RigidBody, dict[Group, list[RigidBody]]]:
    """Returns the palm's root link, and all groups of links that it carries, nearest first."""
    by_root: dict[BodyIndex, dict[Group, list[RigidBody]]] = {}
    for index, path in joint_paths(plant, hand).items():
        root = path[0].parent_body().index() if path else index
        group = tuple(joint.name() for joint in path if joint.num_positions())
        links = by_root.setdefault(root, {}).setdefault(group, [])
        # The link that is not welded to another one towards the root comes first.
        links.insert(len(links) if path and not path[-1].num_positions() else 0, plant.get_body(index))

    def rank(root: BodyIndex) -> tuple[bool, int]:
        names = {body.name() for links in by_root[root].values() for body in links}
        return palm in names, len(by_root[root])

    if not by_root:
        raise HandError("the model has no links")
    hands = [g for g in by_root.values() if max(_outgoing_joints(g).values(), default=0) >= _MIN_PALM_CHAINS]
    if palm is None and len(hands) > 1:
        raise _several_hands([f"'{groups[_palm(groups, None)][0].name()}'" for groups in hands])
    # Anything else in the file, such as an object, has fewer joints than the hand.
    root = max(by_root, key=rank)
    groups = by_root[root]
    return plant.get_body(root), dict(sorted(groups.items(), key=lambda item: len(item[0])))


def _outgoing_joints(groups: dict[Group, list[RigidBody]]) -> Counter[Group]:
    """Counts the joints that start from each group."""
    return Counter(group[:-1] for group in groups if group)


def _palm(groups: dict[Group, list[RigidBody]], palm: str | None) -> Group:
    """Returns the group with the named link, or the one nearest to the root from which most joints start."""
    if palm is None:
        outgoing = _outgoing_joints(groups)
        return max(groups, key=lambda group: outgoing[group])
    named = {body.name(): group for group, bodies in groups.items() for body in bodies}
    if palm not in named:
        raise UnknownNameError("link of the model", palm, named)
    return named[palm]


def _require_one_hand(groups: dict[Group, list[RigidBody]], palm: Group, joints: dict[str, Joint]) -> None:
    """Raises HandError for a model of several hands, or with an arm in addition to other chains."""
    outgoing = _outgoing_joints(groups)
    branching = [group for group in groups if outgoing[group] > 1]
    palms = [group for group in branching if outgoing[group] >= min(_MIN_PALM_CHAINS, outgoing[palm])]
    # Groups nearer to the root come first.
    separate = any(b[: len(a)] != a for a, b in itertools.combinations(palms, 2))
    arm = any(_is_on(palm, group) and len(group) - len(palm) >= _MIN_ARM_JOINTS for group in branching)
    if not separate and not arm:
        return
    choices = []
    for group in branching:
        starting = [joints[other[-1]] for other in groups if other and other[:-1] == group]
        parents = [joint.parent_body().name() for joint in starting]
        choices.append(f"'{max(parents, key=parents.count)}'")
    raise _several_hands(choices)


def _several_hands(palms: list[str]) -> HandError:
    return HandError(
        f"more than one hand: several chains of joints start at each of {', '.join(palms)}; "
        "give the palm as --palm, or put the hand into a file of its own"
    )


def _is_on(carrier: Group, group: Group) -> bool:
    """Whether a group is the carrier or is carried by it."""
    return group[: len(carrier)] == carrier


def _fingers(groups: dict[Group, list[RigidBody]], palm: Group, joints: dict[str, Joint]) -> list[Group]:
    """Returns the joints of each chain that may be a finger, from the palm on."""
    outgoing = _outgoing_joints(groups)
    ends = [group[len(palm) :] for group in groups if _is_on(palm, group) and not outgoing[group]]
    fingers: list[Group] = []
    for path in sorted(ends, key=len, reverse=True):
        branches = [finger for finger in fingers if finger[:1] == path[:1]]
        own = set(path).difference(*branches)
        revolute = any(isinstance(joints[name], RevoluteJoint) for name in path)
        if revolute and (not branches or len(own) >= _MIN_BRANCH_JOINTS):
            fingers.append(path)
    return [path for path in ends if path in fingers]


def _held_joints(joints: dict[str, Joint], fingers: list[Group], leaders: dict[str, str]) -> dict[str, str]:
    """Returns the joints that cannot belong to a finger, and the reason for each."""
    moved: dict[str, set[int]] = {}
    for number, finger in enumerate(fingers):
        for name in finger:
            for mover in {name, leaders.get(name, name)}:
                moved.setdefault(mover, set()).add(number)
    on_fingers = set(itertools.chain(*fingers))
    held = {}
    for name, joint in joints.items():
        if name in leaders:
            continue
        if name not in on_fingers:
            held[name] = "belongs to no finger"
        elif len(moved[name]) > 1:
            held[name] = f"moves {len(moved[name])} fingers at once"
        elif not isinstance(joint, RevoluteJoint):
            held[name] = "is not a revolute joint"
        elif not np.isfinite([joint.position_lower_limit(), joint.position_upper_limit()]).all():
            held[name] = "has no position limits"
        elif joint.position_lower_limit() >= joint.position_upper_limit():
            held[name] = "has no range between its position limits"
    return held


def _chain(
    groups: dict[Group, list[RigidBody]],
    palm: Group,
    finger: Group,
    leaders: dict[str, str],
    held: dict[str, str],
) -> Chain | None:
    """Makes the chain of a finger; returns None if none of its joints moves independently."""
    moving = [name for name in finger if leaders.get(name, name) not in held]
    own = [name for name in moving if name not in leaders]
    if not own:
        return None
    # The links of each joint, from the palm on. Links beyond held joints move with the last moving joint.
    links = [groups[palm + finger[: number + 1]] for number in range(len(finger))]
    bodies = list(itertools.chain(*links[finger.index(moving[-1]) :]))
    names = [*finger, *(body.name() for body in itertools.chain(*links))]
    return Chain(own, moving, bodies, names)

"""Finds the palm and the fingers of a hand's model.

Links with the same root and the same movable joints from there are welded together. The tuple of the root's
and these joints' names thus identifies a group of links; a group carries all groups whose tuples begin with
its own.
"""

import itertools
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import RevoluteJoint, RigidBody
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError, UnknownNameError, listed, naming
from geort_drake.hands.assembly import detach_from_world, joint_paths, parse_model
from geort_drake.hands.description import resolved_couplings
from geort_drake.hands.model_files import read_couplings

MAX_FINGERS = 5
# A second branch of a finger is a separate finger if it has this many joints of its own.
_MIN_BRANCH_JOINTS = 2
# This many joints in a row that move several chains form an arm; folding palms have one such joint.
_MIN_ARM_JOINTS = 4
_UNLIMITED = "has no position limits"  # why a joint is held
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


class HandStructure:
    """A model in a plant of its own, with its root link R welded to the world, its palm and its fingers.

    Attributes:
        path: the model's file.
        plant, scene_graph, hand: the plant, its scene graph and the model instance.
        root: name of R.
        palm: links of the palm, beginning with the one that carries most fingers.
        chains: the 2 to 5 fingers.
        couplings: the joints that follow others.
        held_joints: joints that cannot belong to a finger, and the reason for each.
        notes: sentences on couplings that are guessed or ignored.

    Args:
        path: path of the model.
        palm: link that carries the fingers; by default the one from which most chains start.

    Raises:
        HandError: the model cannot be loaded, has fewer than two fingers, or is more than one hand.
        UnknownNameError: the model has no such link.
    """

    def __init__(self, path: Path, palm: str | None = None):
        if not path.is_file():
            raise HandError(f"the model file {path} is missing")
        self.path = path
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
        self.hand = parse_model(self.plant, path)
        self.couplings, self.notes = read_couplings(path)
        with naming(f"model {path}", HandError):
            self._find_hand(palm)

    def _find_hand(self, palm: str | None) -> None:
        """Finalizes the plant, and finds root, palm, chains and held joints."""
        plant = self.plant
        for constraint in plant.GetConstraintIds():
            plant.RemoveConstraint(constraint)
        detach_from_world(plant, self.hand)
        joints = map(plant.get_joint, plant.GetJointIndices(self.hand))
        self._joints = {joint.name(): joint for joint in joints if joint.num_positions()}
        self._groups = self._read_groups()
        self._carrier = self._find_carrier(palm)
        self.root = self._carrier[0]
        # Anything else in the file, such as an object, is no part of the hand.
        self._groups = {group: links for group, links in self._groups.items() if group[0] == self.root}
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(self.root, self.hand))
        plant.Finalize()
        for coupling in self.couplings:
            for name in (coupling.joint, coupling.follows):
                if name not in self._joints:
                    raise HandError(
                        f"joint '{coupling.joint}' follows '{coupling.follows}', but the model has "
                        f"no movable joint '{name}'"
                    )
        links = self._groups[self._carrier]
        where = f"its palm, the link '{links[0].name()}'"
        fingers = self._fingers()
        longest = sorted(fingers, key=len, reverse=True)
        if len(fingers) > MAX_FINGERS and len(longest[MAX_FINGERS]) == len(longest[MAX_FINGERS - 1]):
            raise HandError(
                f"{len(fingers)} chains of joints start at {where}; expected one hand of 2 to "
                f"{MAX_FINGERS} fingers"
            )
        fingers = [finger for finger in fingers if finger in longest[:MAX_FINGERS]]
        leaders = {c.joint: c.follows for c in resolved_couplings(self.couplings)}
        self.held_joints = self._find_held_joints(fingers, leaders)
        self.chains = []
        for finger in fingers:
            if (chain := self._chain(finger, leaders)) is not None:
                self.chains.append(chain)
            elif unlimited := [name for name in finger if self.held_joints.get(name) == _UNLIMITED]:
                names = listed([f"'{name}'" for name in unlimited])
                raise HandError(
                    f"the joints {names} have no position limits, so their finger could not move; give each "
                    "limits, or make it a fixed joint"
                )
        if len(self.chains) < 2:
            in_chains = set(itertools.chain(*fingers))
            held = {name: why for name, why in self.held_joints.items() if name in in_chains}
            reasons = "".join(f"; '{name}' {why}" for name, why in held.items())
            raise HandError(
                f"{len(self.chains)} chains of movable revolute joints start at {where}; expected a hand "
                f"of 2 to {MAX_FINGERS} fingers{reasons}"
            )
        carried = Counter(self._joints[finger[0]].parent_body().index() for finger in fingers)
        self.palm = sorted(links, key=lambda body: -carried[body.index()])

    def _read_groups(self) -> dict[Group, list[RigidBody]]:
        """Returns the groups of links, those nearest to their roots first."""
        plant = self.plant
        groups: dict[Group, list[RigidBody]] = {}
        for index, path in joint_paths(plant, self.hand).items():
            root = path[0].parent_body() if path else plant.get_body(index)
            group = (root.name(), *(joint.name() for joint in path if joint.num_positions()))
            links = groups.setdefault(group, [])
            # The link that is not welded to another one towards the root comes first.
            links.insert(len(links) if path and not path[-1].num_positions() else 0, plant.get_body(index))
        if not groups:
            raise HandError("the model has no links")
        return dict(sorted(groups.items(), key=lambda item: len(item[0])))

    def _find_carrier(self, palm: str | None) -> Group:
        """Returns the group with the named link, or the one nearest to a root from which most joints start.

        Raises:
            HandError: the model has several hands, or an arm in addition to other chains.
            UnknownNameError: it has no such link.
        """
        groups = self._groups
        if palm is not None:
            group_of = {body.name(): group for group, bodies in groups.items() for body in bodies}
            if palm not in group_of:
                raise UnknownNameError("link of the model", palm, group_of)
            return group_of[palm]
        outgoing = Counter(group[:-1] for group in groups)
        size = Counter(group[0] for group in groups)
        carrier = max(groups, key=lambda group: (outgoing[group], size[group[0]]))
        branching = [group for group in groups if outgoing[group] > 1]
        palms = [
            group
            for group in branching
            if outgoing[group] >= _MIN_PALM_CHAINS
            or (group[0] == carrier[0] and outgoing[group] == outgoing[carrier])
        ]
        # Groups nearer to the root come first.
        separate = any(b[: len(a)] != a for a, b in itertools.combinations(palms, 2))
        on_palm = [group for group in branching if group[: len(carrier)] == carrier]
        if separate or any(len(group) - len(carrier) >= _MIN_ARM_JOINTS for group in on_palm):
            choices = []
            for group in branching:
                starting = [self._joints[other[-1]] for other in groups if other[:-1] == group]
                parents = [joint.parent_body().name() for joint in starting]
                choices.append(f"'{max(parents, key=parents.count)}'")
            raise HandError(
                f"more than one hand: several chains of joints start at each of {', '.join(choices)}; "
                "give the palm as --palm, or put the hand into a file of its own"
            )
        return carrier

    def _fingers(self) -> list[Group]:
        """Returns the joints of each chain that may be a finger, from the palm on."""
        start, inner = len(self._carrier), {group[:-1] for group in self._groups}
        on_palm = [group for group in self._groups if group[:start] == self._carrier]
        ends = [group[start:] for group in on_palm if group not in inner]
        fingers: list[Group] = []
        for path in sorted(ends, key=len, reverse=True):
            branches = [finger for finger in fingers if finger[:1] == path[:1]]
            trunk = set(path).difference(*branches)
            revolute = any(isinstance(self._joints[name], RevoluteJoint) for name in path)
            if revolute and (not branches or len(trunk) >= _MIN_BRANCH_JOINTS):
                fingers.append(path)
        return [path for path in ends if path in fingers]

    def _find_held_joints(self, fingers: list[Group], leaders: dict[str, str]) -> dict[str, str]:
        """Returns the joints that cannot belong to a finger, and the reason for each."""
        moved_fingers: dict[str, set[int]] = {}
        for number, finger in enumerate(fingers):
            for name in finger:
                for mover in {name, leaders.get(name, name)}:
                    moved_fingers.setdefault(mover, set()).add(number)
        on_fingers = set(itertools.chain(*fingers))
        reasons = {}
        for name, joint in self._joints.items():
            if name in leaders:
                continue
            if name not in on_fingers:
                reasons[name] = "belongs to no finger"
            elif len(moved_fingers[name]) > 1:
                reasons[name] = f"moves {len(moved_fingers[name])} fingers at once"
            elif not isinstance(joint, RevoluteJoint):
                reasons[name] = "is not a revolute joint"
            elif not np.isfinite([joint.position_lower_limit(), joint.position_upper_limit()]).all():
                reasons[name] = _UNLIMITED
            elif joint.position_lower_limit() >= joint.position_upper_limit():
                reasons[name] = "has no range between its position limits"
        return reasons

    def _chain(self, finger: Group, leaders: dict[str, str]) -> Chain | None:
        """Returns the chain of a finger; None if none of its joints moves independently."""
        moving = [name for name in finger if leaders.get(name, name) not in self.held_joints]
        independent = [name for name in moving if name not in leaders]
        if not independent:
            return None
        # The links of each joint, from the palm on. Links beyond held joints move with the last moving one.
        links = [self._groups[self._carrier + finger[: number + 1]] for number in range(len(finger))]
        bodies = list(itertools.chain(*links[finger.index(moving[-1]) :]))
        names = [*finger, *(body.name() for body in itertools.chain(*links))]
        return Chain(independent, moving, bodies, names)

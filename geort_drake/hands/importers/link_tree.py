"""The links of a model as a tree: groups of welded links, the palm, and the chains that leave it."""

import itertools
from collections.abc import Iterator

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RevoluteJoint, RigidBody, WeldJoint

from geort_drake.errors import HandError, UnknownNameError

MAX_FINGERS = 5
# A second branch of a finger is a finger itself if it has this many joints of its own.
_OWN_JOINTS = 2
# This many joints in a row that move several chains are an arm; folding palms have one.
_ARM_JOINTS = 4
_HAND_FINGERS = 3  # chains that make a link the palm of another hand


class LinkTree:
    """Groups of welded links, and the joints between them.

    Args:
        plant: not finalized.
        hand: the model's instance.
        palm: a link of the palm; by default the palm is the group that most joints leave.

    Raises:
        UnknownNameError: there is no such link.
    """

    def __init__(self, plant: MultibodyPlant, hand: ModelInstanceIndex, palm: str | None = None):
        self.bodies = [plant.get_body(index) for index in plant.GetBodyIndices(hand)]
        everything = [plant.get_joint(index) for index in plant.GetJointIndices(hand)]
        self.group = {body.index(): number for number, body in enumerate(self.bodies)}
        for joint in everything:
            if isinstance(joint, WeldJoint):
                old, new = self.end(joint), self.group[joint.parent_body().index()]
                self.group = {body: new if number == old else number for body, number in self.group.items()}
        self.joints: list[Joint] = [joint for joint in everything if not isinstance(joint, WeldJoint)]
        self._leaving: dict[int, list[Joint]] = {number: [] for number in range(len(self.bodies))}
        for joint in self.joints:
            self._leaving[self.group[joint.parent_body().index()]].append(joint)
        children = {joint.child_body().index() for joint in everything}
        roots = [body for body in self.bodies if body.index() not in children]
        # Anything else in the file, such as a floor, has fewer joints than the hand.
        self.root = max(roots, key=lambda body: len(self._carried(self.group[body.index()])))
        if palm is None:
            groups = self._carried(self.group[self.root.index()])
            self._palm = max(
                groups, key=lambda group: len(self._leaving[group])
            )  # first: nearest to the root
        else:
            named = {body.name(): self.group[body.index()] for body in self.bodies}
            if palm not in named:
                raise UnknownNameError("link of the model", palm, named)
            self._palm = named[palm]
        self.palm = next(body for body in self.bodies if self.group[body.index()] == self._palm)

    def require_one_hand(self, source: str) -> None:
        """Refuses a model of several hands, or with an arm beside other chains, unless the palm was given.

        Args:
            source: how errors begin.

        Raises:
            HandError: the palm is ambiguous.
        """
        groups = self._carried(self.group[self.root.index()])
        branching = [group for group in groups if len(self._leaving[group]) > 1]
        least = min(_HAND_FINGERS, len(self._leaving[self._palm]))
        palms = [group for group in branching if len(self._leaving[group]) >= least]
        apart = any(
            a not in self._carried(b) and b not in self._carried(a)
            for a, b in itertools.combinations(palms, 2)
        )
        if apart or self._longest_arm() >= _ARM_JOINTS:
            choices = ", ".join(f"'{self._carrier(group)}'" for group in branching)
            raise HandError(
                f"{source}: more than one hand: several chains of joints leave each of {choices}; give the "
                "palm as --palm, or put the hand into a file of its own"
            )

    def end(self, joint: Joint) -> int:
        """The group that a joint moves."""
        return self.group[joint.child_body().index()]

    def fingers(self, source: str) -> list[list[Joint]]:
        """The joints of each finger, from the palm on; the longest fingers if there are too many.

        Raises:
            HandError: there are too many of equal length.
        """
        kept = self._branches()
        longest = sorted(kept, key=len, reverse=True)
        if len(kept) > MAX_FINGERS and len(longest[MAX_FINGERS]) == len(longest[MAX_FINGERS - 1]):
            raise HandError(
                f"{source}: {len(kept)} chains of joints leave its palm, the link '{self.palm.name()}'; "
                f"expected one hand of 2 to {MAX_FINGERS} fingers"
            )
        return [path for path in kept if path in longest[:MAX_FINGERS]]

    def palm_links(self, paths: list[list[Joint]]) -> list[RigidBody]:
        """The palm's links, first the one that carries most fingers."""
        links = [body for body in self.bodies if self.group[body.index()] == self._palm]
        carried = [path[0].parent_body().index() for path in paths]
        return sorted(links, key=lambda body: -carried.count(body.index()))

    def _branches(self) -> list[list[Joint]]:
        """The joints of each chain that may be a finger."""
        kept: list[list[Joint]] = []
        for joint in self._leaving[self._palm]:
            mine: list[list[Joint]] = []
            for path in sorted(self._paths([joint]), key=len, reverse=True):
                taken = {id(joint) for other in mine for joint in other}
                own = [joint for joint in path if id(joint) not in taken]
                if any(isinstance(joint, RevoluteJoint) for joint in path) and (
                    not mine or len(own) >= _OWN_JOINTS
                ):
                    mine.append(path)
            kept += mine
        return kept

    def _paths(self, path: list[Joint]) -> Iterator[list[Joint]]:
        further = self._leaving[self.end(path[-1])]
        if not further:
            yield path
        for joint in further:
            yield from self._paths([*path, joint])

    def _carried(self, group: int) -> list[int]:
        """A group and all groups that it carries, from near to far."""
        groups = [group]
        for near in groups:
            groups += [self.end(joint) for joint in self._leaving[near]]
        return groups

    def _longest_arm(self) -> int:
        """The most joints in a row, beyond the palm, that move several chains together."""
        longest = 0
        for group in self._carried(self._palm):
            starts = self._leaving[group]
            for joint in starts if group == self._palm or len(starts) > 1 else []:
                length, further = 1, self._leaving[self.end(joint)]
                while len(further) == 1:
                    length, further = length + 1, self._leaving[self.end(further[0])]
                if further:
                    longest = max(longest, length)
        return longest

    def _carrier(self, group: int) -> str:
        """The link of a group that most joints leave."""
        parents = [joint.parent_body().name() for joint in self._leaving[group]]
        return max(parents, key=parents.count)

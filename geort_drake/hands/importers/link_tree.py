"""The links of a model as a tree: which are rigidly connected, and what joints lie between them."""

from collections.abc import Iterator

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RevoluteJoint, RigidBody, WeldJoint

from geort_drake.errors import HandError, UnknownNameError

MOST_FINGERS = 5
# How many joints of its own a second branch of a finger must have to be a finger.
_OWN_JOINTS = 2
# So many joints in a row that move several chains are an arm. Palms that fold have one, and fingers branch
# sooner.
_ARM_JOINTS = 4


class LinkTree:
    """Links grouped by welds, and the joints between the groups.

    Args:
        plant: not finalized.
        hand: the model's instance in it.
        palm: name of a link of the group that is to be the palm; by default the one that most joints leave.

    Raises:
        UnknownNameError: there is no such link.
    """

    def __init__(self, plant: MultibodyPlant, hand: ModelInstanceIndex, palm: str | None = None):
        self.bodies = [plant.get_body(index) for index in plant.GetBodyIndices(hand)]
        everything = [plant.get_joint(index) for index in plant.GetJointIndices(hand)]
        self.group = {body.index(): number for number, body in enumerate(self.bodies)}
        for joint in everything:
            if isinstance(joint, WeldJoint):
                old = self.group[joint.child_body().index()]
                new = self.group[joint.parent_body().index()]
                self.group = {body: new if number == old else number for body, number in self.group.items()}
        self.joints: list[Joint] = [joint for joint in everything if not isinstance(joint, WeldJoint)]
        self.leaving: dict[int, list[Joint]] = {}
        for joint in self.joints:
            self.leaving.setdefault(self.group[joint.parent_body().index()], []).append(joint)
        children = {joint.child_body().index() for joint in everything}
        roots = [body for body in self.bodies if body.index() not in children]
        # What else is in the file, such as a floor, has fewer joints than the hand.
        self.root = max(roots, key=lambda body: self._size(self.group[body.index()]))
        self.palm_group = self._find_palm() if palm is None else self._group_of(palm)
        self.palm = next(body for body in self.bodies if self.group[body.index()] == self.palm_group)

    def require_one_hand(self, source: str) -> None:
        """Looks whether the palm that was found carries one hand's fingers, and no arms or second hand.

        Args:
            source: what errors begin with.

        Raises:
            HandError: it carries more than that, which cannot be told apart without the palm's name.
        """
        reason = ""
        arm = max(self._shared_runs(), key=len, default=[])
        if len(arm) >= _ARM_JOINTS:
            reason = f"{len(arm)} joints in a row, from '{arm[0]}' to '{arm[-1]}', move several of its chains"
        elif arm and len(self._branches()) > MOST_FINGERS:
            reason = f"of the {len(self._branches())} chains that leave it '{arm[0]}' moves several"
        elif (rival := next(filter(self._is_rival, self._palms()), None)) is not None:
            reason = f"as many chains leave '{self._carrier(rival)}'"
        if reason:
            choices = ", ".join(f"'{self._carrier(group)}'" for group in self._palms())
            raise HandError(
                f"{source}: more than a hand: '{self.palm.name()}' was taken for its palm, but {reason}; "
                f"give the link with the fingers as --palm (several chains leave {choices}), or cut the hand "
                "out into a file of its own"
            )

    def end(self, joint: Joint) -> int:
        """The group that a joint moves."""
        return self.group[joint.child_body().index()]

    def fingers(self, source: str) -> list[list[Joint]]:
        """The joints of each finger from the palm on, the longest fingers where there are too many.

        Raises:
            HandError: of too many none are the longest.
        """
        kept = self._branches()
        longest = sorted(kept, key=len, reverse=True)
        if len(kept) > MOST_FINGERS and len(longest[MOST_FINGERS]) == len(longest[MOST_FINGERS - 1]):
            raise HandError(
                f"{source}: {len(kept)} chains of joints leave its palm, the link '{self.palm.name()}', and "
                f"no {MOST_FINGERS} are longer than the rest; wanted: one hand of 2 to {MOST_FINGERS} fingers"
            )
        return [path for path in kept if path in longest[:MOST_FINGERS]]

    def palm_links(self, paths: list[list[Joint]]) -> list[RigidBody]:
        """The palm's links, the one that carries most fingers first."""
        links = [body for body in self.bodies if self.group[body.index()] == self.palm_group]
        carried = [path[0].parent_body().index() for path in paths]
        return sorted(links, key=lambda body: -carried.count(body.index()))

    def _branches(self) -> list[list[Joint]]:
        """The joints of each chain that may be a finger."""
        kept: list[list[Joint]] = []
        for joint in self.leaving.get(self.palm_group, []):
            branches = sorted(self._paths([joint]), key=len, reverse=True)
            mine: list[list[Joint]] = []
            for path in branches:
                taken = {id(joint) for other in mine for joint in other}
                own = [joint for joint in path if id(joint) not in taken]
                if any(isinstance(joint, RevoluteJoint) for joint in path) and (
                    not mine or len(own) >= _OWN_JOINTS
                ):
                    mine.append(path)
            kept += mine
        return kept

    def _shared_runs(self) -> list[list[str]]:
        """The joints in a row that move several chains at once, each row up to where chains part."""
        runs = []
        for group in self._below(self.palm_group):
            starts = self.leaving.get(group, [])
            for joint in starts if group == self.palm_group or len(starts) > 1 else []:
                run, further = [joint], self.leaving.get(self.end(joint), [])
                while len(further) == 1:
                    run, further = [*run, *further], self.leaving.get(self.end(further[0]), [])
                if further:
                    runs.append([joint.name() for joint in run])
        return runs

    def _palms(self) -> list[int]:
        """The groups of the hand's tree that several joints leave, those with most first."""
        several = [
            group
            for group in self._below(self.group[self.root.index()])
            if len(self.leaving.get(group, [])) > 1
        ]
        return sorted(several, key=lambda group: -len(self.leaving[group]))

    def _is_rival(self, group: int) -> bool:
        """Whether as many joints leave another group, which the palm neither carries nor is carried by."""
        if len(self.leaving[group]) < len(self.leaving[self.palm_group]):
            return False
        return group not in self._below(self.palm_group) and self.palm_group not in self._below(group)

    def _below(self, group: int) -> set[int]:
        """The group itself, and what it carries."""
        return {group}.union(*(self._below(self.end(joint)) for joint in self.leaving.get(group, [])))

    def _carrier(self, group: int) -> str:
        """The link of a group that most joints leave."""
        parents = [joint.parent_body().name() for joint in self.leaving[group]]
        return max(parents, key=parents.count)

    def _group_of(self, link: str) -> int:
        named = {body.name(): self.group[body.index()] for body in self.bodies}
        if link not in named:
            raise UnknownNameError("link of the model", link, named)
        return named[link]

    def _paths(self, path: list[Joint]) -> Iterator[list[Joint]]:
        further = self.leaving.get(self.end(path[-1]), [])
        if not further:
            yield path
        for joint in further:
            yield from self._paths([*path, joint])

    def _size(self, group: int) -> int:
        return sum(1 + self._size(self.end(joint)) for joint in self.leaving.get(group, []))

    def _find_palm(self) -> int:
        """The group that most joints leave; of several, the one nearest to the root."""
        best, level = self.group[self.root.index()], [self.group[self.root.index()]]
        while level:
            for group in level:
                if len(self.leaving.get(group, [])) > len(self.leaving.get(best, [])):
                    best = group
            level = [self.end(joint) for group in level for joint in self.leaving.get(group, [])]
        return best

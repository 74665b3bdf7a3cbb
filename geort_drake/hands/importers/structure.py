"""Finds the palm and the fingers of a hand's model."""

import itertools
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import Joint, RevoluteJoint, RigidBody
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError, UnknownNameError, listed, naming
from geort_drake.hands.assembly import detach_from_world, joint_paths, parse_model
from geort_drake.hands.description import resolved_couplings
from geort_drake.hands.model_files import read_couplings

MAX_FINGERS = 5
# Links from which this many joints start are palms of several hands, unless one carries the other.
_HAND_CHAINS = 3
# Why joints are held.
_OFF_FINGERS, _NO_RANGE = "belongs to no finger", "has no position limits, or no range between them"


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
        palm: link that carries the fingers; by default the one from which most joints start.

    Raises:
        HandError: the model cannot be loaded, or has no palm with 2 to 5 fingers, or several.
        UnknownNameError: the model has no such link.
    """

    def __init__(self, path: Path, palm: str | None = None):
        self.path = path
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
        self.hand = parse_model(self.plant, path)
        self.couplings, self.notes = read_couplings(path)
        with naming(f"model {path}", HandError):
            self._find_hand(palm)

    def _find_hand(self, palm: str | None) -> None:
        """Finds palm, root, chains and held joints, and finalizes the plant."""
        plant = self.plant
        for constraint in plant.GetConstraintIds():
            plant.RemoveConstraint(constraint)
        detach_from_world(plant, self.hand)
        joints = [plant.get_joint(index) for index in plant.GetJointIndices(self.hand)]
        self._joints = {joint.name(): joint for joint in joints if joint.num_positions()}
        paths = joint_paths(plant, self.hand)  # refuses what is no tree
        self.palm = self._welded(self._find_palm(palm))
        path = paths[self.palm[0].index()]
        root = path[0].parent_body() if path else self.palm[0]
        self.root = root.name()
        plant.WeldFrames(plant.world_frame(), root.body_frame())
        plant.Finalize()
        for coupling in self.couplings:
            for name in (coupling.joint, coupling.follows):
                if name not in self._joints:
                    raise HandError(
                        f"joint '{coupling.joint}' follows '{coupling.follows}', but the model has "
                        f"no movable joint '{name}'"
                    )
        ends = self._paths_from(self.palm)
        fingers = [path for path in ends if any(isinstance(joint, RevoluteJoint) for joint in path)]
        leaders = {c.joint: c.follows for c in resolved_couplings(self.couplings)}
        self.held_joints = self._find_held_joints(fingers, leaders)
        chains = [self._chain(finger, leaders) for finger in fingers]
        self.chains = [chain for chain in chains if chain is not None]
        if not 2 <= len(self.chains) <= MAX_FINGERS:
            held = [f"'{name}' {why}" for name, why in self.held_joints.items() if why != _OFF_FINGERS]
            raise HandError(
                f"{len(self.chains)} chains of movable revolute joints start at its palm, the link "
                f"'{self.palm[0].name()}'; expected one hand of 2 to {MAX_FINGERS} fingers; if another link "
                f"is the palm, give it as --palm{'; ' * bool(held)}{listed(held)}"
            )

    def _welded(self, link: RigidBody) -> list[RigidBody]:
        """Returns a link and the others that are welded to it."""
        links = self.plant.GetBodiesWeldedTo(link)
        return [link, *(other for other in links if other.index() != link.index())]

    def _find_palm(self, name: str | None) -> RigidBody:
        """Returns the link of this name, or the one from which, with those welded to it, most joints start.

        Raises:
            HandError: as many joints start from several links, or the model has several hands.
            UnknownNameError: the model has no link of this name.
        """
        links = {link.name(): link for link in map(self.plant.get_body, self.plant.GetBodyIndices(self.hand))}
        if not links:
            raise HandError("the model has no links")
        if name is None:
            carriers = self._find_carriers()
            most = max(map(len, carriers.values()), default=0)
            palms = {way: names for way, names in carriers.items() if len(names) >= min(most, _HAND_CHAINS)}
            is_tie = [len(names) for names in palms.values()].count(most) > 1
            ways = sorted(palms, key=len)  # from the roots on
            separate = any(outer[: len(inner)] != inner for inner, outer in itertools.combinations(ways, 2))
            if most > 1 and (is_tie or separate):
                choices = ", ".join(f"'{max(links, key=palms[way].count)}'" for way in ways)
                raise HandError(
                    f"the palm is not clear: several chains of joints start at each of {choices}; give it as "
                    "--palm, or put the hand into a file of its own"
                )
            best = max(palms, key=lambda way: len(palms[way]), default=None)
            name = next(iter(links)) if best is None else max(links, key=palms[best].count)
        if name not in links:
            raise UnknownNameError("link of the model", name, links)
        return links[name]

    def _find_carriers(self) -> dict[tuple[str, ...], list[str]]:
        """Maps the way to links that are welded together to the names of those from which joints start.

        The way is the name of the root and of the movable joints from there. A link that carries another is
        on its way. A name occurs as often as joints start from the link.
        """
        paths = joint_paths(self.plant, self.hand)
        carriers: dict[tuple[str, ...], list[str]] = {}
        for joint in self._joints.values():
            link = joint.parent_body()
            path = paths[link.index()]
            root = path[0].parent_body() if path else link
            way = (root.name(), *(inner.name() for inner in path if inner.num_positions()))
            carriers.setdefault(way, []).append(link.name())
        return carriers

    def _paths_from(self, links: list[RigidBody]) -> list[list[Joint]]:
        """Returns the joints from links that are welded together to each end of the tree beyond them."""
        indices = {link.index() for link in links}
        return [
            [joint, *path]
            for joint in self._joints.values()
            if joint.parent_body().index() in indices
            for path in self._paths_from(self._welded(joint.child_body())) or [[]]
        ]

    def _find_held_joints(self, fingers: list[list[Joint]], leaders: dict[str, str]) -> dict[str, str]:
        """Returns the joints that cannot belong to a finger, and the reason for each."""
        names = [{joint.name() for joint in finger} for finger in fingers]
        moved = Counter(itertools.chain(*({leaders.get(name, name) for name in each} for each in names)))
        reasons = {}
        for name, joint in self._joints.items():
            if name in leaders:
                continue
            if not any(name in each for each in names):
                reasons[name] = _OFF_FINGERS
            elif moved[name] > 1:
                reasons[name] = f"moves {moved[name]} fingers at once"
            elif not isinstance(joint, RevoluteJoint):
                reasons[name] = "is not a revolute joint"
            elif not -np.inf < joint.position_lower_limit() < joint.position_upper_limit() < np.inf:
                reasons[name] = _NO_RANGE
        return reasons

    def _chain(self, finger: list[Joint], leaders: dict[str, str]) -> Chain | None:
        """Returns the chain of a finger; None if it moves only with others.

        Raises:
            HandError: it cannot move, because its joints have no limits.
        """
        names = [joint.name() for joint in finger]
        moving = [name for name in names if leaders.get(name, name) not in self.held_joints]
        independent = [name for name in moving if name not in leaders]
        if not independent:
            faulty = [f"'{name}' {_NO_RANGE}" for name in names if self.held_joints.get(name) == _NO_RANGE]
            if faulty:
                raise HandError(
                    f"a finger cannot move: {listed(faulty)}; correct its joints, or make them fixed joints"
                )
            return None
        # Links beyond held joints move with the last moving one.
        links = [self._welded(joint.child_body()) for joint in finger]
        bodies = list(itertools.chain(*links[names.index(moving[-1]) :]))
        names += [link.name() for link in itertools.chain(*links)]
        return Chain(independent, moving, bodies, names)

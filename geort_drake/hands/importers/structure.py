"""What a model of a hand consists of: the palm, and the chains of joints that leave it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RevoluteJoint, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.hands.assembly import free_from_world, parse_model
from geort_drake.hands.couplings import leaders_range, read_couplings, root
from geort_drake.hands.description import CouplingDescription
from geort_drake.hands.importers.link_tree import LinkTree

_SAMPLES = 300


@dataclass(frozen=True)
class Chain:
    """A finger's joints, from the palm to its end.

    Attributes:
        joints: those that can be moved by themselves.
        moving: those and the ones that follow them.
        bodies: the links that move with the last of them, that joint's own link first.
        names: of all its joints and links.
        p_base: (3,) origin of the first joint in the root link R, m.
    """

    joints: tuple[str, ...]
    moving: tuple[str, ...]
    bodies: tuple[RigidBody, ...]
    names: tuple[str, ...]
    p_base: np.ndarray


@dataclass
class HandStructure:
    """A model in a plant of its own, its root link R welded to the world.

    Attributes:
        path: the model's file.
        plant, scene_graph, hand: where it is loaded.
        couplings: the joints that follow others.
        palm: links of the palm, the one that most fingers are fixed to first.
        chains: the fingers, 2 to 5.
        held: joints that are not to be moved, and why.
    """

    path: Path
    plant: MultibodyPlant
    scene_graph: SceneGraph
    hand: ModelInstanceIndex
    couplings: list[CouplingDescription]
    palm: list[RigidBody] = field(default_factory=list)
    chains: list[Chain] = field(default_factory=list)
    held: dict[str, str] = field(default_factory=dict)

    def postures(self, chain: Chain, rng: np.random.Generator, count: int = _SAMPLES) -> np.ndarray:
        """(count, k) angles of a chain's own joints, uniform within their limits, rad."""
        low, high = self.limits(chain)
        return rng.uniform(low, high, (count, len(chain.joints)))

    def limits(self, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
        """(k,) lower and upper limits of a chain's own joints, rad, within which followers keep theirs."""
        low, high = np.array([self._ends(name) for name in chain.joints]).T
        for coupling in self.couplings:
            leader, ratio, offset = root(self.couplings, coupling)
            if leader in chain.joints and ratio:
                number = chain.joints.index(leader)
                a, b = leaders_range(self._ends(coupling.joint), ratio, offset)
                # A coupling that leaves nothing is refused with the description.
                if max(low[number], a) < min(high[number], b):
                    low[number], high[number] = max(low[number], a), min(high[number], b)
        return low, high

    def _ends(self, joint: str) -> np.ndarray:
        found = self.plant.GetJointByName(joint, self.hand)
        return np.array([found.position_lower_limit(), found.position_upper_limit()])

    def set_angles(self, context: Context, chain: Chain, angles: np.ndarray) -> None:
        """Moves a chain, and what follows it, to angles (k,) of its own joints, rad."""
        for name, angle in zip(chain.joints, angles, strict=True):
            self.plant.GetJointByName(name, self.hand).set_angle(context, angle)
        for coupling in self.couplings:
            leader, ratio, offset = root(self.couplings, coupling)
            if leader in chain.joints:
                angle = ratio * angles[chain.joints.index(leader)] + offset
                self.plant.GetJointByName(coupling.joint, self.hand).set_angle(context, angle)

    def tips(self, chain: Chain, body: RigidBody, point: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """(N, 3) where a point of a link is in R at angles (N, k) of the chain's own joints, m."""
        context = self.plant.CreateDefaultContext()
        p_RF = np.empty((len(angles), 3))
        for row, posture in zip(p_RF, angles, strict=True):
            self.set_angles(context, chain, posture)
            row[:] = self.plant.EvalBodyPoseInWorld(context, body) @ point
        return p_RF


def read_structure(path: Path, palm: str | None = None) -> HandStructure:
    """Loads a model and finds palm and fingers.

    Args:
        path: of the model.
        palm: the link that carries the fingers; by default the one that most chains leave.

    Raises:
        HandError: it cannot be loaded, has no two fingers, or is more than one hand.
        UnknownNameError: it has no such link.
    """
    if not path.is_file():
        raise HandError(f"the model file {path} is missing")
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
    hand = parse_model(plant, path, f"model {path}")
    for constraint in plant.GetConstraintIds():
        plant.RemoveConstraint(constraint)
    free_from_world(plant, hand)
    tree = LinkTree(plant, hand, palm)
    if palm is None:
        tree.require_one_hand(f"model {path}")
    plant.WeldFrames(plant.world_frame(), tree.root.body_frame())
    plant.Finalize()
    structure = HandStructure(path, plant, scene_graph, hand, read_couplings(path))
    known = {joint.name() for joint in tree.joints}
    for coupling in structure.couplings:
        for name in (coupling.joint, coupling.follows):
            if name not in known:
                raise HandError(f"model {path}: '{coupling.joint}' follows '{name}', which is no joint of it")
    paths = tree.fingers(f"model {path}")
    if len(paths) < 2:
        raise HandError(
            f"model {path}: {len(paths)} chains of revolute joints leave its palm, the link "
            f"'{tree.palm.name()}'; wanted: a hand of 2 to 5 fingers"
        )
    structure.palm = tree.palm_links(paths)
    _hold(structure, tree, paths)
    context = plant.CreateDefaultContext()
    for joints in paths:
        chain = _chain(structure, tree, joints, context)
        if chain is not None:
            structure.chains.append(chain)
    if len(structure.chains) < 2:
        reasons = "; ".join(f"'{name}' {why}" for name, why in structure.held.items())
        raise HandError(f"model {path}: fewer than two fingers can be moved: {reasons}")
    return structure


def _hold(structure: HandStructure, tree: LinkTree, paths: list[list[Joint]]) -> None:
    """Decides which joints cannot be a finger's."""
    held = structure.held
    fingers_of: dict[str, set[int]] = {}
    for number, path in enumerate(paths):
        for joint in path:
            fingers_of.setdefault(joint.name(), set()).add(number)
    heads = {coupling.joint: root(structure.couplings, coupling)[0] for coupling in structure.couplings}
    moved = {name: set(numbers) for name, numbers in fingers_of.items()}
    for follower, leader in heads.items():
        if follower in fingers_of:
            moved[leader] = moved.get(leader, set()) | fingers_of[follower]
    for joint in tree.joints:
        name = joint.name()
        if name in heads:
            continue
        if name not in fingers_of:
            held[name] = "belongs to no finger"
        elif len(moved[name]) > 1:
            held[name] = f"moves {len(moved[name])} fingers at once"
        elif not isinstance(joint, RevoluteJoint):
            held[name] = "is not a revolute joint"
        elif not np.isfinite([joint.position_lower_limit(), joint.position_upper_limit()]).all():
            held[name] = "has no position limits; give it some"
        elif joint.position_lower_limit() >= joint.position_upper_limit():
            held[name] = "has no range between its limits"


def _chain(structure: HandStructure, tree: LinkTree, path: list[Joint], context: Context) -> Chain | None:
    """A finger of joints; None if none of them can be moved."""
    heads = {coupling.joint: root(structure.couplings, coupling)[0] for coupling in structure.couplings}
    names = [joint.name() for joint in path]
    moving = [name for name in names if heads.get(name, name) not in structure.held]
    own = [name for name in moving if name not in heads]
    if not own:
        return None
    last = path[names.index(moving[-1])]
    # What hangs on joints that are held moves along.
    groups = {tree.end(joint) for joint in path[names.index(moving[-1]) :]}
    bodies = [body for body in tree.bodies if tree.group[body.index()] in groups]
    bodies.sort(key=lambda body: body.index() != last.child_body().index())
    links = [body.name() for body in tree.bodies if tree.group[body.index()] in {tree.end(j) for j in path}]
    first = path[names.index(own[0])]
    p_base = first.frame_on_parent().CalcPoseInWorld(context).translation()
    return Chain(tuple(own), tuple(moving), tuple(bodies), (*names, *links), p_base)

"""Finds the palm and the fingers of a hand's model."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RevoluteJoint, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.hands.assembly import detach_from_world, parse_model, position_limits
from geort_drake.hands.chains import PlantFingertips
from geort_drake.hands.couplings import first_leader
from geort_drake.hands.description import CouplingDescription, FingerDescription, HandDescription
from geort_drake.hands.importers.couplings import read_couplings
from geort_drake.hands.importers.link_tree import MAX_FINGERS, LinkTree


@dataclass(frozen=True)
class Chain:
    """The joints of a finger, from the palm to its end.

    Attributes:
        joints: those that move independently.
        moving: these and their followers.
        bodies: the links that move with the last joint, first that joint's own link.
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
        root: name of R.
        couplings: the joints that follow others.
        palm: links of the palm, first the one that carries most fingers.
        chains: the fingers, 2 to 5.
        held: joints that cannot be a finger's, and why.
    """

    path: Path
    plant: MultibodyPlant
    scene_graph: SceneGraph
    hand: ModelInstanceIndex
    root: str
    couplings: list[CouplingDescription]
    palm: list[RigidBody] = field(default_factory=list)
    chains: list[Chain] = field(default_factory=list)
    held: dict[str, str] = field(default_factory=dict)

    def limits(self, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
        """(k,) lower and upper limits of a chain's k independent joints, rad; followers keep theirs."""
        finger = FingerDescription(joints=list(chain.joints))
        return position_limits(self.plant, self._description(finger), self.hand, f"model {self.path}")

    def kinematics(
        self, chain: Chain, link: RigidBody, point: np.ndarray
    ) -> Callable[[np.ndarray], np.ndarray]:
        """A function from angles (N, k) of a chain, rad, to a link's point in R, (N, 3), m."""
        finger = FingerDescription(joints=list(chain.joints), tip_link=link.name(), tip_point=list(point))
        fingertips = PlantFingertips(self.plant, self._description(finger), self.hand, chain.joints)
        return lambda angles: fingertips(angles)[:, 0]

    def _description(self, finger: FingerDescription) -> HandDescription:
        return HandDescription(base_frame=self.root, fingers=[finger], couplings=self.couplings)


def read_structure(path: Path, palm: str | None = None) -> HandStructure:
    """Loads a model and finds its palm and fingers.

    Args:
        path: of the model.
        palm: the link that carries the fingers; by default the one that most chains leave.

    Raises:
        HandError: the model cannot be loaded, has fewer than two fingers, or is more than one hand.
        UnknownNameError: it has no such link.
    """
    if not path.is_file():
        raise HandError(f"the model file {path} is missing")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    hand = parse_model(plant, path, f"model {path}")
    for constraint in plant.GetConstraintIds():
        plant.RemoveConstraint(constraint)
    detach_from_world(plant, hand)
    tree = LinkTree(plant, hand, palm)
    if palm is None:
        tree.require_one_hand(f"model {path}")
    plant.WeldFrames(plant.world_frame(), tree.root.body_frame())
    plant.Finalize()
    structure = HandStructure(path, plant, scene_graph, hand, tree.root.name(), read_couplings(path))
    known = {joint.name() for joint in tree.joints}
    for coupling in structure.couplings:
        for name in (coupling.joint, coupling.follows):
            if name not in known:
                raise HandError(
                    f"model {path}: joint '{coupling.joint}' follows '{coupling.follows}', but the model has "
                    f"no movable joint '{name}'"
                )
    paths = tree.fingers(f"model {path}")
    structure.palm = tree.palm_links(paths)
    leaders = {c.joint: first_leader(structure.couplings, c)[0] for c in structure.couplings}
    structure.held = _held_joints(tree, paths, leaders)
    context = plant.CreateDefaultContext()
    chains = [_chain(structure, tree, joints, leaders, context) for joints in paths]
    structure.chains = [chain for chain in chains if chain is not None]
    if len(structure.chains) < 2:
        in_chains = {joint.name() for path in paths for joint in path}
        reasons = "".join(f"; '{name}' {why}" for name, why in structure.held.items() if name in in_chains)
        raise HandError(
            f"model {path}: {len(structure.chains)} chains of movable revolute joints leave its palm, the "
            f"link '{tree.palm.name()}'; expected a hand of 2 to {MAX_FINGERS} fingers{reasons}"
        )
    return structure


def _held_joints(tree: LinkTree, paths: list[list[Joint]], leaders: dict[str, str]) -> dict[str, str]:
    """The joints that cannot be a finger's, and why."""
    fingers_of: dict[str, set[int]] = {}
    for number, path in enumerate(paths):
        for joint in path:
            fingers_of.setdefault(joint.name(), set()).add(number)
    moved = {name: set(numbers) for name, numbers in fingers_of.items()}
    for follower, leader in leaders.items():
        if follower in fingers_of:
            moved[leader] = moved.get(leader, set()) | fingers_of[follower]
    held = {}
    for joint in tree.joints:
        name = joint.name()
        if name in leaders:
            continue
        if name not in fingers_of:
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
    structure: HandStructure, tree: LinkTree, path: list[Joint], leaders: dict[str, str], context: Context
) -> Chain | None:
    """A finger; None if none of its joints moves independently."""
    names = [joint.name() for joint in path]
    moving = [name for name in names if leaders.get(name, name) not in structure.held]
    own = [name for name in moving if name not in leaders]
    if not own:
        return None
    last = names.index(moving[-1])
    # Links beyond held joints move along.
    groups = {tree.end(joint) for joint in path[last:]}
    bodies = [body for body in tree.bodies if tree.group[body.index()] in groups]
    bodies.sort(key=lambda body: body.index() != path[last].child_body().index())
    all_groups = {tree.end(joint) for joint in path}
    links = [body.name() for body in tree.bodies if tree.group[body.index()] in all_groups]
    first = path[names.index(own[0])]
    p_base = first.frame_on_parent().CalcPoseInWorld(context).translation()
    return Chain(tuple(own), tuple(moving), tuple(bodies), (*names, *links), p_base)

"""A robot hand alone in a Drake plant: exact fingertips, self-collision and kinematics."""

import dataclasses as dc
import hashlib
import json
import os

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    QueryObject,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import RevoluteJoint
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.errors import HandError, naming
from geort_drake.hands.assembly import HandInPlant, add_hand_model, remove_visuals
from geort_drake.hands.description import HandDescription, JointCouplings, load_hand
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.hands.model_files import digest_of_contents, model_files
from geort_drake.hands.model_search import find_model, has_published_model


class Hand(HandInPlant):
    """A robot hand in a plant of its own: kinematics and collisions, with the base B welded to the world.

    q has the order of `joint_names`. Followers move with these joints; all other joints stay at their default
    positions. `tip_geometries` gives the collision geometries that count as fingertips.
    Not thread-safe: the object owns the contexts in which it computes.

    Args:
        hand: a hand description, or its name or file.

    Attributes:
        description: the description of the hand.
        plant, scene_graph, diagram: the hand in Drake, finalized and built.
        instance: the hand's model instance in `plant`.
        couplings: the joints that follow others.
        digest: SHA-256 over the description, the model, its includes and its collision meshes; independent of
            the location of the files and of arm, mount and gains. Meshes of a published model do not count.
        lower, upper: (n,) joint limits, rad, within which followers keep theirs.

    Raises:
        HandError: description or model file are missing or malformed, or the description names a joint, link
            or frame that the model lacks or that does not form a finger.
        UnknownNameError: no hand has that name.
    """

    def __init__(self, hand: HandDescription | str | os.PathLike):
        description = load_hand(hand)
        description.validate()
        path = find_model(description)
        self._what = f"hand '{description.name}' with model {path}"  # for error messages
        builder = DiagramBuilder()
        # Actuators with controller gains need a discrete plant; it is never stepped.
        plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
        super().__init__(plant, description, add_hand_model(plant, description))
        if has_published_model(description):
            model_sha256 = description.source.sha256
        else:
            shapes = map(self.scene_graph.model_inspector().GetShape, self.collision_geometries())
            model_sha256 = digest_of_contents(model_files(path, shapes))
        self.digest = _digest(description, model_sha256)
        with naming(self._what, HandError):
            self._base = self.frame(description.base_frame, "base_frame")
            self._mount = self.frame(description.mount.frame or description.base_frame, "mount.frame")
            plant.WeldFrames(plant.world_frame(), self._base)
            self.couplings = JointCouplings(description)
            followers = [self.joint(name, "couplings", RevoluteJoint) for name in self.couplings.names]
            joints = []
            for finger in description.fingers:
                field = f"fingers.{finger.name}"
                joints += [self.joint(name, f"{field}.joints", RevoluteJoint) for name in finger.joints]
                self.frame(finger.tip_link, f"{field}.tip_link")  # raises an error without one
            for joint in joints:
                _check_range(joint)
            self.lower, self.upper = self.position_limits()
        plant.Finalize()
        self.diagram = builder.Build()

        self._order = np.array([joint.position_start() for joint in (*joints, *followers)])
        self._fingertips = self.forward_kinematics(self.joint_names)
        tips = self.tip_geometries(self.scene_graph.model_inspector())
        self._tip_geometries = set(tips)
        self._contact_context = self.diagram.CreateDefaultContext()
        # In this context, contacts between fingertips are filtered.
        self._beyond_tips_context = self.diagram.CreateDefaultContext()
        self.scene_graph.collision_filter_manager(
            self.scene_graph.GetMyMutableContextFromRoot(self._beyond_tips_context)
        ).Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(tips)))
        # Visual geometry would slow each query down by a tenth.
        for context in (self._contact_context, self._beyond_tips_context):
            remove_visuals(plant, self.scene_graph, context)
        self._default = self.plant.GetPositions(self.plant.GetMyContextFromRoot(self._contact_context)).copy()

    @property
    def joint_names(self) -> list[str]:
        """Names of the n joints, in the order of q."""
        return self.description.joint_names

    @property
    def finger_names(self) -> list[str]:
        """Names of the F fingers, in the order of fingertips."""
        return self.description.finger_names

    @property
    def default_position(self) -> np.ndarray:
        """(n,) initial joint positions, rad."""
        return self._default[self._order[: len(self.joint_names)]]

    @property
    def tip_radius(self) -> float:
        """The largest radius among the fingertip spheres, m."""
        return max(finger.tip_radius for finger in self.description.fingers)

    def sample(self, count: int, seed: int = 0) -> np.ndarray:
        """Draws joint positions (count, n), rad, uniformly within the limits; the same for the same seed."""
        size = (count, len(self.joint_names))
        return np.random.default_rng(seed).uniform(self.lower, self.upper, size)

    def fingertips(self, q: np.ndarray) -> np.ndarray:
        """Computes fingertips p_BF, (N, F, 3) or (F, 3), m, at joint positions q, (N, n) or (n,), rad."""
        p_BF = self._fingertips(self._check(q))
        return p_BF if np.ndim(q) == 2 else p_BF[0]

    def collides(self, q: np.ndarray) -> np.ndarray:
        """Returns whether any two parts of the hand touch: (N,) bool for q (N, n), a bool for q (n,).

        Contacts between links that a joint connects are ignored.
        """
        return self._has_collisions(q, self._contact_context)

    def collides_beyond_tips(self, q: np.ndarray) -> np.ndarray:
        """Does the same as `collides`, but ignores contacts between fingertips."""
        return self._has_collisions(q, self._beyond_tips_context)

    def penetrations(self, q: np.ndarray) -> list[tuple[float, str, str, bool]]:
        """Returns all contacts at q (n,), deepest first.

        A contact has a depth, m, the links' names in alphabetical order, and whether both are fingertips.
        """
        (row,) = self._check(np.asarray(q)[None])
        contacts = []
        for pair in self.query(row, self._contact_context).ComputePointPairPenetration():
            link_a, link_b = sorted((self.link_of(pair.id_A), self.link_of(pair.id_B)))
            contacts.append((pair.depth, link_a, link_b, self.are_tips(pair.id_A, pair.id_B)))
        return sorted(contacts, key=lambda contact: (-contact[0], *contact[1:3]))

    def are_tips(self, geometry_a: GeometryId, geometry_b: GeometryId) -> bool:
        """Whether both collision geometries belong to fingertips."""
        return {geometry_a, geometry_b} <= self._tip_geometries

    def link_of(self, geometry: GeometryId) -> str:
        """Returns the name of the link to which a geometry belongs."""
        frame = self.scene_graph.model_inspector().GetFrameId(geometry)
        return self.plant.GetBodyFromFrameId(frame).name()

    def contact_context(self) -> Context:
        """Creates a context of `diagram` for `query`, in which fingertips do not collide with each other."""
        return self._beyond_tips_context.Clone()

    def query(self, q: np.ndarray, root_context: Context) -> QueryObject:
        """Sets finite q (n,), rad, in a context of `diagram` and returns Drake's geometry query."""
        return self._query(self.couplings.with_followers(q[None])[0], root_context)

    @property
    def p_BW(self) -> np.ndarray:
        """(3,) position of the wrist, the origin of the mount's frame, in the hand base, m."""
        context = self.plant.GetMyContextFromRoot(self._contact_context)
        return self.plant.CalcPointsPositions(context, self._mount, np.zeros(3), self._base)[:, 0]

    def kinematics(self) -> HandKinematics:
        """Returns the fingers as serial chains.

        Raises:
            HandError: the joints that a finger lists are not those between the hand base and its tip.
        """
        with naming(self._what, HandError):
            fingers = tuple(self.finger_chain(finger) for finger in self.description.fingers)
        return HandKinematics(
            fingers=fingers,
            joint_names=tuple(self.joint_names),
            lower=self.lower,
            upper=self.upper,
            tip_radius=self.tip_radius,
            p_BW=self.p_BW,
        )

    def _check(self, q: np.ndarray) -> np.ndarray:
        """Returns q (N, n) or (n,) as (N, n); raises ValueError for another shape or values not finite."""
        rows = np.atleast_2d(np.asarray(q, dtype=float))
        n = len(self.joint_names)
        if np.ndim(q) not in (1, 2) or rows.shape[1] != n:
            raise ValueError(f"q must be of shape ({n},) or (N, {n}), not {np.shape(q)}")
        if not np.isfinite(rows).all():
            raise ValueError("q contains values that are not finite")
        return rows

    def _query(self, row: np.ndarray, root_context: Context) -> QueryObject:
        """Does the same as `query` for q and the followers' positions (n + K,), rad."""
        context = self.plant.GetMyMutableContextFromRoot(root_context)
        positions = self._default.copy()
        positions[self._order] = row
        self.plant.SetPositions(context, positions)
        return self.plant.get_geometry_query_input_port().Eval(context)

    def _has_collisions(self, q: np.ndarray, root_context: Context) -> np.ndarray:
        rows = self.couplings.with_followers(self._check(q))
        hits = np.array([self._query(row, root_context).HasCollisions() for row in rows], dtype=bool)
        return hits if np.ndim(q) == 2 else hits[0]


def _check_range(joint: RevoluteJoint) -> None:
    low, high = joint.position_lower_limit(), joint.position_upper_limit()
    if not np.isfinite([low, high]).all():
        raise HandError(f"joint '{joint.name()}' needs position limits; given: [{low:g}, {high:g}]")
    position = joint.get_default_angle()
    if not low <= position <= high:
        raise HandError(
            f"default_positions.{joint.name()} must be within its limits "
            f"[{low:g}, {high:g}] rad; given: {position:g}"
        )


def _digest(description: HandDescription, model_sha256: str) -> str:
    """Computes SHA-256 over everything that determines the hand's behaviour."""
    facts = dc.asdict(description) | {"model": model_sha256}
    for name in ("mount", "actuation", "source", "motor_order"):
        del facts[name]
    # A field that is not used does not count.
    for name in ("base_pose", "couplings", "collide_as_drawn", "ignored_collisions"):
        if getattr(description, name) == getattr(HandDescription(), name):
            del facts[name]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()

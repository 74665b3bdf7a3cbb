"""A robot hand on its own in a Drake plant: exact fingertips, exact self-collision, exact kinematics."""

import dataclasses as dc
import hashlib
import json
from typing import TYPE_CHECKING

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    QueryObject,
    Role,
    SceneGraphInspector,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import Frame, RevoluteJoint, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.hands.assembly import add_hand_model, joint_names, position_limits
from geort_drake.hands.couplings import JointCouplings
from geort_drake.hands.description import HandDescription
from geort_drake.hands.model_files import digest_of_contents, model_files
from geort_drake.hands.visuals import forget_visuals
from geort_drake.joint_ranges import MAX_ANGLE
from geort_drake.resources import resolve_uri

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics


class HandModel:
    """A hand with its base B welded to the world, which computes from joint positions q.

    `q` is in the order of `joint_names`, the hand description's. Joints that follow one of these move with
    it; what else there is stays at its default. Not thread-safe: the object owns the contexts it computes in.

    A tip here means what `tip_geometries` names.

    Attributes:
        plant, scene_graph, diagram: the hand in Drake, finalized and built.
        instance: the hand's model instance in `plant`.
        couplings: the joints that follow.
        digest: SHA-256 over the description, the model, what it includes and its collision meshes; equal
            hands in other places, or on other arms, have the same.
        lower, upper: (n,) joint limits, rad; those of joints that follow are kept, too.

    Raises:
        HandError: the model file is missing or malformed, or the description names a joint, link or
            frame that the model lacks or that does not form a finger.
    """

    def __init__(self, description: HandDescription):
        description.validate()
        self.description = description
        path = resolve_uri(description.model)
        self._source = f"hand '{description.name}' with model {path}"
        builder = DiagramBuilder()
        # Joint actuators with controller gains need a discrete plant; its time step is never taken.
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
        self.instance = add_hand_model(self.plant, description)
        files = model_files(self.plant, self.scene_graph.model_inspector(), self.instance, path)
        self.digest = _digest(description, digest_of_contents(files))
        self._base = self._frame(description.base_frame, "base_frame")
        self._mount = self._frame(description.mount.frame or description.base_frame, "mount.frame")
        self.plant.WeldFrames(self.plant.world_frame(), self._base)
        self.couplings = JointCouplings.of(description)
        self._followers = [self._joint(name, "couplings", limited=False) for name in self.couplings.names]
        self._joints = [
            self._joint(name, f"fingers.{finger.name}.joints")
            for finger in description.fingers
            for name in finger.joints
        ]
        self._check_default_positions()
        self.lower, self.upper = position_limits(self.plant, description, self.instance, self._source)
        self.plant.Finalize()
        self.diagram = builder.Build()

        self._tips = [
            (self._frame(finger.tip_link, f"fingers.{finger.name}.tip_link"), np.array(finger.tip_point))
            for finger in description.fingers
        ]
        moving = [*self._joints, *self._followers]
        self._order = np.array([joint.position_start() for joint in moving])
        self._tip_geometries = self._find_tip_geometries()
        self._contact_context = self.diagram.CreateDefaultContext()
        # The same hand, blind to contacts between fingertips.
        self._beyond_tips_context = self.diagram.CreateDefaultContext()
        self.scene_graph.collision_filter_manager(
            self.scene_graph.GetMyMutableContextFromRoot(self._beyond_tips_context)
        ).Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(list(self._tip_geometries))))
        # They would take a tenth of each query.
        for context in (self._contact_context, self._beyond_tips_context):
            forget_visuals(self.plant, self.scene_graph, context)
        self._default = self.plant.GetPositions(self.plant.GetMyContextFromRoot(self._contact_context)).copy()

    @property
    def joint_names(self) -> list[str]:
        """The n joints in the order of q."""
        return self.description.joint_names

    @property
    def finger_names(self) -> list[str]:
        """The F fingers in the order of fingertips."""
        return self.description.finger_names

    @property
    def default_position(self) -> np.ndarray:
        """(n,) joint positions the hand starts in, rad."""
        return self._default[self._order[: len(self._joints)]]

    @property
    def tip_radius(self) -> float:
        """The largest radius among the fingertip spheres, m."""
        return max(finger.tip_radius for finger in self.description.fingers)

    def fingertips(self, q: np.ndarray) -> np.ndarray:
        """Fingertip points p_BF, (N, F, 3) or (F, 3) in m, for joint positions q, (N, n) or (n,) in rad."""
        rows = self._rows(q)
        context = self.plant.GetMyMutableContextFromRoot(self._contact_context)
        p_BF = np.empty((len(rows), len(self._tips), 3))
        for row, p_BF_row in zip(rows, p_BF, strict=True):
            self._set_positions(context, row)
            for f, (frame, point) in enumerate(self._tips):
                p_BF_row[f] = self.plant.CalcPointsPositions(context, frame, point, self._base)[:, 0]
        return p_BF if np.ndim(q) == 2 else p_BF[0]

    def collides(self, q: np.ndarray) -> np.ndarray:
        """Whether any two parts of the hand touch: (N,) bool for q (N, n), a bool for q (n,).

        Neighbours along a finger are not counted.
        """
        return self._has_collisions(q, self._contact_context)

    def collides_beyond_tips(self, q: np.ndarray) -> np.ndarray:
        """As `collides`, without contacts of one finger's tip with another's."""
        return self._has_collisions(q, self._beyond_tips_context)

    def penetrations(self, q: np.ndarray) -> list[tuple[float, str, str, bool]]:
        """Every contact at q (n,), deepest first.

        Each is its depth in m, the two links' names in alphabetical order, and whether tip meets tip.
        """
        (row,) = self._rows(np.asarray(q)[None])
        pairs = self._query(row, self._contact_context).ComputePointPairPenetration()
        found = []
        for pair in pairs:
            link_a, link_b = sorted((self.link_of(pair.id_A), self.link_of(pair.id_B)))
            found.append((pair.depth, link_a, link_b, self.are_tips(pair.id_A, pair.id_B)))
        return sorted(found, key=lambda contact: (-contact[0], *contact[1:3]))

    def are_tips(self, geometry_a: GeometryId, geometry_b: GeometryId) -> bool:
        """Whether both collision geometries belong to fingertips."""
        return geometry_a in self._tip_geometries and geometry_b in self._tip_geometries

    def contact_context(self) -> Context:
        """A context of `diagram` of one's own for `query`, in which tips of fingers do not collide."""
        return self._beyond_tips_context.Clone()

    def query(self, q: np.ndarray, root_context: Context) -> QueryObject:
        """Drake's geometry at finite joint positions q (n,), rad, which are set in a context of `diagram`."""
        return self._query(self.couplings.followed_by(q[None])[0], root_context)

    @property
    def p_BW(self) -> np.ndarray:
        """(3,) the wrist in the hand base, m: the origin of the frame that an arm carries."""
        context = self.plant.GetMyContextFromRoot(self._contact_context)
        return self.plant.CalcPointsPositions(context, self._mount, np.zeros(3), self._base)[:, 0]

    def kinematics(self) -> "HandKinematics":
        """The fingers as serial chains for torch, read off the plant."""
        from geort_drake.hands.chains import finger_chain
        from geort_drake.retargeting.training.kinematics import HandKinematics

        return HandKinematics(
            fingers=tuple(
                finger_chain(self.plant, self._base, finger, self.couplings, self.description, self._source)
                for finger in self.description.fingers
            ),
            joint_names=tuple(self.joint_names),
            lower=self.lower,
            upper=self.upper,
            tip_radius=self.tip_radius,
            p_BW=self.p_BW,
        )

    def _rows(self, q: np.ndarray) -> np.ndarray:
        """(N, n + K) positions of the joints of q (N, n) or (n,), and of those that follow them."""
        rows = np.atleast_2d(np.asarray(q, dtype=float))
        n = len(self._joints)
        if np.ndim(q) not in (1, 2) or rows.shape[1] != n:
            raise ValueError(f"q must be of shape ({n},) or (N, {n}), not {np.shape(q)}")
        if not np.isfinite(rows).all():
            raise ValueError("q holds values that are not finite")
        return self.couplings.followed_by(rows)

    def _set_positions(self, context: Context, row: np.ndarray) -> None:
        positions = self._default.copy()
        positions[self._order] = row
        self.plant.SetPositions(context, positions)

    def _query(self, row: np.ndarray, root_context: Context) -> QueryObject:
        context = self.plant.GetMyMutableContextFromRoot(root_context)
        self._set_positions(context, row)
        return self.plant.get_geometry_query_input_port().Eval(context)

    def _has_collisions(self, q: np.ndarray, root_context: Context) -> np.ndarray:
        rows = self._rows(q)
        hits = np.empty(len(rows), dtype=bool)
        for i, row in enumerate(rows):
            hits[i] = self._query(row, root_context).HasCollisions()
        return hits if np.ndim(q) == 2 else hits[0]

    def _find_tip_geometries(self) -> dict[GeometryId, int]:
        """The tips' collision geometries, with the number of the finger they belong to."""
        inspector = self.scene_graph.model_inspector()
        return {
            geometry: number
            for number, (frame, _) in enumerate(self._tips)
            for geometry in tip_geometries(self.plant, inspector, frame.body())
        }

    def link_of(self, geometry: GeometryId) -> str:
        """Name of the link that a geometry belongs to."""
        frame = self.scene_graph.model_inspector().GetFrameId(geometry)
        return self.plant.GetBodyFromFrameId(frame).name()

    def _frame(self, name: str, field: str) -> Frame:
        if not self.plant.HasFrameNamed(name, self.instance):
            frames = [self.plant.get_frame(i).name() for i in self.plant.GetFrameIndices(self.instance)]
            raise self._unknown(field, "frame or link", name, [frame for frame in frames if frame])
        return self.plant.GetFrameByName(name, self.instance)

    def _joint(self, name: str, field: str, limited: bool = True) -> RevoluteJoint:
        movable = joint_names(self.plant, self.instance, RevoluteJoint)
        if name not in movable:
            raise self._unknown(field, "revolute joint", name, movable)
        joint = self.plant.GetJointByName(name, self.instance)
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        if limited and not -MAX_ANGLE <= low <= high <= MAX_ANGLE:
            given = f"it has [{low:g}, {high:g}]" if np.isfinite([low, high]).all() else "it has none"
            raise HandError(
                f"{self._source}: joint '{name}' needs position limits within ±{MAX_ANGLE:g} rad, {given}"
            )
        return joint

    def _check_default_positions(self) -> None:
        for joint in self._joints:
            low, high = joint.position_lower_limit(), joint.position_upper_limit()
            position = joint.get_default_angle()
            if not low <= position <= high:
                raise HandError(
                    f"{self._source}: default_positions.{joint.name()} must be within its limits "
                    f"[{low:g}, {high:g}] rad; given: {position:g}"
                )

    def _unknown(self, field: str, kind: str, given: str, choices: list[str]) -> HandError:
        return HandError(
            f"{self._source}: {field} names the {kind} '{given}', which the model lacks; "
            f"choose one of: {', '.join(choices) or 'none'}"
        )


def tip_geometries(
    plant: MultibodyPlant, inspector: SceneGraphInspector, tip_link: RigidBody
) -> list[GeometryId]:
    """The collision geometries of a finger's tip link whose names contain "tip"; all, where none does."""
    frame = plant.GetBodyFrameIdOrThrow(tip_link.index())
    everything = inspector.GetGeometries(frame, Role.kProximity)
    return [id for id in everything if "tip" in inspector.GetName(id).split("::")[-1]] or everything


def _digest(description: HandDescription, model_sha256: str) -> str:
    """SHA-256 over what decides the hand's behaviour, which its place, its arm and its training do not."""
    facts = dc.asdict(description) | {"model": model_sha256}
    del facts["mount"], facts["actuation"], facts["training"]
    # What a hand does without is no part of it, so that older checkpoints still fit theirs.
    for name in ("base_pose", "couplings", "ignored_collisions"):
        if getattr(description, name) == getattr(HandDescription(), name):
            del facts[name]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()

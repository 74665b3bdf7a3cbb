"""Reads MJCF as MuJoCo compiles it, and builds the same model in a Drake plant.

In MuJoCo's compiled model, defaults, includes, frames, units and references are resolved, and meshes are
read. Drake 1.51 resolves only some of these. MuJoCo is an extra, so this module is imported where it is used.
"""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from pydrake.common import MemoryFile
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.geometry import (
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    Frame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    WeldJoint,
)

from geort_drake.errors import HandError, listed, naming
from geort_drake.hands.description import CouplingDescription

# The name of MuJoCo's world as a link of the hand.
WORLD = "worldbody"
# A tendon couples its joints if its range leaves them at most this much play to either side, rad.
_MAX_PLAY = 0.2
# MuJoCo's constants mjtJoint, mjtGeom, mjtEq, mjtTrn, mjtWrap.
_FREE, _BALL, _SLIDE, _HINGE = range(4)
_PLANE, _HFIELD, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = range(8)
_EQ_CONNECT, _EQ_WELD, _EQ_JOINT, _EQ_TENDON = range(4)
_TRN_JOINT, _TRN_JOINT_IN_PARENT, _TRN_SLIDER_CRANK, _TRN_TENDON = range(4)
_WRAP_JOINT = 1
# Geoms of higher groups are not drawn.
_LAST_VISIBLE_GROUP = 2


def compile_mjcf(path: Path) -> tuple[mujoco.MjModel, list[Path]]:
    """Compiles a model; returns it, and the mesh files that it uses.

    Raises:
        HandError: the model is invalid, or the ends of a range are swapped, which MuJoCo takes for no range.
    """
    try:
        if path.suffix == ".xml":
            spec = mujoco.MjSpec.from_file(str(path))
        else:  # MuJoCo knows files by this suffix alone
            spec = mujoco.MjSpec.from_string(path.read_text(encoding="utf-8"))
            spec.modelfiledir = str(path.resolve().parent)
        model = spec.compile()
    except ValueError as error:
        raise HandError(f"model {path}: {error}") from error
    for kind, ranges in {
        "joint": ("jnt_range", "jnt_actfrcrange"),
        "tendon": ("tendon_range", "tendon_actfrcrange"),
        "actuator": ("actuator_ctrlrange", "actuator_forcerange"),
    }.items():
        for name in ranges:
            for number, (low, high) in enumerate(getattr(model, name)):
                if low > high:
                    raise HandError(
                        f"model {path}: {kind} '{name_of(model, kind, number)}' has the ends of its "
                        f"{name.partition('_')[2]} swapped: {low:g} is above {high:g}"
                    )
    folder = path.resolve().parent / spec.meshdir
    return model, [folder / mesh.file for mesh in spec.meshes if mesh.file]


def add_mjcf(plant: MultibodyPlant, scene_graph: SceneGraph, path: Path) -> ModelInstanceIndex:
    """Adds a model to a plant; its joints start at MuJoCo's reference positions.

    The bodies below MuJoCo's world are not attached to Drake's. If joints connect them to the world, it
    becomes the link `WORLD`, with its geoms if it carries several. What is fixed beside the hand, such as a
    floor or a table, is left out. Friction losses and springs are ignored.

    Raises:
        HandError: as `compile_mjcf`, or Drake cannot represent the model.
    """
    model, _ = compile_mjcf(path)
    name = base = path.stem
    number = 1
    while plant.HasModelInstanceNamed(name):
        number += 1
        name = f"{base}_{number}"
    return _Builder(plant, scene_graph, model, plant.AddModelInstance(name)).build()


class _Builder:
    """Adds a compiled model `m` to a plant."""

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        m: mujoco.MjModel,
        instance: ModelInstanceIndex,
    ):
        self._plant, self._scene_graph, self._m, self._instance = plant, scene_graph, m, instance
        self._links: dict[int, RigidBody] = {}
        self._geometry: dict[int, GeometryId] = {}  # number of a geom → its collision geometry

    def build(self) -> ModelInstanceIndex:
        m, moving = self._m, self._m.body_weldid != 0
        if not moving.any():
            moving[1:] = True
        # Of each tree, the child of the world.
        trees = [body for body in range(1, m.nbody) if m.body_parentid[body] == 0]
        jointed = [body for body in trees if self._joints_of(body)]
        if jointed:
            self._links[0] = self._add_body(WORLD, 0)
        for body in range(1, m.nbody):
            tree = m.body_rootid[body]
            if moving[m.body_rootid == tree].any():
                self._add_link(body)
        for geom in range(m.ngeom):
            body = m.geom_bodyid[geom]
            if body in self._links and (body > 0 or len(jointed) > 1):
                self._add_geom(geom)
        self._filter_collisions()
        self._add_actuators()
        return self._instance

    def _joints_of(self, body: int) -> list[int]:
        """Returns the numbers of a body's joints, except a free one."""
        first, count = self._m.body_jntadr[body], self._m.body_jntnum[body]
        return [j for j in range(first, first + count) if self._m.jnt_type[j] != _FREE]

    def _add_body(self, name: str, body: int | None) -> RigidBody:
        inertia = SpatialInertia.Zero()
        m = self._m
        if body is not None and m.body_mass[body] > 0:
            R = RotationMatrix(Quaternion(m.body_iquat[body])).matrix()
            I = R @ np.diag(m.body_inertia[body]) @ R.T  # noqa: E741  (the usual symbol)
            moments = RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
            inertia = SpatialInertia.MakeFromCentralInertia(m.body_mass[body], m.body_ipos[body], moments)
        return self._plant.AddRigidBody(name, self._instance, inertia)

    def _add_link(self, body: int) -> None:
        """Adds a body with its joints; all but the last joint of a body move links without mass."""
        m = self._m
        name, parent = name_of(m, "body", body), int(m.body_parentid[body])
        self._links[body] = link = self._add_body(name, body)
        if parent not in self._links:
            return  # on the world
        parent_frame = self._links[parent].body_frame()
        X = RigidTransform(Quaternion(m.body_quat[body]), m.body_pos[body])
        joints = self._joints_of(body)
        if not joints:
            if parent:
                self._plant.AddJoint(WeldJoint(f"{name}_weld", parent_frame, link.body_frame(), X))
            return
        for joint in joints:
            child = link
            if joint != joints[-1]:
                child = self._add_body(f"{name}_{name_of(m, 'joint', joint)}", None)
            self._add_joint(joint, parent_frame, X, child)
            parent_frame, X = child.body_frame(), RigidTransform()

    def _add_joint(self, joint: int, parent_frame: Frame, X: RigidTransform, link: RigidBody) -> None:
        """Adds a joint; X is the link's pose in the frame above at the joint's reference position."""
        m, plant, name = self._m, self._plant, name_of(self._m, "joint", joint)
        axis, kind, start = m.jnt_axis[joint], m.jnt_type[joint], m.qpos0[m.jnt_qposadr[joint]]
        X_LM = RigidTransform(m.jnt_pos[joint])
        zero = RigidTransform()
        if kind == _HINGE:
            zero = RigidTransform(AngleAxis(-start, axis), np.zeros(3))
        elif kind == _SLIDE:
            zero = RigidTransform(-start * axis)
        F = plant.AddFrame(
            FixedOffsetFrame(f"{name}_on_parent", parent_frame, X @ X_LM @ zero, self._instance)
        )
        M = plant.AddFrame(FixedOffsetFrame(f"{name}_on_child", link.body_frame(), X_LM, self._instance))
        if kind == _BALL:
            plant.AddJoint(BallRpyJoint(name, F, M))
            return
        low, high = m.jnt_range[joint] if m.jnt_limited[joint] else (-np.inf, np.inf)
        damping = m.dof_damping[m.jnt_dofadr[joint]]
        Axial = RevoluteJoint if kind == _HINGE else PrismaticJoint
        axial_joint = plant.AddJoint(Axial(name, F, M, axis, low, high, damping))
        axial_joint.set_default_positions([start])

    def _add_geom(self, geom: int) -> None:
        m, link = self._m, self._links[int(self._m.geom_bodyid[geom])]
        shape = self._shape(geom)
        if shape is None:
            return
        name = name_of(m, "geom", geom)
        X = RigidTransform(Quaternion(m.geom_quat[geom]), m.geom_pos[geom])
        if m.geom_group[geom] <= _LAST_VISIBLE_GROUP:
            self._plant.RegisterVisualGeometry(link, X, shape, f"{name}_visual", m.geom_rgba[geom])
        if m.geom_contype[geom] or m.geom_conaffinity[geom]:
            if isinstance(shape, Mesh):
                shape = self._hull(geom)
            friction = m.geom_friction[geom][0]
            self._geometry[geom] = self._plant.RegisterCollisionGeometry(
                link, X, shape, name, CoulombFriction(friction, friction)
            )

    def _shape(self, geom: int) -> Shape | None:
        """Returns a geom's shape; None for planes and height fields."""
        m, size, kind = self._m, self._m.geom_size[geom], self._m.geom_type[geom]
        if kind == _SPHERE:
            return Sphere(size[0])
        if kind == _CAPSULE:
            return Capsule(size[0], 2 * size[1])
        if kind == _ELLIPSOID:
            return Ellipsoid(*size)
        if kind == _CYLINDER:
            return Cylinder(size[0], 2 * size[1])
        if kind == _BOX:
            return Box(*(2 * size))
        if kind != _MESH:
            return None
        mesh = m.geom_dataid[geom]
        first, count = m.mesh_faceadr[mesh], m.mesh_facenum[mesh]
        faces = np.stack([m.mesh_face, m.mesh_facenormal], -1)[first : first + count] + 1
        first, count = m.mesh_normaladr[mesh], m.mesh_normalnum[mesh]
        normals = m.mesh_normal[first : first + count]  # Drake's renderers refuse a mesh without
        text = "".join(f"vn {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in normals)
        text += "".join("f " + " ".join(f"{v}//{n}" for v, n in face) + "\n" for face in faces)
        return Mesh(self._obj(mesh, range(m.mesh_vertnum[mesh]), text))

    def _hull(self, geom: int) -> Convex:
        """Returns the convex hull of a mesh, which MuJoCo has computed."""
        m, mesh = self._m, self._m.geom_dataid[geom]
        start = m.mesh_graphadr[mesh]
        count = m.mesh_graph[start]  # then the number of faces, the vertices' edges, and the vertices
        return Convex(self._obj(mesh, m.mesh_graph[start + 2 + count : start + 2 + 2 * count]))

    def _obj(self, mesh: int, vertices: Sequence[int] | np.ndarray, more: str = "") -> InMemoryMesh:
        """Returns an .obj file of some of a mesh's vertices, and lines that follow these."""
        points = self._m.mesh_vert[self._m.mesh_vertadr[mesh] + np.array(vertices)]
        text = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points)
        return InMemoryMesh(mesh_file=MemoryFile(text + more, ".obj", self._m.mesh(mesh).name))

    def _filter_collisions(self) -> None:
        """Filters the pairs that MuJoCo does not check: by masks, excluded bodies, and neighbours."""
        m, filters = self._m, CollisionFilterDeclaration()
        geoms = np.array([*self._geometry], dtype=int)
        contype, conaffinity, body = m.geom_contype[geoms], m.geom_conaffinity[geoms], m.geom_bodyid[geoms]
        masked = (contype[:, None] & conaffinity) | (contype & conaffinity[:, None]) == 0
        group = m.body_weldid[body]  # the first of the bodies that are welded together
        parent_group = m.body_weldid[m.body_parentid[group]]
        neighbours = (
            (group[:, None] == group) | (parent_group[:, None] == group) | (parent_group == group[:, None])
        )
        excluded = np.isin((body[:, None] << 16) + body, m.exclude_signature)
        for first, second in np.argwhere(masked | neighbours | excluded | excluded.T):
            if first < second:
                pair = (GeometrySet(self._geometry[geoms[number]]) for number in (first, second))
                filters.ExcludeBetween(*pair)
        self._scene_graph.collision_filter_manager().Apply(filters)

    def _add_actuators(self) -> None:
        """Adds the joints' motors; position servos, of force gain · (input − position), get gains."""
        m, actuated = self._m, set()
        for motor in range(m.nu):
            joint = int(m.actuator_trnid[motor][0])
            if m.actuator_trntype[motor] not in (_TRN_JOINT, _TRN_JOINT_IN_PARENT) or joint in actuated:
                continue
            name = name_of(m, "joint", joint)
            if m.jnt_type[joint] not in (_HINGE, _SLIDE) or not self._plant.HasJointNamed(
                name, self._instance
            ):
                continue
            actuated.add(joint)
            gear, gain, bias = m.actuator_gear[motor][0], m.actuator_gainprm[motor], m.actuator_biasprm[motor]
            servo = gain[0] > 0 and bias[1] == -gain[0]
            limit = np.inf
            if m.actuator_forcelimited[motor]:
                limit = abs(gear) * m.actuator_forcerange[motor].max()
            elif m.actuator_ctrllimited[motor] and not servo:
                limit = abs(gear * gain[0]) * m.actuator_ctrlrange[motor].max()
            if m.jnt_actfrclimited[joint]:
                limit = min(limit, m.jnt_actfrcrange[joint].max())
            if not limit > 0:
                continue
            actuator = self._plant.AddJointActuator(
                name_of(m, "actuator", motor), self._plant.GetJointByName(name, self._instance), limit
            )
            # MuJoCo's armature belongs to the joint.
            actuator.set_default_rotor_inertia(m.dof_armature[m.jnt_dofadr[joint]])
            if servo:
                actuator.set_controller_gains(PdControllerGains(p=gear**2 * gain[0], d=-(gear**2) * bias[2]))


def name_of(m: mujoco.MjModel, kind: str, number: int) -> str:
    """Returns the name of a body, joint, geom, tendon or actuator, or one made from its number."""
    return getattr(m, kind)(number).name or f"{kind}_{number}"


def read_mjcf_couplings(path: Path) -> tuple[list[CouplingDescription], list[str]]:
    """Reads couplings by equalities and fixed tendons; returns them, and notes on guesses and omissions.

    MuJoCo's equalities relate deviations from the joints' reference positions, or from the tendon's length in
    these. A fixed tendon of two joints couples them if an equality fixes its length, if its range leaves
    little play, or if a motor pulls it and none moves either joint. In the last case, both joints are assumed
    to be equally stiff, so they turn in proportion to their coefficients. The joint without a motor follows,
    else the outer one.

    Raises:
        HandError: as `compile_mjcf`, or a coupling is not linear.
    """
    m, _ = compile_mjcf(path)
    with naming(path, HandError):
        couplings, lengths, notes = _read_equalities(m)
    coupled = [{coupling.joint, coupling.follows} for coupling in couplings.values()]
    motor_joints = {name_of(m, "joint", joint) for joint in _driven(m, _TRN_JOINT, _TRN_JOINT_IN_PARENT)}
    motor_tendons = _driven(m, _TRN_TENDON)
    ignored = []
    for tendon in range(m.ntendon):
        coefficients = _fixed_tendon(m, tendon)
        if {*coefficients} in coupled:
            continue
        coupling = None
        if len(coefficients) == 2:
            leader, joint = coefficients
            if leader not in motor_joints and joint in motor_joints:
                leader, joint = joint, leader
            coefficient, leading = coefficients[joint], coefficients[leader]
            length = lengths.get(tendon, _narrow_length(m, tendon, min(abs(coefficient), abs(leading))))
            if length is not None:
                coupling = CouplingDescription(joint, leader, -leading / coefficient, length / coefficient)
            elif tendon in motor_tendons and not {joint, leader} & motor_joints:
                coupling = CouplingDescription(joint, leader, coefficient / leading, 0.0)
                notes.append(
                    f"one motor pulls '{leader}' and '{joint}'; assuming equal stiffness, '{joint}' follows "
                    f"by {coupling.ratio:g}"
                )
        if coupling is not None:
            couplings.setdefault(coupling.joint, coupling)
        elif tendon in motor_tendons:
            ignored.append(f"'{name_of(m, 'tendon', tendon)}'")
    if ignored:
        notes.append(
            f"tendons that motors pull are ignored, their joints move independently: {listed(ignored)}"
        )
    return list(couplings.values()), notes


def _read_equalities(
    m: mujoco.MjModel,
) -> tuple[dict[str, CouplingDescription], dict[int, float], list[str]]:
    """Returns the couplings of joints, by follower, the lengths of tendons that are fixed, and notes."""
    couplings: dict[str, CouplingDescription] = {}
    lengths: dict[int, float] = {}
    notes = []
    for number in np.flatnonzero(m.eq_active0):
        kind, first, second = m.eq_type[number], int(m.eq_obj1id[number]), int(m.eq_obj2id[number])
        constant, ratio, *higher = m.eq_data[number][:5]
        if kind == _EQ_JOINT and second >= 0:
            follower, leader = name_of(m, "joint", first), name_of(m, "joint", second)
            if any(higher):
                raise HandError(
                    f"joint '{follower}' follows '{leader}' by a polynomial; expected two coefficients, "
                    f"given: {m.eq_data[number][:5]}"
                )
            start, leader_start = m.qpos0[m.jnt_qposadr[[first, second]]]
            offset = start + constant - ratio * leader_start
            couplings[follower] = CouplingDescription(follower, leader, float(ratio), float(offset))
        elif kind == _EQ_TENDON and second < 0:
            lengths[first] = float(m.tendon_length0[first] + constant)
        elif kind in (_EQ_CONNECT, _EQ_WELD) and 0 not in (first, second):
            which = "site" if m.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE.value else "body"
            ends = [f"'{name_of(m, which, end)}'" for end in (first, second)]
            notes.append(f"the closed loop at {' and '.join(ends)} is ignored: a hand must be a tree")
    return couplings, lengths, notes


def _driven(m: mujoco.MjModel, *transmissions: int) -> set[int]:
    """Returns the numbers of the joints or tendons that motors drive by these kinds of transmission."""
    motors = (motor for motor in range(m.nu) if m.actuator_trntype[motor] in transmissions)
    return {int(m.actuator_trnid[motor][0]) for motor in motors}


def _fixed_tendon(m: mujoco.MjModel, tendon: int) -> dict[str, float]:
    """Maps the joints of a fixed tendon, inner ones first, to their coefficients; empty for a spatial one."""
    parts = range(m.tendon_adr[tendon], m.tendon_adr[tendon] + m.tendon_num[tendon])
    if any(m.wrap_type[part] != _WRAP_JOINT for part in parts):
        return {}
    joints = {int(m.wrap_objid[part]): float(m.wrap_prm[part]) for part in parts if m.wrap_prm[part] != 0}
    return {name_of(m, "joint", joint): coefficient for joint, coefficient in sorted(joints.items())}


def _narrow_length(m: mujoco.MjModel, tendon: int, coefficient: float) -> float | None:
    """Returns the middle of a tendon's range if the range leaves its joints little play, else None."""
    low, high = m.tendon_range[tendon]
    narrow = m.tendon_limited[tendon] and 0.5 * (high - low) / coefficient <= _MAX_PLAY
    return float(0.5 * (low + high)) if narrow else None

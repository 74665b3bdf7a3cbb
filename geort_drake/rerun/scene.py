"""The bodies of a plant as Rerun entities: their shapes, poses and contact forces."""

import warnings
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
from pydrake.geometry import GeometryId, Role, SceneGraph, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import OutputPort
from scipy.spatial.transform import Rotation

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.hands.hand import Hand
from geort_drake.rerun.meshes import draw_mesh
from geort_drake.rerun.specs import Spec, column_name
from geort_drake.rerun.writer import PALETTE, SOLID, WORLD, Writer, entity_path, transform, xyzw
from geort_drake.systems.contacts import bodies_of_geometries, contact_rows
from geort_drake.systems.drawing import diffuse_color, drawn_geometries, solid_of

_TRANSLUCENT = 90  # opacity, of 255
_CONTACT_COLOR: Color = (255, 200, 40)
_ARROWS, _SERIES = f"/{WORLD}/contact/forces", "/contact/force"

# Kind of a solid → name of the entity, archetype, and function of the solid's size.
_SOLIDS: dict[str, tuple[str, Any, Callable[[list[float]], dict]]] = {
    "box": ("boxes", rr.Boxes3D, lambda size: {"sizes": size}),
    "ellipsoid": ("ellipsoids", rr.Ellipsoids3D, lambda size: {"half_sizes": size}),
    "cylinder": ("cylinders", rr.Cylinders3D, lambda size: {"radii": size[0], "lengths": size[1]}),
    "capsule": ("capsules", rr.Capsules3D, lambda size: {"radii": size[0], "lengths": size[1]}),
}


@dataclass
class PlantSpec(Spec):
    """Records the bodies of a plant: their shapes, and poses X_WB of the moving ones in rows (bodies, 3, 4).

    Attributes:
        paths: entity path of each body of the plant, by its index.
        moving: indices of the bodies whose poses are recorded, in plant order.
        anchored: X_WB of the drawn bodies that are welded to the world, by index.
        shapes: entity path and archetype of each geometry.
        body_of_geometry: body index of each proximity geometry.
        reach: largest distance of a moving body's geometry from the body's origin, m.
    """

    paths: list[str]
    moving: list[int] = field(default_factory=list)
    anchored: dict[int, RigidTransform] = field(default_factory=dict)
    shapes: list[tuple[str, rr.AsComponents]] = field(default_factory=list)
    body_of_geometry: dict[GeometryId, int] = field(default_factory=dict)
    reach: float = 0.0

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {key: plant_port(key)}

    def read(self, body_poses: Sequence[RigidTransform]) -> np.ndarray:
        return np.array([body_poses[i].GetAsMatrix34() for i in self.moving]).reshape(-1, 3, 4)

    def write(self, writer: Writer, key: str, rows: Sequence[np.ndarray]) -> None:
        for index, X_WB in self.anchored.items():
            writer.static(self.paths[index], transform(X_WB))
        for path, archetype in self.shapes:
            writer.static(path, archetype)
        X_WB = np.reshape(rows, (len(rows), len(self.moving), 3, 4))
        writer.poses([self.paths[i] for i in self.moving], X_WB)

    def samples(self, key: str, rows: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        X_WB = np.reshape(rows, (len(rows), len(self.moving), 3, 4))
        columns = {}
        for number, i in enumerate(self.moving):
            wxyz = Rotation.from_matrix(X_WB[:, number, :, :3]).as_quat(scalar_first=True)
            name = self.paths[i].removeprefix(f"/{WORLD}")
            columns[f"pose.{column_name(name)}"] = np.hstack([wxyz, X_WB[:, number, :, 3]])
        return columns

    def translucent_shapes(self, body: int) -> dict[str, rr.AsComponents]:
        """Returns entity path → override that makes it translucent, for each shape of a body."""
        inside = f"{self.paths[body]}/"
        shapes = {path: _translucent(shape) for path, shape in self.shapes if path.startswith(inside)}
        return {path: style for path, style in shapes.items() if style is not None}


@dataclass(frozen=True)
class ContactSpec(Spec):
    """Records contact forces, in rows from `contact_rows`.

    Attributes:
        groups: name → bodies whose contact forces are summed to one time series, such as the links of a
            finger: {"thumb": [link_12, ...]}. By default each touched moving body has its own.
        metres_per_newton: length of the arrows per force, m/N.
        max_length: largest length of the arrows, m.
        scene: the bodies; the recorder gives its own.
    """

    groups: Mapping[str, Sequence[RigidBody]] | None = None
    metres_per_newton: float = 0.02
    max_length: float = 0.25
    scene: PlantSpec = field(default_factory=lambda: PlantSpec([]))

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {key: plant_port(key)}

    def read(self, results: ContactResults) -> np.ndarray:
        return contact_rows(results, self.scene.body_of_geometry)

    def write(self, writer: Writer, key: str, rows: Sequence[np.ndarray]) -> None:
        writer.static(_ARROWS, rr.Arrows3D.from_fields(colors=[_CONTACT_COLOR], radii=[0.0025]))
        contacts = np.concatenate([np.empty((0, 8)), *rows])
        counts = np.array([len(row) for row in rows], dtype=int)
        force = contacts[:, 5:]
        arrows = self.metres_per_newton * force
        length = np.linalg.norm(arrows, axis=1, keepdims=True)
        arrows *= np.minimum(1.0, self.max_length / np.maximum(length, 1e-12))
        # One of the two bodies usually hides one of the two arrows.
        columns = rr.Arrows3D.columns(
            origins=np.repeat(contacts[:, 2:5], 2, axis=0),
            vectors=np.stack([arrows, -arrows], axis=1).reshape(-1, 3),
        )
        writer.columns(_ARROWS, columns.partition(2 * counts))
        groups: dict[str, tuple[str, list[int]]] = writer.memory.setdefault(_SERIES, {})
        for number, (path, (name, total)) in enumerate(self._totals(groups, rows).items()):
            finger = FINGER_COLOURS.get(name)
            color = PALETTE[number % len(PALETTE)] if finger is None else rgb(finger)
            writer.series(path, [name], total[:, None], [color], 1.5)

    def samples(self, key: str, rows: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        return {column_name(path): total for path, (_, total) in self._totals({}, rows).items()}

    def _totals(
        self, groups: dict[str, tuple[str, list[int]]], rows: Sequence[np.ndarray]
    ) -> dict[str, tuple[str, np.ndarray]]:
        """Returns entity path → name and sum of forces (T,), N, of each series.

        Args:
            groups: entity path → name and bodies of the series so far; a body has one from its first contact
                on.
        """
        contacts = np.concatenate([np.empty((0, 8)), *rows])
        bodies, magnitude = contacts[:, :2].astype(int), np.linalg.norm(contacts[:, 5:], axis=1)
        sample = np.repeat(np.arange(len(rows)), [len(row) for row in rows])
        if self.groups is not None:
            for name, members in self.groups.items():
                groups[entity_path(_SERIES, name)] = name, [int(body.index()) for body in members]
        else:
            for i in sorted({*bodies.ravel()} & {*self.scene.moving}):
                path = self.scene.paths[i].removeprefix(f"/{WORLD}")
                groups.setdefault(_SERIES + path, (path[1:], [i]))
        totals = {}
        for path, (name, members) in groups.items():
            member = np.zeros(len(self.scene.paths), dtype=bool)
            member[members] = True
            # Only forces that act on the group from outside count.
            crossing = member[bodies[:, 0]] != member[bodies[:, 1]]
            totals[path] = name, np.bincount(sample[crossing], magnitude[crossing], minlength=len(rows))
        return totals


def describe_plant(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    role: Role = Role.kIllustration,
    followed_bodies: Collection = (),
    root: str = f"/{WORLD}",
) -> PlantSpec:
    """Reads the geometry of a finalized plant.

    A body without geometry of the role is drawn with its proximity geometry; a body that has neither is not
    drawn. A geometry that cannot be drawn is left out, with a warning that names it.

    Args:
        followed_bodies: indices of bodies whose poses are recorded even if nothing is drawn.
        root: entity path of the world frame.
    """
    inspector = scene_graph.model_inspector()
    bodies = [plant.get_body(index) for index in map(BodyIndex, range(plant.num_bodies()))]
    scene = PlantSpec(
        paths=[root + _body_path(plant, body) for body in bodies],
        body_of_geometry=bodies_of_geometries(plant, inspector),
    )
    defaults = plant.CreateDefaultContext()
    for body in bodies:
        index = int(body.index())
        geometries, drawn_role = drawn_geometries(plant, inspector, body, role)
        scene.shapes += _draw(inspector, geometries, drawn_role, scene.paths[index])
        if not (geometries or index in followed_bodies):
            continue
        if plant.IsAnchored(body):
            scene.anchored[index] = plant.EvalBodyPoseInWorld(defaults, body)
        else:
            scene.moving.append(index)
            scene.reach = max([scene.reach, *(_reach(inspector, geometry) for geometry in geometries)])
    return scene


def write_robot_hand(
    writer: Writer, path: str, hand: Hand, q: np.ndarray, X_WB: RigidTransform | None = None
) -> None:
    """Sends a robot hand at joint positions q (T, n), rad, one row for each of the writer's times.

    Args:
        path: entity path of the hand base B, the frame of all entities below it.
        X_WB: pose of the hand base; by default the identity.
    """
    writer.static(path, transform(X_WB or RigidTransform()))
    scene = describe_plant(hand.plant, hand.scene_graph, root=path)
    root = hand.contact_context()
    context = hand.plant.GetMyContextFromRoot(root)
    port = hand.plant.get_body_poses_output_port()
    rows = []
    for positions in q:
        hand.query(positions, root)
        rows.append(scene.read(port.Eval(context)))
    scene.write(writer, path, rows)


def _body_path(plant: MultibodyPlant, body: RigidBody) -> str:
    if body.index() == plant.world_body().index():
        return "/environment"
    model = plant.GetModelInstanceName(body.model_instance())
    return entity_path(*model.split("::"), body.name())


def _reach(inspector: SceneGraphInspector, geometry: GeometryId) -> float:
    """Returns the radius, m, of a sphere around the body's origin that contains the geometry's box.

    It is 0 for a half space, and for a mesh that Drake cannot read.
    """
    try:
        box = inspector.GetObbInGeometryFrame(geometry)
    except RuntimeError:
        box = None
    if box is None:
        return 0.0
    p_BC = inspector.GetPoseInFrame(geometry) @ box.center()
    return float(np.linalg.norm(p_BC) + np.linalg.norm(box.half_width()))


def _draw(
    inspector: SceneGraphInspector, geometries: Sequence[GeometryId], role: Role, body_path: str
) -> list[tuple[str, rr.AsComponents]]:
    """Returns the archetypes that draw a body's geometry, in the body's frame.

    All shapes of a kind share an entity: a robot has hundreds of shapes, and entities cost space and time.
    """
    batches: dict[str, dict[str, list]] = defaultdict(lambda: defaultdict(list))
    shapes: list[tuple[str, rr.AsComponents]] = []
    for geometry in geometries:
        shape = inspector.GetShape(geometry)
        X_BG = inspector.GetPoseInFrame(geometry)
        color = [round(255 * value) for value in diffuse_color(inspector, geometry)]
        name = inspector.GetName(geometry).rsplit("::", 1)[-1]
        if solid := solid_of(shape):
            kind, size = solid
            row = {"labels": name, "colors": color, "quaternions": xyzw(X_BG)}
            if kind == "capsule":
                # Drake centres a capsule; Rerun's begins at its origin.
                row["translations"] = X_BG @ [0.0, 0.0, -size[1] / 2]
            else:
                row["centers"] = X_BG.translation()
            for key, value in (row | _SOLIDS[kind][2](size)).items():
                batches[kind][key].append(value)
        elif mesh := draw_mesh(inspector, geometry, role, color):
            shapes += [(f"{body_path}{entity_path(name, part)}", archetype) for part, archetype in mesh]
        else:
            message = f"geometry {inspector.GetName(geometry)}: cannot draw a {type(shape).__name__}"
            warnings.warn(message, stacklevel=4)
    for kind, columns in batches.items():
        entity, archetype, _ = _SOLIDS[kind]
        # The viewer shows the name of a geometry when it is selected.
        shapes.append((f"{body_path}/{entity}", archetype(**columns, fill_mode=SOLID, show_labels=False)))
    return shapes


def _translucent(shape: Any) -> rr.AsComponents | None:
    """Returns an override for the opacity of a shape; None for other archetypes."""
    if isinstance(shape, rr.Mesh3D | rr.Asset3D):
        # The factor multiplies the colours of textures.
        factor = shape.albedo_factor
        rgba = 0xFFFFFFFF if factor is None else int(factor.as_arrow_array()[0].as_py())
        return type(shape).from_fields(albedo_factor=(rgba & 0xFFFFFF00) | _TRANSLUCENT)
    colors = getattr(shape, "colors", None)
    if colors is None:
        return None
    rgba = colors.as_arrow_array().to_numpy()
    return type(shape).from_fields(colors=(rgba & np.uint32(0xFFFFFF00)) | np.uint32(_TRANSLUCENT))

"""What a plant looks like, as Rerun entities: every body's path and every geometry's shape."""

import warnings
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    HalfSpace,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody

from geort_drake.rerun.meshes import draw_mesh

WORLD = "world"
_DEFAULT_COLOR = Rgba(0.75, 0.75, 0.78, 1.0)  # geometry that brings no colour
_GLASS = 90  # opacity, of 255
_HALF_SPACE_SIDE = 2.0  # m; a half space is drawn as a square


@dataclass
class Scene:
    """The bodies of a plant that are worth drawing, and how to draw them.

    Attributes:
        paths: entity path of every body of the plant, by its index.
        moving: indices of the drawn bodies whose pose changes, in plant order.
        anchored: X_WB of the drawn bodies that are welded to the world, by index.
        shapes: entity path and archetype of all geometry, which does not change.
        body_of_geometry: body index of every proximity geometry, for contact surfaces.
    """

    paths: list[str]
    moving: list[int] = field(default_factory=list)
    anchored: dict[int, RigidTransform] = field(default_factory=dict)
    shapes: list[tuple[str, rr.AsComponents]] = field(default_factory=list)
    body_of_geometry: dict[GeometryId, int] = field(default_factory=dict)


def describe_scene(
    plant: MultibodyPlant, scene_graph: SceneGraph, role: Role, wanted: Collection = ()
) -> Scene:
    """Reads the geometry of a finalized plant from its scene graph.

    A body without geometry of the wanted role is drawn with its proximity geometry; one that has
    neither is not drawn. A geometry that cannot be drawn is left out with a warning that names it.

    Args:
        wanted: indices of bodies whose poses are wanted also where nothing of them is drawn.
    """
    inspector = scene_graph.model_inspector()
    bodies = [plant.get_body(index) for index in map(BodyIndex, range(plant.num_bodies()))]
    scene = Scene(paths=[_body_path(plant, body) for body in bodies])
    defaults = plant.CreateDefaultContext()
    for body in bodies:
        index = int(body.index())
        frame = plant.GetBodyFrameIdIfExists(body.index())
        if frame is None:
            continue
        proximity = inspector.GetGeometries(frame, Role.kProximity)
        scene.body_of_geometry.update(dict.fromkeys(proximity, index))
        visible = inspector.GetGeometries(frame, role)
        geometries = visible or proximity
        drawn_role = role if visible else Role.kProximity
        scene.shapes += _draw(inspector, geometries, drawn_role, scene.paths[index])
        if not (geometries or index in wanted):
            continue
        if plant.IsAnchored(body):
            scene.anchored[index] = plant.EvalBodyPoseInWorld(defaults, body)
        else:
            scene.moving.append(index)
    return scene


def entity_path(*keys: str) -> str:
    """An entity path of keys that may themselves hold slashes; odd characters are escaped."""
    return "/" + "/".join(_part(part) for key in keys for part in key.split("/") if part)


def _body_path(plant: MultibodyPlant, body: RigidBody) -> str:
    if body.index() == plant.world_body().index():
        return f"/{WORLD}/environment"
    model = plant.GetModelInstanceName(body.model_instance())
    return entity_path(WORLD, *model.split("::"), body.name())


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)


def _draw(
    inspector: SceneGraphInspector, geometries: Sequence[GeometryId], role: Role, body_path: str
) -> list[tuple[str, rr.AsComponents]]:
    """The archetypes that draw a body's geometry, placed in the body's frame.

    All shapes of one kind are one entity: a robot has hundreds, and entities cost space and time.
    """
    batches: dict[str, _Batch] = defaultdict(_Batch)
    drawn: list[tuple[str, rr.AsComponents]] = []
    for geometry in geometries:
        shape = inspector.GetShape(geometry)
        X_BG = inspector.GetPoseInFrame(geometry)
        color = _color(inspector, geometry)
        name = inspector.GetName(geometry).rsplit("::", 1)[-1]
        if isinstance(shape, Box):
            batches["boxes"].add(name, color, X_BG, sizes=shape.size())
        elif isinstance(shape, HalfSpace):
            sizes = [_HALF_SPACE_SIDE, _HALF_SPACE_SIDE, 0.002]
            batches["boxes"].add(name, color, _shifted(X_BG, -0.001), sizes=sizes)
        elif isinstance(shape, Sphere):
            batches["ellipsoids"].add(name, color, X_BG, half_sizes=[shape.radius()] * 3)
        elif isinstance(shape, Ellipsoid):
            batches["ellipsoids"].add(name, color, X_BG, half_sizes=[shape.a(), shape.b(), shape.c()])
        elif isinstance(shape, Cylinder):
            batches["cylinders"].add(name, color, X_BG, lengths=shape.length(), radii=shape.radius())
        elif isinstance(shape, Capsule):
            # Drake centres a capsule; Rerun's runs from z = 0 to its length.
            X_BC = _shifted(X_BG, -shape.length() / 2)
            batches["capsules"].add(name, color, X_BC, lengths=shape.length(), radii=shape.radius())
        elif mesh := draw_mesh(inspector, geometry, role, color):
            drawn += [(f"{body_path}/{_part(name)}", archetype) for archetype in mesh]
        else:
            kind = type(shape).__name__
            warnings.warn(f"geometry {inspector.GetName(geometry)}: cannot draw a {kind}", stacklevel=4)
    drawn += [(f"{body_path}/{kind}", batch.archetype(kind)) for kind, batch in batches.items()]
    return drawn


class _Batch:
    """Shapes of one kind on one body."""

    def __init__(self) -> None:
        self._columns: dict[str, list] = defaultdict(list)

    def add(self, name: str, color: list[int], X_BG: RigidTransform, **dimensions: Any) -> None:
        row = {"labels": name, "colors": color, "at": X_BG.translation(), "quaternions": _xyzw(X_BG)}
        for key, value in (row | dimensions).items():
            self._columns[key].append(value)

    def archetype(self, kind: str) -> rr.AsComponents:
        columns = dict(self._columns)
        columns["translations" if kind == "capsules" else "centers"] = columns.pop("at")
        maker = {
            "boxes": rr.Boxes3D,
            "ellipsoids": rr.Ellipsoids3D,
            "cylinders": rr.Cylinders3D,
            "capsules": rr.Capsules3D,
        }[kind]
        # The names of the geometries are kept for whoever selects one.
        return maker(**columns, fill_mode=rr.components.FillMode.Solid, show_labels=False)


def _color(inspector: SceneGraphInspector, geometry: GeometryId) -> list[int]:
    for properties in (
        inspector.GetIllustrationProperties(geometry),
        inspector.GetPerceptionProperties(geometry),
        inspector.GetProximityProperties(geometry),
    ):
        if properties is not None and properties.HasProperty("phong", "diffuse"):
            rgba: Any = properties.GetProperty("phong", "diffuse")
            break
    else:
        rgba = _DEFAULT_COLOR
    return [round(255 * value) for value in (rgba.r(), rgba.g(), rgba.b(), rgba.a())]


def as_of_glass(shape: Any) -> rr.AsComponents | None:
    """What makes a view draw a shape so that one sees through it; None where that is no shape."""
    if isinstance(shape, rr.Mesh3D | rr.Asset3D):
        # It is multiplied with the colours of the corners and of pictures.
        factor = shape.albedo_factor
        rgba = 0xFFFFFFFF if factor is None else int(factor.as_arrow_array()[0].as_py())
        return type(shape).from_fields(albedo_factor=(rgba & 0xFFFFFF00) | _GLASS)
    colors = getattr(shape, "colors", None)
    if colors is None:
        return None
    rgba = colors.as_arrow_array().to_numpy()
    return type(shape).from_fields(colors=(rgba & np.uint32(0xFFFFFF00)) | np.uint32(_GLASS))


def _shifted(X_BG: RigidTransform, z: float) -> RigidTransform:
    return RigidTransform(X_BG.rotation(), X_BG @ [0.0, 0.0, z])


def transform(X: RigidTransform) -> rr.Transform3D:
    """A pose as Rerun's archetype."""
    return rr.Transform3D(translation=X.translation(), quaternion=rr.Quaternion(xyzw=_xyzw(X)))


def _xyzw(X: RigidTransform) -> np.ndarray:
    return np.roll(X.rotation().ToQuaternion().wxyz(), -1)

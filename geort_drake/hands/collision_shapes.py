"""Converts a hand's collision geometry to plain arrays, for training without Drake."""

from itertools import product

import numpy as np
from pydrake.geometry import Box, CalcObb, Capsule, Convex, Cylinder, Mesh, Role, Shape, Sphere

from geort_drake.errors import HandError
from geort_drake.hands.hand import Hand
from geort_drake.hands.kinematics import CollisionShapes, lattice_directions
from geort_drake.hands.links import joint_paths

_CYLINDER_SIDES = 12


def collision_shapes(hand: Hand) -> CollisionShapes:
    """Returns the convex shapes of a hand, and the pairs of them that must not touch.

    Boxes, spheres and capsules stay the same. A cylinder becomes a prism of equal cross-sectional area. Of a
    mesh's convex hull, those vertices are kept that lie outermost in the `lattice_directions` of its oriented
    bounding box. Pairs that Drake filters and pairs of fingertips are left out.

    Raises:
        HandError: the hand has a collision geometry of another kind.
    """
    plant, inspector = hand.plant, hand.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    moving = list(hand.kinematics().uncoupled()[0].joint_names)
    paths = joint_paths(plant, hand.instance)
    joint, X_JS, vertices, radius, source = [], [], [], [], []
    for geometry in sorted(inspector.GetAllGeometryIds(Role.kProximity), key=lambda id: id.get_value()):
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        if body.index() == plant.world_body().index():
            continue
        X_WG = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4() @ (
            inspector.GetPoseInFrame(geometry).GetAsMatrix4()
        )
        movers = [each for each in paths[body.index()] if each.name() in moving]
        if not movers:
            X_WJ = np.eye(4)  # the hand base is welded to the world
        else:
            X_WJ = movers[-1].frame_on_child().CalcPoseInWorld(context).GetAsMatrix4()
        X_GS, points, r = _hull(inspector.GetShape(geometry), inspector.GetName(geometry))
        joint.append(moving.index(movers[-1].name()) if movers else -1)
        X_JS.append(np.linalg.inv(X_WJ) @ X_WG @ X_GS)
        vertices.append(points)
        radius.append(r)
        source.append(geometry)
    pairs = [
        (i, j)
        for i, a in enumerate(source)
        for j, b in enumerate(source[:i])
        if joint[i] != joint[j] and not inspector.CollisionFiltered(a, b) and not hand.are_tips(a, b)
    ]
    most = max(map(len, vertices), default=1)
    return CollisionShapes(
        np.array(joint, dtype=int),
        np.array(X_JS).reshape(-1, 4, 4),
        np.array([np.resize(points, (most, 3)) for points in vertices]).reshape(-1, most, 3),
        np.array(radius),
        np.array(pairs, dtype=int).reshape(-1, 2),
    )


def canonical_shapes(hand: Hand) -> CollisionShapes:
    """Returns the hand's collision shapes; a left hand's are mirrored as by `canonical_kinematics`.

    Raises:
        HandError: as `collision_shapes`.
    """
    shapes = collision_shapes(hand)
    return shapes.mirrored() if hand.description.side == "left" else shapes


def _hull(shape: Shape, name: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns pose in the shape's frame, vertices, m, and radius, m, of a shape as in `CollisionShapes`."""
    X_GS, corners = np.eye(4), np.array(list(product((-1.0, 1.0), repeat=3)))
    if isinstance(shape, Box):
        return X_GS, 0.5 * shape.size() * corners, 0.0
    if isinstance(shape, Sphere):
        return X_GS, np.zeros((1, 3)), shape.radius()
    if isinstance(shape, Capsule):
        return X_GS, 0.5 * shape.length() * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), shape.radius()
    if isinstance(shape, Cylinder):
        angle = 2.0 * np.pi / _CYLINDER_SIDES
        radius = shape.radius() * np.sqrt(angle / np.sin(angle))
        turns = angle * np.arange(_CYLINDER_SIDES)
        ends = np.repeat([[-0.5 * shape.length()], [0.5 * shape.length()]], _CYLINDER_SIDES, axis=0)
        side = radius * np.column_stack([np.cos(turns), np.sin(turns)])
        return X_GS, np.hstack([np.tile(side, (2, 1)), ends]), 0.0
    if isinstance(shape, Convex | Mesh):
        X_GS = CalcObb(shape).pose().GetAsMatrix4()
        hull = shape.GetConvexHull()
        points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        points = (points - X_GS[:3, 3]) @ X_GS[:3, :3]
        return X_GS, points[np.unique(np.argmax(points @ lattice_directions().T, axis=0))], 0.0
    raise unsupported_shape(shape, name)


def unsupported_shape(shape: Shape, name: str) -> HandError:
    """Makes the error for collision geometry that is no box, sphere, cylinder, capsule or mesh."""
    return HandError(
        f"collision geometry '{name}' is a {type(shape).__name__}; "
        "choose one of: box, sphere, cylinder, capsule, mesh"
    )

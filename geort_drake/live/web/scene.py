"""Describes a plant's shapes for the page, and the poses of its bodies."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Convex, GeometryId, Mesh, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from geort_drake.hands.description import HandDescription
from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.world import ARM, HAND
from geort_drake.systems.drawing import diffuse_color, drawn_geometries, hull, load_triangles, solid_of
from geort_drake.systems.joint_limits import actuated_joints
from geort_drake.systems.port_values import pose_to_vector

# View → direction from the middle of hand and objects to the eye, and the distance in radii of both. In all
# views, left is left for a person who moves the robot.
_VIEWS = {
    "overview": (np.array([-0.50, -0.75, 0.45]), 3.6),
    "close": (np.array([-0.35, -0.80, 0.35]), 2.1),
    "shoulder": (np.array([-0.85, -0.30, 0.55]), 3.6),
}
_HAND_M = 0.16  # from a hand's base to its fingertips


class PageScene:
    """The geometry of a finalized plant.

    Attributes:
        description: contents of `/scene`, except the scene's number.
        meshes: contents of `/mesh/N`.
        moving: indices of the bodies that move, in the order of a frame.

    Args:
        plant: finalized plant.
        inspector: inspector of its scene graph.
        hand: description of its hand.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        hand: HandDescription,
    ):
        self._inspector, self._is_left = inspector, hand.side == "left"
        self.meshes: list[bytes] = []
        self.moving: list[BodyIndex] = []
        base = plant.GetFrameByName(hand.base_frame, plant.GetModelInstanceByName(HAND))
        defaults = plant.CreateDefaultContext()
        geometries: list[dict[str, Any]] = []
        for body in map(plant.get_body, map(BodyIndex, range(plant.num_bodies()))):
            ids, _ = drawn_geometries(plant, inspector, body)
            number = None
            if not plant.IsAnchored(body) and (ids or body.index() == base.body().index()):
                number = len(self.moving)
                self.moving.append(body.index())
            for geometry in ids:
                X = inspector.GetPoseInFrame(geometry)
                if number is None:
                    X = plant.EvalBodyPoseInWorld(defaults, body) @ X
                if shape := self._shape(geometry):
                    item = {
                        "moving": number,
                        "pose": _numbers(X),
                        "color": diffuse_color(inspector, geometry),
                    }
                    geometries.append(item | shape)
        names = [plant.get_body(index).scoped_name().get_full() for index in self.moving]
        robot = {
            plant.GetModelInstanceByName(name) for name in (HAND, ARM) if plant.HasModelInstanceNamed(name)
        }
        things = [index for index in self.moving if plant.get_body(index).model_instance() not in robot]
        X_WB = base.CalcPoseInWorld(defaults)
        points = [X_WB.translation(), X_WB @ [0.0, 0.0, _HAND_M]]
        points += [
            plant.EvalBodyPoseInWorld(defaults, plant.get_body(index)).translation() for index in things
        ]
        self.description = {
            "views": _views(np.array(points)),
            "moving": names,
            "hand_base": {
                "moving": self.moving.index(base.body().index()),
                "pose": _numbers(base.GetFixedPoseInBodyFrame()),
            },
            "geometries": geometries,
        }

    def frame(self, time: float, poses: list[RigidTransform], p_HK: np.ndarray | None) -> bytes:
        """Returns the binary message of one moment.

        Args:
            time: s.
            poses: X_WB by body index.
            p_HK: the person's keypoints (21, 3), m in H, a left hand mirrored; None while the hand is lost.
        """
        points = np.full((21, 3), np.nan) if p_HK is None else mirrored(p_HK) if self._is_left else p_HK
        parts = [pose_to_vector(poses[index]) for index in map(int, self.moving)]
        return np.concatenate([[time], *parts, points.ravel()]).astype("<f4").tobytes()

    def _shape(self, geometry: GeometryId) -> dict[str, Any] | None:
        shape = self._inspector.GetShape(geometry)
        if solid := solid_of(shape):
            kind, size = solid
            return {"shape": kind, "size": size}
        if isinstance(shape, Mesh | Convex) and (triangles := self._triangles(geometry, shape)) is not None:
            self.meshes.append(np.asarray(triangles, "<f4").tobytes())
            return {"shape": "mesh", "url": f"/mesh/{len(self.meshes) - 1}"}
        name = self._inspector.GetName(geometry)
        warnings.warn(f"geometry {name}: cannot draw a {type(shape).__name__}", stacklevel=3)
        return None

    def _triangles(self, geometry: GeometryId, shape: Mesh | Convex) -> np.ndarray | None:
        """Returns triangles (n, 3, 3), m, from the file of a mesh, or else of its convex hull."""
        source = shape.source()
        if isinstance(shape, Mesh) and source.is_path():
            try:
                return load_triangles(Path(source.path()), shape.scale3())
            except Exception as error:  # trimesh raises errors of many kinds
                name = self._inspector.GetName(geometry)
                warnings.warn(f"geometry {name}: drawn as its convex hull; {error}", stacklevel=4)
        return hull(self._inspector, geometry)


def _views(points: np.ndarray) -> dict[str, dict[str, list[float]]]:
    """Returns eye and target of each view of points (n, 3), m."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) + 0.05
    eyes = {name: middle + far * radius * way / np.linalg.norm(way) for name, (way, far) in _VIEWS.items()}
    return {
        name: {"eye": eye.round(4).tolist(), "target": middle.round(4).tolist()} for name, eye in eyes.items()
    }


def _numbers(X: RigidTransform) -> list[float]:
    return [round(value, 6) for value in pose_to_vector(X).tolist()]


def measured_poses(plant: MultibodyPlant) -> Callable[[Mapping[str, np.ndarray]], list[RigidTransform]]:
    """Returns a function from the measured joints of a real robot to X_WB by body index.

    Its argument maps hand and arm to their positions (rad), then velocities (rad/s), in actuator order.

    Args:
        plant: finalized plant of the robot.
    """
    context = plant.CreateDefaultContext()
    joints = {name: actuated_joints(plant, plant.GetModelInstanceByName(name)) for name in (HAND, ARM)}
    bodies = [plant.get_body(BodyIndex(index)) for index in range(plant.num_bodies())]

    def poses(states: Mapping[str, np.ndarray]) -> list[RigidTransform]:
        q = plant.GetPositions(context)
        for name, group in joints.items():
            q[[joint.position_start() for joint in group]] = states[name][: len(group)]
        plant.SetPositions(context, q)
        return [plant.EvalBodyPoseInWorld(context, body) for body in bodies]

    return poses

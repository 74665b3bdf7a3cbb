"""A robot hand in given positions, for recordings in which nothing is simulated."""

import dataclasses as dc
from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.comparison.metrics import PENETRATION
from geort_drake.hands.model import HandModel
from geort_drake.rerun.scene import WORLD, describe_scene, entity_path, transform
from geort_drake.rerun.tracks import PoseTrack
from geort_drake.rerun.writer import Writer

_LABEL_HEIGHT = 0.235  # m
RIGHT, WRONG = (90, 255, 120), (255, 50, 50)  # no finger has such colours


class PosedHand:
    """A hand as entities below `path`, in its base frame B.

    Args:
        hand: its model.
        key: entity path, under /world.
        X_WB: where the hand stands in the recording.
    """

    def __init__(self, hand: HandModel, key: str, X_WB: RigidTransform):
        self.path = entity_path(WORLD, key)
        self._hand, self._X_WB = hand, X_WB
        scene = describe_scene(hand.plant, hand.scene_graph, Role.kIllustration)
        self._scene = dc.replace(
            scene,
            paths=[self._moved(path) for path in scene.paths],
            shapes=[(self._moved(path), shape) for path, shape in scene.shapes],
        )
        self._poses = PoseTrack(self._scene)
        self._root = hand.diagram.CreateDefaultContext()
        plant: MultibodyPlant = hand.plant
        self._context: Context = plant.GetMyMutableContextFromRoot(self._root)
        joints = [plant.GetJointByName(name) for name in (*hand.joint_names, *hand.couplings.names)]
        self._order = [joint.position_start() for joint in joints]

    def describe(self, writer: Writer) -> None:
        """Sends the hand's shapes and where it stands."""
        writer.static(self.path, transform(self._X_WB))
        for index, X_BL in self._scene.anchored.items():
            writer.static(self._scene.paths[index], transform(X_BL))
        for path, shape in self._scene.shapes:
            writer.static(path, shape)

    def write(self, writer: Writer, q: np.ndarray) -> None:
        """Sends joint positions q (T, n), rad, one row for each of the writer's times."""
        poses = self._hand.plant.get_body_poses_output_port()
        rows = []
        for _ in self._each(q):
            rows.append(self._poses.read(poses.Eval(self._context)))
        self._poses.write(writer, rows)

    def collisions(self, q: np.ndarray) -> list[np.ndarray]:
        """For each of q (T, n), where parts are over 2 mm inside each other: (k, 3) in B, m.

        Fingertips inside fingertips do not count, as in `metrics.self_collision`.
        """
        query = self._hand.plant.get_geometry_query_input_port()
        found = []
        for _ in self._each(q):
            deep = [
                (pair.p_WCa + pair.p_WCb) / 2
                for pair in query.Eval(self._context).ComputePointPairPenetration()
                if pair.depth > PENETRATION and not self._hand.are_tips(pair.id_A, pair.id_B)
            ]
            found.append(np.array(deep).reshape(-1, 3))
        return found

    def _each(self, q: np.ndarray) -> Iterator[None]:
        positions = self._hand.plant.GetPositions(self._context).copy()
        for row in self._hand.couplings.followed_by(q):
            positions[self._order] = row
            self._hand.plant.SetPositions(self._context, positions)
            yield

    def _moved(self, path: str) -> str:
        return self.path + path.removeprefix(f"/{WORLD}")


def write_balls(
    writer: Writer,
    path: str,
    rows: Sequence[np.ndarray],
    radius: float,
    colors: Sequence[int] | Sequence[Sequence[int]] | Sequence[np.ndarray],
    cage: bool = False,
) -> None:
    """Sends balls around points (k, 3), m, of which there may be more and less as time goes by.

    Args:
        colors: one for all, one for each ball of a row where all rows have as many, or (k, 3) for each row.
        cage: three circles each, through which one sees what is inside.
    """
    fill = rr.components.FillMode.MajorWireframe if cage else rr.components.FillMode.Solid
    writer.static(path, rr.Ellipsoids3D.from_fields(fill_mode=fill, line_radii=[0.0007]))
    counts = [len(row) for row in rows]
    centers = np.concatenate([np.empty((0, 3)), *rows])
    shades = list(colors) if np.ndim(colors[0]) == 2 else [np.broadcast_to(colors, row.shape) for row in rows]
    columns = rr.Ellipsoids3D.columns(
        centers=centers,
        half_sizes=np.full_like(centers, radius),
        colors=np.concatenate([np.empty((0, 3)), *shades]).astype(np.uint8),
    )
    writer.columns(path, columns.partition(counts))


def write_label(writer: Writer, path: str, text: str, color: Color, X: RigidTransform | None = None) -> None:
    """Sends a name above a hand that stands at X."""
    where = (X or RigidTransform()) @ [0.0, 0.0, _LABEL_HEIGHT]
    label = rr.Points3D([where], labels=[text], show_labels=True, radii=[0.0], colors=[color])
    writer.static(f"{path}/name", label)


def write_lines(
    writer: Writer, path: str, rows: Sequence[np.ndarray], colors: Sequence[np.ndarray], radius: float
) -> None:
    """Sends line segments (k, 2, 3), m, with a colour (k, 3) each."""
    writer.static(path, rr.LineStrips3D.from_fields(radii=[radius]))
    counts = [len(row) for row in rows]
    strips = np.concatenate([np.empty((0, 2, 3)), *rows])
    shades = np.concatenate([np.empty((0, 3), np.uint8), *colors]).astype(np.uint8)
    columns = rr.LineStrips3D.columns(strips=strips, colors=shades)
    writer.columns(path, columns.partition(counts))


def finger_colors(hand: HandModel) -> list[Color]:
    """One for each finger, in the model's order."""
    return [rgb(FINGER_COLOURS[name]) for name in hand.finger_names]

"""A robot hand in given joint positions, for recordings without a simulation."""

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.hands.model import HandModel
from geort_drake.rerun.scene import describe_scene
from geort_drake.rerun.writer import Writer, transform


def write_robot_hand(
    writer: Writer, path: str, hand: HandModel, q: np.ndarray, X_WB: RigidTransform | None = None
) -> None:
    """Sends a hand at joint positions q (T, n), rad, one row for each of the writer's times.

    Args:
        path: entity path of the hand base B, the frame of all entities below it.
        X_WB: pose of the hand base.
    """
    writer.static(path, transform(X_WB or RigidTransform()))
    scene = describe_scene(hand.plant, hand.scene_graph, root=path)
    scene.write(writer)
    root = hand.contact_context()
    context = hand.plant.GetMyContextFromRoot(root)
    port = hand.plant.get_body_poses_output_port()
    rows = np.empty((len(q), len(scene.moving), 3, 4))
    for row, positions in zip(rows, q, strict=True):
        hand.query(positions, root)
        poses = port.Eval(context)
        row[:] = [poses[i].GetAsMatrix34() for i in scene.moving]
    writer.poses([scene.paths[i] for i in scene.moving], rows)

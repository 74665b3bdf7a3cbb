"""A Rerun recording of a hand that moves joint by joint, with its fingertip points and its base."""

from pathlib import Path

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from geort_drake.colours import FINGER_COLOURS, rgb
from geort_drake.hands.assembly import add_hand_model
from geort_drake.hands.couplings import JointCouplings
from geort_drake.hands.model import HandModel
from geort_drake.rerun.recorder import PointsSpec, add_rerun_recorder

_FRAMES_PER_JOINT, _RATE = 24, 30.0  # pictures, and how many a second
_AXES = {"x": (230, 60, 60), "y": (60, 180, 60), "z": (60, 90, 230)}
_AXIS_POINTS = np.linspace(0.0, 0.12, 25)  # m


def record_hand(hand: HandModel, path: Path) -> None:
    """Writes a recording in which each joint goes through its range.

    The base's axes are drawn x red, y green, z blue.
    """
    description = hand.description
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
    model = add_hand_model(plant, description)
    base = plant.GetFrameByName(description.base_frame, model)
    plant.WeldFrames(plant.world_frame(), base)
    plant.Finalize()
    points = {}
    for number, (axis, color) in enumerate(_AXES.items()):
        line = np.outer(_AXIS_POINTS, np.eye(3)[number]).ravel()
        source = builder.AddNamedSystem(f"axis_{axis}", ConstantVectorSource(line))
        points[f"hand_base/{axis}"] = PointsSpec(source.get_output_port(), base, 0.002, color)
    for finger in description.fingers:
        source = builder.AddNamedSystem(f"tip_{finger.name}", ConstantVectorSource(finger.tip_point))
        frame = plant.GetFrameByName(finger.tip_link, model)
        # Of glass, around the tip that the model draws.
        glass = (*rgb(FINGER_COLOURS[finger.name]), 130)
        points[f"tips/{finger.name}"] = PointsSpec(
            source.get_output_port(), frame, 1.25 * finger.tip_radius, glass
        )
    recorder = add_rerun_recorder(
        builder, plant, scene_graph, path, period=1.0 / _RATE, contact=False, points=points
    )
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    couplings = JointCouplings.of(description)
    names = [*hand.joint_names, *couplings.names]
    joints = [plant.GetJointByName(name, model) for name in names]
    with recorder:
        for number, q in enumerate(couplings.followed_by(_sweep(hand))):
            root.SetTime(number / _RATE)
            for joint, angle in zip(joints, q, strict=True):
                joint.set_angle(context, angle)
            diagram.ForcedPublish(root)


def _sweep(hand: HandModel) -> np.ndarray:
    """(N, n) postures: from the start, each joint to its lower limit, to its upper one, and back."""
    start = hand.default_position
    postures = [start[None]]
    for joint, (low, high) in enumerate(zip(hand.lower, hand.upper, strict=True)):
        stops = np.array([start[joint], low, high, start[joint]])
        rows = np.tile(start, (_FRAMES_PER_JOINT, 1))
        rows[:, joint] = np.interp(np.linspace(0, 3, _FRAMES_PER_JOINT), np.arange(4), stops)
        postures.append(rows)
    return np.concatenate(postures)

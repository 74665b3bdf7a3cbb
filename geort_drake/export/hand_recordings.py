"""Writes Rerun recordings of one hand: a person's, or a robot hand that moves joint by joint."""

import os
from collections.abc import Sequence

import numpy as np

from geort_drake.colours import FINGER_COLOURS, finger_colors, rgb
from geort_drake.hands.hand import Hand
from geort_drake.people.coverage import tip_distances
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import Recording, newest
from geort_drake.rerun import layout as views
from geort_drake.rerun.scene import write_robot_hand
from geort_drake.rerun.writer import SOLID, LineStrips3D, file_writer

_RATE, _FRAMES_PER_JOINT = 30.0, 24  # of a robot hand: frames per second and per joint
_AXES = {"x": (230, 60, 60), "y": (60, 180, 60), "z": (60, 90, 230)}
_AXIS_LENGTH = 0.12  # m


def write_hand(
    recording: Recording,
    path: str | os.PathLike,
    fps: float = 30.0,
    steps: Sequence[str] | None = None,
) -> None:
    """Writes a hand in its wrist frame H, the gaps between thumb and fingertips, and a robot's joints.

    Args:
        recording: recording of the hand.
        path: .rrd file to write.
        fps: frames per second; each frame contains the latest sample.
        steps: name of the protocol's step in each frame of the recording, shown in a lane.
    """
    t = recording.t - recording.t[0]
    times = np.arange(int(t[-1] * fps + 1e-6) + 1) / fps
    rows = newest(t, times)
    p_HK = np.where(recording.valid[:, None, None], recording.p_HK.astype(float), np.nan)[rows]
    facts = {key: value for key, value in recording.metadata.items() if isinstance(value, str | int | float)}
    plots: list[views.View] = [
        views.time_series("distance from the thumb's tip [mm]", ["/gap/**"], legend=True)
    ]
    if recording.robot is not None:
        plots.append(views.time_series("joint angles [rad]", ["/robot/**"]))
    if steps:
        plots.append(views.StateTimelineView(origin="/", contents=["/step"], name="phase"))
    scene = views.scene_view((0.34, -0.30, 0.33), (0.02, 0.0, 0.09))
    layout = views.blueprint(views.Horizontal(scene, views.Vertical(*plots), column_shares=[3, 2]))
    with file_writer(
        path,
        application_id="geort_drake_hand",
        recording_id=f"hand-{recording.digest}-{fps:g}",
        blueprint=layout,
        properties=facts,
    ) as writer:
        writer.at(times)
        writer.human_hand("/world/human", p_HK)
        others = FINGER_NAMES[1:]
        colors = finger_colors(others)
        writer.series("/gap/thumb", others, 1e3 * tip_distances(p_HK), colors)
        if recording.robot is not None:
            writer.series("/robot", recording.metadata["robot_signals"], recording.robot[rows])
        if steps:
            labels = list(dict.fromkeys(steps))
            writer.states("/step", [labels.index(steps[frame]) for frame in rows], labels)


def write_joint_sweep(hand: Hand, path: str | os.PathLike) -> None:
    """Writes a robot hand that moves each joint through its range, with its fingertips and base frame.

    The base's axes are x red, y green, z blue.
    """
    q = _sweep(hand)
    tips = hand.fingertips(q)
    reach = float(np.abs(tips).max())
    scene = views.scene_view(2.0 * reach * np.array([1.0, -0.8, 0.8]), (0.0, 0.0, 0.4 * reach))
    with file_writer(
        path,
        application_id="geort_drake_robot_hand",
        recording_id=f"hand-{hand.digest}",
        blueprint=views.blueprint(scene),
        properties={"hand": hand.description.name},
    ) as writer:
        writer.at(np.arange(len(q)) / _RATE)
        write_robot_hand(writer, "/world/hand", hand, q)
        for number, (axis, color) in enumerate(_AXES.items()):
            line = [[np.zeros(3), _AXIS_LENGTH * np.eye(3)[number]]]
            writer.static(f"/world/hand_base/{axis}", LineStrips3D(line, radii=0.002, colors=[color]))
        for number, finger in enumerate(hand.description.fingers):
            # A translucent sphere around the tip that the model draws.
            translucent = (*rgb(FINGER_COLOURS[finger.name]), 130)
            rows = list(tips[:, [number]])
            writer.points(f"/world/tips/{finger.name}", rows, 1.25 * finger.tip_radius, translucent, SOLID)


def _sweep(hand: Hand) -> np.ndarray:
    """Makes postures (N, n), rad: each joint moves from the start to its lower and upper limit and back."""
    start = hand.default_position
    postures = [start[None]]
    for joint, (low, high) in enumerate(zip(hand.lower, hand.upper, strict=True)):
        stops = np.array([start[joint], low, high, start[joint]])
        rows = np.tile(start, (_FRAMES_PER_JOINT, 1))
        rows[:, joint] = np.interp(np.linspace(0, 3, _FRAMES_PER_JOINT), np.arange(4), stops)
        postures.append(rows)
    return np.concatenate(postures)

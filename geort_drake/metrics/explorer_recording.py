"""Writes the retargeting explorer: a Rerun recording of a hand next to each method's robot hand."""

import itertools
import os
from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.colours import SKIN, Color, finger_colors
from geort_drake.hands.hand import Hand
from geort_drake.metrics.exploration import Response
from geort_drake.metrics.metrics import Pinches, find_pinches
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import Recording
from geort_drake.rerun import layout as views
from geort_drake.rerun.scene import write_robot_hand
from geort_drake.rerun.writer import CAGE, SOLID, WORLD, Property, Writer, entity_path, file_writer

_CLOSED_COLOR, _FAULT_COLOR = (90, 255, 120), (255, 50, 50)  # no finger has these colours
APPLICATION = "geort_drake_explorer"
_SPACING = 0.26  # m, between neighbouring hands
_LABEL_HEIGHT = 0.235  # m
_HUMAN_TIP_RADIUS = 0.0085  # m
_PINCH_LANE = "asked_pinch"
# Colours of the methods in the plots; no finger or mark has them.
_COLORS: tuple[Color, ...] = ((240, 228, 66), (178, 132, 255), (213, 94, 0), (0, 220, 200), (190, 190, 190))
_COPY_COLOR = (235, 235, 235)
_IDLE: Color = (58, 62, 71)
_STATES = ("–", "closed", "open", "collides")
_STATE_COLORS: tuple[Color, ...] = (_IDLE, (44, 160, 44), (230, 120, 20), (214, 39, 40))

_TEXT = """\
Left: the **recorded hand**. Next to it: the robot hand with each method, which gets only the fingertips.

| in these {seconds:.0f} s | {headings} |
|---|{rule}
{rows}

- **Fingertips** have the colour of their finger.
- **White cages**: a proportional copy of the human fingertip.
- **A cage around two fingertips**: the person pinches. On the robot it is green if its fingertips meet, and
  red if they do not.
- **Red spheres**: parts of the hand penetrate each other by over 2 mm.
- **Lines** in the plots have the colour of the name above the hand.
"""


def write_exploration(
    path: str | os.PathLike,
    hand: Hand,
    hands: Recording,
    methods: Mapping[str, Response],
    properties: Mapping[str, Property],
) -> None:
    """Writes the explorer's recording.

    Args:
        path: .rrd file to write.
        hands: `excerpt` of the person's recording.
        methods: name of each method → its outputs.
        properties: properties of the recording.
    """
    p_HK = hands.p_HK.astype(float)
    p_HK = mirrored(p_HK) if hand.description.side == "left" else p_HK
    tips = p_HK[:, hand.description.human_keypoints]
    pinches = find_pinches(tips, hand.finger_names)
    with file_writer(
        path,
        application_id=APPLICATION,
        recording_id=f"explorer-{properties['recording_sha256']}-{hands.metadata['start_s']:g}-{'-'.join(methods)}",
        blueprint=views.blueprint(_layout(list(methods))),
        properties=properties,
    ) as writer:
        writer.text("/about", _text(hands, methods, pinches))
        writer.at(hands.t)
        _write_human(writer, hand, p_HK, tips, pinches)
        for number, (color, (name, response)) in enumerate(
            zip(itertools.cycle(_COLORS), methods.items(), strict=False), start=1
        ):
            hand_path = entity_path(WORLD, name)
            # All wrists are at the same height.
            X_WB = RigidTransform([0.0, _SPACING * number, -hand.p_BW[2]])
            write_robot_hand(writer, hand_path, hand, response.q, X_WB)
            writer.label(f"{hand_path}/name", name, color, (0.0, 0.0, _LABEL_HEIGHT))
            _write_marks(writer, hand_path, hand, response, pinches)
            curves = {
                "error": 1e3 * response.error.mean(axis=1),
                "motion": response.cosine,
                "gap": 1e3 * response.gap,
                "posture": np.degrees(response.angle.mean(axis=1)),
            }
            for key, values in curves.items():
                writer.series(entity_path(key, name), [name], values[:, None], [color])
        _write_lanes(writer, hand, methods, pinches)


def _write_human(writer: Writer, hand: Hand, p_HK: np.ndarray, tips: np.ndarray, pinches: Pinches) -> None:
    path = entity_path(WORLD, "human")
    writer.human_hand(path, p_HK, SKIN)
    colors = [np.array(finger_colors(hand.finger_names))] * len(tips)
    writer.points(f"{path}/tips", list(tips), _HUMAN_TIP_RADIUS, colors, SOLID)
    _write_pinches(writer, path, tips, pinches, np.full((len(tips), 3), 255), 1.8 * _HUMAN_TIP_RADIUS)
    writer.label(f"{path}/name", "recorded hand", SKIN, (0.0, 0.0, _LABEL_HEIGHT))
    writer.series("/gap/human", ["human"], 1e3 * pinches.distance[:, None], [SKIN], 2.5)


def _write_marks(writer: Writer, path: str, hand: Hand, response: Response, pinches: Pinches) -> None:
    radius = 1.1 * hand.tip_radius  # covers the model's tip
    tip_colors = [np.array(finger_colors(hand.finger_names))] * len(response.q)
    writer.points(f"{path}/tips", list(response.p_BF), radius, tip_colors, SOLID)
    writer.points(f"{path}/copy", list(response.copy), 1.1 * radius, _COPY_COLOR, CAGE)
    colors = np.where(response.closed[:, None], _CLOSED_COLOR, _FAULT_COLOR)
    _write_pinches(writer, path, response.p_BF, pinches, colors, 2.2 * radius)
    writer.points(f"{path}/collisions", response.collisions, 0.014, _FAULT_COLOR, SOLID)


def _write_pinches(
    writer: Writer, path: str, tips: np.ndarray, pinches: Pinches, colors: np.ndarray, radius: float
) -> None:
    """Draws a cage of colours (T, 3) around the midpoint of the tips that should meet."""
    middle, pinched = pinches.of(tips).mean(axis=1), pinches.closed.astype(int)
    rows = [point[None][:count] for point, count in zip(middle, pinched, strict=True)]
    shades = [color[None][:count] for color, count in zip(colors, pinched, strict=True)]
    writer.points(f"{path}/pinch", rows, radius, shades, CAGE)


def _write_lanes(writer: Writer, hand: Hand, methods: Mapping[str, Response], pinches: Pinches) -> None:
    codes = np.where(pinches.closed, 1.0 + pinches.pair[:, 1], 0.0)
    labels = ("–", *hand.finger_names)
    writer.states(entity_path(_PINCH_LANE), codes, labels, [_IDLE, *finger_colors(hand.finger_names)])
    for name, response in methods.items():
        collides = np.array([len(points) > 0 for points in response.collisions])
        pinch = np.where(response.closed, 1.0, 2.0)
        codes = np.where(collides, 3.0, np.where(pinches.closed, pinch, 0.0))
        writer.states(entity_path(name), codes, _STATES, _STATE_COLORS)


def _layout(methods: Sequence[str]) -> views.View:
    middle = np.array([0.0, _SPACING * len(methods) / 2, 0.115])
    distance = max(0.42, 0.08 + 0.62 * _SPACING * (len(methods) + 1))
    eye = middle + np.array([distance, 0.0, 0.2 * distance])
    lanes = [entity_path(name) for name in (_PINCH_LANE, *methods)]
    left = views.Vertical(
        views.scene_view(eye, middle, "recorded hand and robot hands"),
        views.StateTimelineView(origin="/", contents=lanes, name="pinches and collisions"),
        row_shares=[1.0, views.lanes_share(len(lanes), 1.0)],
    )
    right = views.Vertical(
        views.TextDocumentView(origin="/about", name="what you see"),
        views.time_series("fingertips against a proportional copy [mm]", ["/error/**"]),
        views.time_series("direction of motion kept (cosine)", ["/motion/**"]),
        views.time_series("nearest thumb and finger [mm]", ["/gap/**"]),
        views.time_series("posture: angle between last links [°]", ["/posture/**"]),
        row_shares=[2.5, 1.0, 1.0, 1.0, 1.0],
    )
    return views.Horizontal(left, right, column_shares=[5, 3])


def _text(hands: Recording, methods: Mapping[str, Response], pinches: Pinches) -> str:
    responses, pinched = methods.values(), pinches.closed
    table = {
        "fingertips against a copy": [f"{1e3 * a.error.mean():.0f} mm" for a in responses],
        "direction of motion kept": [f"{np.nanmean(a.cosine):.2f}" for a in responses],
        "posture: angle of the last links": [f"{np.degrees(np.median(a.angle)):.0f}°" for a in responses],
        "pinches closed": [f"{a.closed[pinched].mean():.0%}" if pinched.any() else "–" for a in responses],
        "self-collision": [f"{np.mean([len(points) > 0 for points in a.collisions]):.1%}" for a in responses],
    }
    return _TEXT.format(
        seconds=hands.t[-1],
        headings=" | ".join(methods),
        rule="---:|" * len(methods),
        rows="\n".join(f"| {title} | {' | '.join(values)} |" for title, values in table.items()),
    )

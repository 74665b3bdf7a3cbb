"""The retargeting explorer: a Rerun recording of a hand and of each method's answers, side by side."""

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.colours import SKIN, Color, finger_colors
from geort_drake.comparison.exploration import Answers, Excerpt, Pinches, find_pinches, tips_of
from geort_drake.comparison.metrics import PENETRATION
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import mirrored
from geort_drake.rerun import blueprint as views
from geort_drake.rerun.robot_hand import write_robot_hand
from geort_drake.rerun.streams import Property, file_writer
from geort_drake.rerun.writer import CAGE, SOLID, WORLD, Writer, entity_path

_RIGHT, _WRONG = (90, 255, 120), (255, 50, 50)  # no finger has these colours
APPLICATION = "geort_drake_explorer"
_SPACING = 0.26  # m, between neighbouring hands
_LABEL_HEIGHT = 0.235  # m
_HUMAN_TIP = 0.0085  # m, radius
_PINCH_LANE = "asked_pinch"
# Of the methods in the plots; no finger or mark has them.
_COLORS: tuple[Color, ...] = ((240, 228, 66), (178, 132, 255), (213, 94, 0), (0, 220, 200), (190, 190, 190))
_COPY_COLOR = (235, 235, 235)
_IDLE: Color = (58, 62, 71)
_STATES = {0: "–", 1: "closed", 2: "open", 3: "collides"}
_STATE_COLORS: tuple[Color, ...] = (_IDLE, (44, 160, 44), (230, 120, 20), (214, 39, 40))

_TEXT = """\
Left: the **recorded hand**. Beside it: the answer of each method to its fingertips alone.

| in these {seconds:.0f} s | {headings} |
|---|{rule}
{rows}

- **Fingertips** have the colour of their finger.
- **White cages**: a proportional copy of the human fingertip.
- **A cage around two fingertips**: the person pinches. On the robot it is green if its fingertips meet, and
  red if they do not.
- **Red balls**: parts of the hand penetrate each other by over 2 mm.
- **Lines** in the plots have the colour of the name above the hand.
"""


@dataclass(frozen=True)
class _Marks:
    """Pinches and collisions in the answers of a method.

    Attributes:
        gap: (T,) distance of the robot's tips of the pair that is nearest in the person's hand, m.
        closed: (T,) whether these tips meet.
        collisions: T times (k, 3) in B, m.
    """

    gap: np.ndarray
    closed: np.ndarray
    collisions: list[np.ndarray]


def write_exploration(
    path: str | os.PathLike,
    hand: HandModel,
    hands: Excerpt,
    methods: Mapping[str, Answers],
    properties: Mapping[str, Property],
) -> None:
    """Writes the recording.

    Args:
        path: .rrd to write.
        hands: of the person.
        methods: name of a method → its answers.
        properties: of the recording.
    """
    p_HK = mirrored(hands.p_HK) if hand.description.side == "left" else hands.p_HK
    pinches = find_pinches(tips_of(p_HK, hand), hand.finger_names)
    marks = {name: _marks(hand, answers, pinches) for name, answers in methods.items()}
    with file_writer(
        path,
        application_id=APPLICATION,
        recording_id=f"explorer-{properties['recording_sha256']}-{hands.start:g}-{'-'.join(methods)}",
        blueprint=views.blueprint(_layout(list(methods))),
        properties=properties,
    ) as writer:
        writer.up_axis()
        writer.text("/about", _text(hands, methods, marks, pinches))
        writer.at(hands.t)
        _write_human(writer, hand, p_HK, pinches)
        for number, (color, (name, answers)) in enumerate(
            zip(itertools.cycle(_COLORS), methods.items(), strict=False), start=1
        ):
            hand_path = entity_path(WORLD, name)
            # Wrists are side by side.
            X_WB = RigidTransform([0.0, _SPACING * number, -hand.p_BW[2]])
            write_robot_hand(writer, hand_path, hand, answers.q, X_WB)
            writer.label(f"{hand_path}/name", name, color, (0.0, 0.0, _LABEL_HEIGHT))
            _write_marks(writer, hand_path, hand, answers, marks[name], pinches)
            curves = {
                "error": 1e3 * answers.error.mean(axis=1),
                "motion": answers.cosine,
                "gap": 1e3 * marks[name].gap,
            }
            for key, values in curves.items():
                writer.series(entity_path(key, name), [name], values[:, None], [color])
        _write_lanes(writer, hand, marks, pinches)


def _marks(hand: HandModel, answers: Answers, pinches: Pinches) -> _Marks:
    tips = answers.p_BF[np.arange(len(answers.q))[:, None], pinches.pair]
    gap = np.linalg.norm(tips[:, 1] - tips[:, 0], axis=-1)
    return _Marks(gap, gap <= 2 * hand.tip_radius, _collisions(hand, answers.q))


def _collisions(hand: HandModel, q: np.ndarray) -> list[np.ndarray]:
    """Where parts of the hand penetrate each other by over 2 mm: for each of q (T, n), (k, 3) in B, m.

    Two fingertips may touch, as in `metrics.self_collision`.
    """
    context = hand.contact_context()
    found = []
    for row in q:
        pairs = hand.query(row, context).ComputePointPairPenetration()
        deep = [(pair.p_WCa + pair.p_WCb) / 2 for pair in pairs if pair.depth > PENETRATION]
        found.append(np.array(deep).reshape(-1, 3))
    return found


def _write_human(writer: Writer, hand: HandModel, p_HK: np.ndarray, pinches: Pinches) -> None:
    path = entity_path(WORLD, "human")
    writer.human_hand(path, p_HK, SKIN)
    tips = tips_of(p_HK, hand)
    writer.points(f"{path}/tips", list(tips), _HUMAN_TIP, finger_colors(hand.finger_names), SOLID)
    _write_pinches(writer, path, tips, pinches, np.full((len(tips), 3), 255), 1.8 * _HUMAN_TIP)
    writer.label(f"{path}/name", "recorded hand", SKIN, (0.0, 0.0, _LABEL_HEIGHT))
    writer.series("/gap/human", ["human"], 1e3 * pinches.distance[:, None], [SKIN], 2.5)


def _write_marks(
    writer: Writer, path: str, hand: HandModel, answers: Answers, marks: _Marks, pinches: Pinches
) -> None:
    radius = 1.1 * hand.tip_radius  # covers the model's own tip
    writer.points(f"{path}/tips", list(answers.p_BF), radius, finger_colors(hand.finger_names), SOLID)
    writer.points(f"{path}/copy", list(answers.copy), 1.1 * radius, _COPY_COLOR, CAGE)
    colors = np.where(marks.closed[:, None], _RIGHT, _WRONG)
    _write_pinches(writer, path, answers.p_BF, pinches, colors, 2.2 * radius)
    writer.points(f"{path}/collisions", marks.collisions, 0.014, _WRONG, SOLID)


def _write_pinches(
    writer: Writer, path: str, tips: np.ndarray, pinches: Pinches, colors: np.ndarray, radius: float
) -> None:
    """Sends a cage between the tips that should meet, in colours (T, 3)."""
    middle = tips[np.arange(len(tips))[:, None], pinches.pair].mean(axis=1)
    pinched = pinches.closed.astype(int)
    rows = [point[None][:count] for point, count in zip(middle, pinched, strict=True)]
    shades = [color[None][:count] for color, count in zip(colors, pinched, strict=True)]
    writer.points(f"{path}/pinch", rows, radius, shades, CAGE)


def _write_lanes(writer: Writer, hand: HandModel, marks: Mapping[str, _Marks], pinches: Pinches) -> None:
    codes = np.where(pinches.closed, 1.0 + pinches.pair[:, 1], 0.0)
    labels = dict(enumerate(("–", *hand.finger_names)))
    writer.states(entity_path(_PINCH_LANE), codes, labels, [_IDLE, *finger_colors(hand.finger_names)])
    for name, of_method in marks.items():
        collides = np.array([len(points) > 0 for points in of_method.collisions])
        pinch = np.where(of_method.closed, 1.0, 2.0)
        codes = np.where(collides, 3.0, np.where(pinches.closed, pinch, 0.0))
        writer.states(entity_path(name), codes, _STATES, _STATE_COLORS)


def _layout(methods: Sequence[str]) -> views.View:
    middle = np.array([0.0, _SPACING * len(methods) / 2, 0.115])
    distance = max(0.42, 0.08 + 0.62 * _SPACING * (len(methods) + 1))
    eye = middle + np.array([distance, 0.0, 0.2 * distance])
    lanes = [entity_path(name) for name in (_PINCH_LANE, *methods)]
    left = views.column(
        views.scene_view(eye, middle, "recorded hand and robot hands"),
        views.lanes_view(lanes, "pinches and collisions"),
        shares=[1.0, views.lanes_share(len(lanes), 1.0)],
    )
    right = views.column(
        views.text_view("/about", "what you see"),
        views.time_series("fingertips against a proportional copy [mm]", ["/error/**"]),
        views.time_series("direction of motion kept (cosine)", ["/motion/**"]),
        views.time_series("nearest thumb and finger [mm]", ["/gap/**"]),
        shares=[2.3, 1.2, 1.0, 1.0],
    )
    return views.row(left, right, shares=[5, 3])


def _text(
    hands: Excerpt, methods: Mapping[str, Answers], marks: Mapping[str, _Marks], pinches: Pinches
) -> str:
    pinched = pinches.closed
    table = {
        "fingertips against a copy": [f"{1e3 * a.error.mean():.0f} mm" for a in methods.values()],
        "direction of motion kept": [f"{np.nanmean(a.cosine):.2f}" for a in methods.values()],
        "pinches closed": [
            f"{m.closed[pinched].mean():.0%}" if pinched.any() else "–" for m in marks.values()
        ],
        "self-collision": [f"{np.mean([len(p) > 0 for p in m.collisions]):.1%}" for m in marks.values()],
    }
    return _TEXT.format(
        seconds=hands.t[-1],
        headings=" | ".join(methods),
        rule="---:|" * len(methods),
        rows="\n".join(f"| {title} | {' | '.join(values)} |" for title, values in table.items()),
    )

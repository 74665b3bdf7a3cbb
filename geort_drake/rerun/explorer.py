"""The retargeting explorer: a recorded hand, and what methods make of it, side by side."""

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from pydrake.math import RigidTransform

from geort_drake.colours import SKIN, Color
from geort_drake.comparison.exploration import Answers, Excerpt, Pinches, find_pinches, tips_of
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import mirrored
from geort_drake.rerun.blueprint import blueprint, lanes_share, scene_view, time_series
from geort_drake.rerun.hand import HandTrack
from geort_drake.rerun.posed_hand import (
    RIGHT,
    WRONG,
    PosedHand,
    finger_colors,
    write_balls,
    write_label,
    write_lines,
)
from geort_drake.rerun.scene import WORLD, entity_path
from geort_drake.rerun.tracks import StateTrack, scalars
from geort_drake.rerun.writer import Property, Writer, file_writer

APPLICATION = "geort_drake_explorer"
_APART = 0.26  # m, from hand to hand
_HUMAN_TIP = 0.0085  # m, radius
_ASKED = "asked_pinch"
# Of the methods in the plots: apart from those of fingers and marks.
_COLORS: tuple[Color, ...] = ((240, 228, 66), (178, 132, 255), (213, 94, 0), (0, 220, 200), (190, 190, 190))

_NOTHING: Color = (58, 62, 71)
_STATES: dict[int, tuple[str, Color]] = {
    0: ("–", _NOTHING),
    1: ("closed", (44, 160, 44)),
    2: ("open", (230, 120, 20)),
    3: ("collides", (214, 39, 40)),
}

_TEXT = """\
Left: the **recorded hand**. Beside it: what each method makes of its fingertips, and of nothing else.

| in these {seconds:.0f} s | {headings} |
|---|{rule}
{rows}

- **Fingertips** have the colour of their finger.
- **White cages**: where a proportional copy of the human fingertip would be.
- **A cage around two fingertips**: the person pinches. On the robot it is green where its fingertips meet,
  and red where they do not.
- **Red balls**: parts of the hand are over 2 mm inside each other.
- **Lines** in the plots have the colour of the name above the hand.
"""


@dataclass(frozen=True)
class _Marks:
    """What is wrong or right about one method's answers."""

    gap: np.ndarray  # (T,) between the robot's tips of the pair that is nearest in the person's hand, m
    closed: np.ndarray  # (T,)
    collisions: list[np.ndarray]  # T times (k, 3) in B, m


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
        hands: what the person does.
        methods: name of a method → what it makes of that.
        properties: what the recording is about.
    """
    p_HK = mirrored(hands.p_HK) if hand.description.side == "left" else hands.p_HK
    pinches = find_pinches(tips_of(p_HK, hand), hand.finger_names)
    # Wrists stand side by side.
    wrists = {"human": np.zeros(3)} | dict.fromkeys(methods, hand.p_BW)
    places = {
        name: RigidTransform([0.0, _APART * number, -wrist[2]])
        for number, (name, wrist) in enumerate(wrists.items())
    }
    posed = {name: PosedHand(hand, name, places[name]) for name in methods}
    marks = {name: _marks(posed[name], hand, answers, pinches) for name, answers in methods.items()}
    with file_writer(
        Path(path),
        application_id=APPLICATION,
        recording_id=f"explorer-{properties['recording_sha256']}-{hands.start:g}-{'-'.join(methods)}",
        blueprint=_layout(methods, len(places)),
        properties=properties,
    ) as writer:
        if writer is None:
            return
        writer.static(f"/{WORLD}", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.static(
            "/about", rr.TextDocument(_text(hands, methods, marks, pinches), media_type="text/markdown")
        )
        writer.at(hands.t)
        _write_human(writer, hand, p_HK, pinches, places["human"])
        for color, (name, answers) in zip(itertools.cycle(_COLORS), methods.items(), strict=False):
            posed[name].describe(writer)
            posed[name].write(writer, answers.q)
            _write_marks(writer, posed[name].path, hand, answers, marks[name], pinches)
            write_label(writer, posed[name].path, name, color)
            _write_series(writer, name, color, answers, marks[name])
        _write_lanes(writer, hand, marks, pinches)


def _marks(posed: PosedHand, hand: HandModel, answers: Answers, pinches: Pinches) -> _Marks:
    rows = np.arange(len(answers.q))
    tips = answers.p_BF[rows[:, None], pinches.pair]
    gap = np.linalg.norm(tips[:, 1] - tips[:, 0], axis=-1)
    return _Marks(gap, gap <= 2 * hand.tip_radius, posed.collisions(answers.q))


def _write_human(
    writer: Writer, hand: HandModel, p_HK: np.ndarray, pinches: Pinches, X_WH: RigidTransform
) -> None:
    track = HandTrack("human", SKIN, X_WH)
    track.describe(writer)
    track.write(writer, [track.read(points, RigidTransform()) for points in p_HK])
    tips = tips_of(p_HK, hand) + X_WH.translation()
    path = entity_path(WORLD, "human")
    write_balls(writer, f"{path}/tips", list(tips), _HUMAN_TIP, finger_colors(hand))
    colors = [np.full((int(pinch), 3), 255) for pinch in pinches.asked]
    _write_pinches(writer, path, tips, pinches, colors, 1.8 * _HUMAN_TIP)
    write_label(writer, path, "recorded hand", SKIN, X_WH)
    gap = 1e3 * pinches.distance
    writer.static("/gap/human", rr.SeriesLines(names=["human"], colors=[SKIN], widths=[2.5]))
    writer.columns("/gap/human", scalars(gap[:, None]))


def _write_marks(
    writer: Writer, path: str, hand: HandModel, answers: Answers, marks: _Marks, pinches: Pinches
) -> None:
    tip = 1.1 * hand.tip_radius  # over the model's own
    write_balls(writer, f"{path}/tips", list(answers.p_BF), tip, finger_colors(hand))
    write_balls(writer, f"{path}/copy", list(answers.asked), 1.1 * tip, (235, 235, 235), cage=True)
    colors = [
        np.tile(RIGHT if closed else WRONG, (int(pinch), 1))
        for pinch, closed in zip(pinches.asked, marks.closed, strict=True)
    ]
    _write_pinches(writer, path, answers.p_BF, pinches, colors, 2.2 * tip)
    write_balls(writer, f"{path}/collisions", marks.collisions, 0.014, WRONG)


def _write_pinches(
    writer: Writer, path: str, tips: np.ndarray, pinches: Pinches, colors: Sequence[np.ndarray], radius: float
) -> None:
    """Sends a line between the tips that are asked to meet, and a cage around its middle."""
    each = np.arange(len(tips))[:, None]
    pairs = [
        pair[None] if pinch else pair[:0, None].repeat(2, axis=1)
        for pair, pinch in zip(tips[each, pinches.pair], pinches.asked, strict=True)
    ]
    write_lines(writer, f"{path}/pinch/line", pairs, colors, 0.003)
    write_balls(
        writer, f"{path}/pinch/cage", [pair.mean(axis=1) for pair in pairs], radius, colors, cage=True
    )


def _write_series(writer: Writer, name: str, color: Color, answers: Answers, marks: _Marks) -> None:
    series = {
        "error": 1e3 * answers.error.mean(axis=1),
        "motion": answers.cosine,
        "gap": 1e3 * marks.gap,
    }
    for key, values in series.items():
        path = entity_path(key, name)
        writer.static(path, rr.SeriesLines(names=[name], colors=[color], widths=[1.75]))
        finite = np.isfinite(values)
        writer.columns(path, scalars(values[finite, None]), finite)


def _write_lanes(writer: Writer, hand: HandModel, marks: Mapping[str, _Marks], pinches: Pinches) -> None:
    colors = [_NOTHING, *finger_colors(hand)]
    lane = StateTrack(_ASKED, dict(enumerate(("–", *hand.finger_names))), colors)
    lane.describe(writer)
    lane.write(writer, list(np.where(pinches.asked, 1.0 + pinches.pair[:, 1], 0.0)))
    for name, of_method in marks.items():
        collides = np.array([len(points) > 0 for points in of_method.collisions])
        pinch = np.where(of_method.closed, 1.0, 2.0)
        labels = {code: label for code, (label, _) in _STATES.items()}
        lane = StateTrack(name, labels, [color for _, color in _STATES.values()])
        lane.describe(writer)
        lane.write(writer, list(np.where(collides, 3.0, np.where(pinches.asked, pinch, 0.0))))


def _layout(methods: Mapping[str, Answers], places: int) -> rrb.Blueprint:
    middle = np.array([0.0, _APART * (places - 1) / 2, 0.115])
    distance = max(0.42, 0.08 + 0.62 * _APART * places)
    eye = middle + np.array([distance, 0.0, 0.2 * distance])
    lanes = [entity_path(name) for name in (_ASKED, *methods)]
    left = rrb.Vertical(
        scene_view(eye, middle, "recorded hand and robot hands"),
        rrb.StateTimelineView(origin="/", contents=lanes, name="pinches and collisions"),
        row_shares=[1.0, lanes_share(len(lanes), 1.0)],
    )
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/about", name="what you see"),
        time_series("fingertips against a proportional copy [mm]", ["/error/**"]),
        time_series("direction of motion kept (cosine)", ["/motion/**"]),
        time_series("nearest thumb and finger [mm]", ["/gap/**"]),
        row_shares=[2.3, 1.2, 1.0, 1.0],
    )
    return blueprint(rrb.Horizontal(left, right, column_shares=[5, 3]))


def _text(
    hands: Excerpt,
    methods: Mapping[str, Answers],
    marks: Mapping[str, _Marks],
    pinches: Pinches,
) -> str:
    def row(title: str, values: Sequence[str]) -> str:
        return f"| {title} | {' | '.join(values)} |"

    asked = pinches.asked
    closed = [f"{m.closed[asked].mean():.0%}" if asked.any() else "–" for m in marks.values()]
    colliding = [np.mean([len(points) > 0 for points in m.collisions]) for m in marks.values()]
    rows = [
        row("fingertips against a copy", [f"{1e3 * a.error.mean():.0f} mm" for a in methods.values()]),
        row("direction of motion kept", [f"{np.nanmean(a.cosine):.2f}" for a in methods.values()]),
        row("pinches closed", closed),
        row("self-collision", [f"{share:.1%}" for share in colliding]),
    ]
    return _TEXT.format(
        seconds=hands.t[-1],
        headings=" | ".join(methods),
        rule="---:|" * len(methods),
        rows="\n".join(rows),
    )

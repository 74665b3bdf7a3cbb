"""The retargeting explorer: outputs of methods for an excerpt, written to Rerun next to the recorded hand."""

import dataclasses
import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.colours import SKIN, Color, finger_colors
from geort_drake.errors import RecordingError
from geort_drake.hands.hand import Hand
from geort_drake.metrics.evaluation import complete_hands, distal_links, distal_phalanges
from geort_drake.metrics.metrics import PENETRATION, angles_between, nearest_pairs, of_pairs, pair_distances
from geort_drake.people.keypoints import FINGER_NAMES, mirrored
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.rerun import layout as views
from geort_drake.rerun.scene import write_robot_hand
from geort_drake.rerun.writer import CAGE, SOLID, WORLD, Property, Writer, entity_path, file_writer

WINDOW = 0.1  # s; motions are measured from this long before a frame to this long after it
MIN_MOTION = 0.003  # m; directions of shorter motions of a human fingertip are ignored


@dataclass(frozen=True)
class Response:
    """Outputs of a method for an excerpt of T hands with F fingers.

    Attributes:
        q: (T, n) joint positions, rad.
        p_BF: (T, F, 3) robot fingertips in B, m.
        copy: (T, F, 3) human fingertips, scaled and shifted per finger to fit `p_BF` in least squares, m.
            Such a copy preserves every direction; the difference shows what the method gives up for reach,
            pinches and collision avoidance.
        error: (T, F) distances between `copy` and `p_BF`, m.
        cosine: (T,) cosine of the angle between human and robot fingertip motions, averaged over the moving
            fingers; NaN if none moves.
        gap: (T,) distance between the robot's fingertips that correspond to the person's nearest pair, m.
        closed: (T,) whether these fingertips touch.
        angle: (T, F) angles between the last links of person and robot, from the last joint to the tip, rad.
        collisions: T arrays (k, 3) of points in B where parts of the hand overlap by over 2 mm, m.
    """

    q: np.ndarray
    p_BF: np.ndarray
    copy: np.ndarray
    error: np.ndarray
    cosine: np.ndarray
    gap: np.ndarray
    closed: np.ndarray
    angle: np.ndarray
    collisions: list[np.ndarray]


def excerpt(
    recording: Recording, rate_hz: float = 30.0, duration_s: float = 20.0, start_s: float | None = None
) -> Recording:
    """Resamples a part of a recording to a constant rate; lost hands repeat the last tracked one.

    Times begin at 0; `start_s` in the metadata is the excerpt's start in the recording, s.

    Args:
        start_s: start of the excerpt, s; by default the one that includes most pinches.

    Raises:
        RecordingError: the excerpt begins outside the recording, or contains fewer than two hands.
    """
    tracked = recording.tracked()
    t = tracked.t - recording.t[0]
    if len(t) == 0 or (start_s is not None and not 0 <= start_s < t[-1]):
        raise RecordingError(f"an excerpt must begin within the recording's {recording.duration_s:.1f} s")
    if start_s is None:
        tips = tracked.fingertips()
        pinching = pair_distances(tips, nearest_pairs(tips, FINGER_NAMES)) < PINCH_M
        pinch_counts = np.concatenate([[0], np.cumsum(pinching)])
        ends = np.searchsorted(t, t + duration_s)
        fits = t + duration_s <= max(t[-1], duration_s)
        start_s = float(t[np.argmax(np.where(fits, pinch_counts[ends] - pinch_counts[:-1], -1))])
    times = np.arange(start_s, min(start_s + duration_s, t[-1]) + 1e-9, 1 / rate_hz)
    if len(times) < 2:
        raise RecordingError(
            f"an excerpt from {start_s:g} s on contains {len(times)} hands; at least 2 are needed"
        )
    samples = tracked.at(times + recording.t[0])
    metadata = {**recording.metadata, "start_s": start_s}
    return dataclasses.replace(samples, t=times - start_s, metadata=metadata)


def response(retarget: Callable, hand: Hand, hands: Recording) -> Response:
    """Computes the outputs of a method for an excerpt.

    Args:
        retarget: maps human fingertips (T, F, 3) of a canonical right hand, m, to joint angles (T, n), rad.
    """
    keypoints = hand.description.human_keypoints
    human = hands.fingertips(keypoints)
    q = np.asarray(complete_hands(retarget, hand, hands)(human))
    # Both are those of right hands.
    angle = angles_between(distal_phalanges(hands, keypoints), distal_links(hand)(q))
    # Recordings are stored as right hands, so they are mirrored for a left robot hand.
    if hand.description.side == "left":
        human = mirrored(human)
    p_BF = hand.fingertips(q)
    copy = proportional_copy(human, p_BF)
    gap = pair_distances(p_BF, nearest_pairs(human, hand.finger_names))
    return Response(
        q,
        p_BF,
        copy,
        np.linalg.norm(copy - p_BF, axis=-1),
        windowed_cosines(human, p_BF, round(WINDOW * hands.rate_hz)),
        gap,
        gap <= 2 * hand.tip_radius,
        angle,
        _collisions(hand, q),
    )


def proportional_copy(human: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """Scales and shifts human fingertips (T, F, 3) per finger to fit the robot's in least squares."""
    centred, target = human - human.mean(axis=0), robot - robot.mean(axis=0)
    spread = np.einsum("tfx,tfx->f", centred, centred)
    scale = np.einsum("tfx,tfx->f", centred, target) / np.maximum(spread, 1e-12)
    return robot.mean(axis=0) + scale[:, None] * centred


def windowed_cosines(human: np.ndarray, robot: np.ndarray, window: int) -> np.ndarray:
    """Computes mean cosines (T,) between motions of fingertips (T, F, 3) over ± `window` frames."""
    rows, window = np.arange(len(human)), max(window, 1)
    start, end = np.maximum(rows - window, 0), np.minimum(rows + window, len(human) - 1)
    d, robot_step = human[end] - human[start], robot[end] - robot[start]
    length, robot_length = np.linalg.norm(d, axis=-1), np.linalg.norm(robot_step, axis=-1)
    moves = length > MIN_MOTION
    cosine = np.einsum("tfx,tfx->tf", d, robot_step) / np.maximum(length * robot_length, 1e-12)
    count = moves.sum(axis=1)
    return np.where(count > 0, (cosine * moves).sum(axis=1) / np.maximum(count, 1), np.nan)


def _collisions(hand: Hand, q: np.ndarray) -> list[np.ndarray]:
    """Computes `Response.collisions`; as in `metrics.self_collision`, two fingertips may touch."""
    context = hand.contact_context()
    points = []
    for row in q:
        pairs = hand.query(row, context).ComputePointPairPenetration()
        deep = [(pair.p_WCa + pair.p_WCb) / 2 for pair in pairs if pair.depth > PENETRATION]
        points.append(np.array(deep).reshape(-1, 3))
    return points


_CLOSED_COLOR, _FAULT_COLOR = (90, 255, 120), (255, 50, 50)  # no finger has these colours
APPLICATION = "geort_drake_explorer"
_SPACING = 0.26  # m, between neighbouring hands
_LABEL_HEIGHT = 0.235  # m
_HUMAN_TIP_RADIUS = 0.0085  # m
_TIP_GROWTH = 1.1  # of drawn tips, which cover the model's
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
    pairs = nearest_pairs(tips, hand.finger_names)
    gap = pair_distances(tips, pairs)
    is_pinch = gap < PINCH_M
    with file_writer(
        path,
        application_id=APPLICATION,
        recording_id=f"explorer-{properties['recording_sha256']}-{hands.metadata['start_s']:g}-{'-'.join(methods)}",
        blueprint=views.blueprint(_layout(list(methods))),
        properties=properties,
    ) as writer:
        writer.text("/about", _text(hands, methods, is_pinch))
        writer.at(hands.t)
        _write_human(writer, hand, p_HK, tips)
        white, radius = np.full((len(tips), 3), 255), 1.8 * _HUMAN_TIP_RADIUS
        _write_pinches(writer, f"/{WORLD}/human", of_pairs(tips, pairs), is_pinch, white, radius)
        writer.series("/gap/human", ["human"], 1e3 * gap[:, None], [SKIN], 2.5)
        for number, (color, (name, response)) in enumerate(
            zip(itertools.cycle(_COLORS), methods.items(), strict=False), start=1
        ):
            hand_path = entity_path(WORLD, name)
            # All wrists are at the same height.
            X_WB = RigidTransform([0.0, _SPACING * number, -hand.p_BW[2]])
            write_robot_hand(writer, hand_path, hand, response.q, X_WB)
            writer.label(f"{hand_path}/name", name, color, (0.0, 0.0, _LABEL_HEIGHT))
            _write_marks(writer, hand_path, hand, response)
            colors = np.where(response.closed[:, None], _CLOSED_COLOR, _FAULT_COLOR)
            radius = 2.2 * _TIP_GROWTH * hand.tip_radius
            _write_pinches(writer, hand_path, of_pairs(response.p_BF, pairs), is_pinch, colors, radius)
            curves = {
                "error": 1e3 * response.error.mean(axis=1),
                "motion": response.cosine,
                "gap": 1e3 * response.gap,
                "posture": np.degrees(response.angle.mean(axis=1)),
            }
            for key, values in curves.items():
                writer.series(entity_path(key, name), [name], values[:, None], [color])
        _write_lanes(writer, hand, methods, np.where(is_pinch, 1.0 + pairs[:, 1], 0.0))


def _write_human(writer: Writer, hand: Hand, p_HK: np.ndarray, tips: np.ndarray) -> None:
    path = entity_path(WORLD, "human")
    writer.human_hand(path, p_HK)
    colors = [np.array(finger_colors(hand.finger_names))] * len(tips)
    writer.points(f"{path}/tips", list(tips), _HUMAN_TIP_RADIUS, colors, SOLID)
    writer.label(f"{path}/name", "recorded hand", SKIN, (0.0, 0.0, _LABEL_HEIGHT))


def _write_marks(writer: Writer, path: str, hand: Hand, response: Response) -> None:
    radius = _TIP_GROWTH * hand.tip_radius
    tip_colors = [np.array(finger_colors(hand.finger_names))] * len(response.q)
    writer.points(f"{path}/tips", list(response.p_BF), radius, tip_colors, SOLID)
    writer.points(f"{path}/copy", list(response.copy), 1.1 * radius, _COPY_COLOR, CAGE)
    writer.points(f"{path}/collisions", response.collisions, 0.014, _FAULT_COLOR, SOLID)


def _write_pinches(
    writer: Writer, path: str, tips: np.ndarray, is_pinch: np.ndarray, colors: np.ndarray, radius: float
) -> None:
    """Draws a cage of colours (T, 3) around pairs of tips (T, 2, 3) that should meet, where `is_pinch`."""
    middle, counts = tips.mean(axis=1), is_pinch.astype(int)
    rows = [point[None][:count] for point, count in zip(middle, counts, strict=True)]
    shades = [color[None][:count] for color, count in zip(colors, counts, strict=True)]
    writer.points(f"{path}/pinch", rows, radius, shades, CAGE)


def _write_lanes(
    writer: Writer, hand: Hand, methods: Mapping[str, Response], pinch_codes: np.ndarray
) -> None:
    """Writes a lane of the person's `pinch_codes` (T,), 1 + the finger or 0, and one of each method."""
    labels = ("–", *hand.finger_names)
    writer.states(entity_path(_PINCH_LANE), pinch_codes, labels, [_IDLE, *finger_colors(hand.finger_names)])
    for name, response in methods.items():
        collides = np.array([len(points) > 0 for points in response.collisions])
        pinch = np.where(response.closed, 1.0, 2.0)
        codes = np.where(collides, 3.0, np.where(pinch_codes > 0, pinch, 0.0))
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


def _text(hands: Recording, methods: Mapping[str, Response], is_pinch: np.ndarray) -> str:
    responses = methods.values()
    table = {
        "fingertips against a copy": [f"{1e3 * a.error.mean():.0f} mm" for a in responses],
        "direction of motion kept": [f"{np.nanmean(a.cosine):.2f}" for a in responses],
        "posture: angle of the last links": [f"{np.degrees(np.median(a.angle)):.0f}°" for a in responses],
        "pinches closed": [f"{a.closed[is_pinch].mean():.0%}" if is_pinch.any() else "–" for a in responses],
        "self-collision": [f"{np.mean([len(points) > 0 for points in a.collisions]):.1%}" for a in responses],
    }
    return _TEXT.format(
        seconds=hands.t[-1],
        headings=" | ".join(methods),
        rule="---:|" * len(methods),
        rows="\n".join(f"| {title} | {' | '.join(values)} |" for title, values in table.items()),
    )

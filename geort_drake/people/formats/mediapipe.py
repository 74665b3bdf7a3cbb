"""MediaPipe's 21 world landmarks: JSON of its results, or (T, 21, 3) in .npy or .npz.

Order: wrist 0, thumb 1-4, index 5-8, middle 9-12, ring 13-16, little finger 17-20, base to tip. World
landmarks are metres from the middle of the hand, x to the right of the picture, y down, z away from the
camera; they do not say where the wrist is. Landmarks of the picture ("normalized") are no metric hand.

JSON: a list of results, or `{"frames": [...]}`, each with the fields of `HandLandmarkerResult`:
`worldLandmarks` (Python: `hand_world_landmarks`) with one list of 21 points per hand seen, `handedness`
with one category each, and `timestampMs` (or `timestamp_ms`). The hand of the side asked for is taken;
frames without one are lost. An .npz holds `world_landmarks` and optionally `t`, s, and `handedness`.

Many versions label hands as if the image were mirrored, so a right hand is called left, while the landmarks
are those of what the image shows. So the bending of the fingers decides the side, and the label only where
they hardly bend.

Source: https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker,
https://ai.google.dev/edge/api/mediapipe/js/tasks-vision.handlandmarkerresult, and of the labels
https://github.com/google-ai-edge/mediapipe/issues/1374
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from geort_drake.people.checks.anatomy import bent_side
from geort_drake.people.checks.findings import Finding, warning
from geort_drake.people.formats.source import (
    NO_HAND,
    BadFrame,
    Format,
    Source,
    Tracks,
    any_frame,
    frames_of,
    point,
)
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.people.recording import SIDES

_SHAPE = (KEYPOINT_COUNT, 3)
_WORLD = ("worldLandmarks", "hand_world_landmarks", "multi_hand_world_landmarks", "multiHandWorldLandmarks")
_PICTURE = ("landmarks", "hand_landmarks", "multi_hand_landmarks", "multiHandLandmarks")
_HANDEDNESS = ("handedness", "handednesses", "multi_handedness", "multiHandedness")
_LABEL = ("categoryName", "category_name", "label", "displayName", "display_name")
_TIME = ("timestampMs", "timestamp_ms")


def _is_mediapipe(contents: Any) -> bool:
    if any_frame(contents, lambda frame: any(field in frame for field in (*_WORLD, *_PICTURE))):
        return True
    # Any .npy, whose shape reading judges.
    return isinstance(contents, Mapping) and ("world_landmarks" in contents or contents.keys() == {"data"})


def _read_mediapipe(file: Source, side: str) -> Tracks:
    if frames_of(file.contents):
        hands = file.collect(file.frames(), lambda frame: _hands(frame, side))
        labels = [label for label in SIDES if any(label in seen for seen in hands if seen)]
        if not labels:
            raise file.error("no frame shows a hand")
        labelled = {label: _stacked(hands, label) for label in labels}
        clock = next((c for field in _TIME if (c := file.times(len(hands), field, "ms"))), None)
    else:
        p_WK = file.array("data" if "data" in file.header else "world_landmarks", _SHAPE)
        labelled, clock = {file.side() or side: p_WK}, file.times(len(p_WK))
    label, findings = _label_of_side(file, labelled, side)
    file.faults.add(NO_HAND, np.flatnonzero(np.isnan(labelled[label]).all(axis=(1, 2))))
    return Tracks(labelled[label], clock, side=side, findings=findings)


def _label_of_side(file: Source, labelled: Mapping[str, np.ndarray], side: str) -> tuple[str, list[Finding]]:
    """Which of the labelled hands (T, 21, 3) is of that side, by the bending of its fingers."""
    fitting = [label for label, p_WK in labelled.items() if bent_side(p_WK, label) == side]
    if not fitting and side not in labelled:
        raise file.error(
            f"the file's hand is labelled {next(iter(labelled))}, and its fingers do not bend as a "
            f"{side} one's; a {side} one was requested"
        )
    # Of a hand whose label changes, the longer part. The checks name what does not fit.
    label = max(fitting, key=lambda label: np.isfinite(labelled[label]).sum()) if fitting else side
    if label == side:
        return label, []
    finding = warning(
        "handedness",
        f"labelled {label}, but the fingers bend as a {side} hand's: read as {side}, because MediaPipe's "
        "labels often assume mirrored images",
        "handedness",
        f"if the image itself was mirrored, this was a {label} hand: import it with --mirror",
    )
    return label, [finding]


def _stacked(hands: Sequence[Mapping[str, np.ndarray] | None], label: str) -> np.ndarray:
    lost = np.full(_SHAPE, np.nan)
    return np.array([(seen or {}).get(label, lost) for seen in hands])


def _hands(frame: Any, side: str) -> dict[str, np.ndarray]:
    """Landmarks (21, 3) of each hand in a frame by its label; without a label, of the side asked for."""
    if not isinstance(frame, Mapping):
        raise BadFrame(f"expected an object, not {frame!r:.40}")
    hands = _list(frame, _WORLD)
    labels = [_label(label) for label in _list(frame, _HANDEDNESS)]
    if not hands and _list(frame, _PICTURE):
        raise BadFrame(
            "holds image landmarks (normalized), which are not metric; save the world landmarks "
            f"({_WORLD[0]})"
        )
    if labels and len(labels) != len(hands):
        raise BadFrame(f"{len(labels)} handedness for {len(hands)} hands")
    if len(hands) > 1 and not labels:
        raise BadFrame(f"shows {len(hands)} hands and does not say which is which")
    if unknown := next((label for label in labels if label not in SIDES), None):
        raise BadFrame(f"handedness '{unknown:.40}' is none of: {', '.join(SIDES)}")
    seen: dict[str, np.ndarray] = {}
    for label, hand in zip(labels or [side], hands, strict=False):
        seen.setdefault(label, _landmarks(hand))
    return seen


def _landmarks(hand: Any) -> np.ndarray:
    points = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, Mapping) else hand
    try:
        p = np.asarray([point(value) for value in points])
    except (TypeError, ValueError):
        p = np.array(None)
    if p.shape != _SHAPE or p.dtype.kind not in "fiu":
        count = f", {len(points)} given" if isinstance(points, list) else ""
        raise BadFrame(f"expected {KEYPOINT_COUNT} landmarks of three numbers{count}")
    return p.astype(float)


def _list(frame: Mapping, fields: Sequence[str]) -> list:
    """The first of the fields that holds something."""
    field = next((field for field in fields if frame.get(field)), None)
    value = [] if field is None else frame[field]
    if not isinstance(value, list):
        raise BadFrame(f"{field} must be a list, not {value!r:.40}")
    return value


def _label(value: Any) -> str:
    """left or right from a category, a list of one, or its name alone."""
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, Mapping):
        value = next((value[field] for field in _LABEL if value.get(field)), value)
    return str(value).strip().lower()


MEDIAPIPE = Format(
    "MediaPipe, 21 world landmarks", (".json", ".jsonl", ".npy", ".npz"), _is_mediapipe, _read_mediapipe
)

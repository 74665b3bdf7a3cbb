"""MediaPipe's 21 world landmarks: JSON of its results, or (T, 21, 3) in .npy or .npz.

World landmarks are in m from the middle of the hand, x to the right of the image, y down, z away from the
camera; they do not give the wrist's position. Image landmarks ("normalized") are not metric.

JSON: a list of results, or `{"frames": [...]}`, each with the fields of `HandLandmarkerResult`:
`worldLandmarks` (Python: `hand_world_landmarks`) with 21 points per hand seen, `handedness` with one category
each, and `timestampMs` (or `timestamp_ms`). An .npz contains `world_landmarks` and optionally `t`, s, and
`handedness`.

Many versions label hands as if the image were mirrored. The side is therefore determined from how the fingers
bend; the label decides only if they hardly bend.

Source: https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker,
https://ai.google.dev/edge/api/mediapipe/js/tasks-vision.handlandmarkerresult, and for the labels
https://github.com/google-ai-edge/mediapipe/issues/1374
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from geort_drake.people.checks.anatomy import bent_side
from geort_drake.people.checks.findings import warning
from geort_drake.people.formats.contents import BadFrame, any_frame, frames_of, point
from geort_drake.people.formats.source import NO_HAND, Format, Source, Tracks
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.people.recording import SIDES

_SHAPE = (KEYPOINT_COUNT, 3)
_WORLD = ("worldLandmarks", "hand_world_landmarks", "multi_hand_world_landmarks", "multiHandWorldLandmarks")
_IMAGE = ("landmarks", "hand_landmarks", "multi_hand_landmarks", "multiHandLandmarks")
_HANDEDNESS = ("handedness", "handednesses", "multi_handedness", "multiHandedness")
_LABEL = ("categoryName", "category_name", "label", "displayName", "display_name")


def _is_mediapipe(contents: Any) -> bool:
    if any_frame(contents, lambda frame: any(field in frame for field in (*_WORLD, *_IMAGE))):
        return True
    # Any .npy fits; reading checks its shape.
    return isinstance(contents, Mapping) and ("world_landmarks" in contents or contents.keys() == {"data"})


def _read_mediapipe(file: Source, side: str) -> Tracks:
    if frames_of(file.contents):
        p = file.each(frames_of(file.contents), lambda frame: _hands(frame, side), (2, *_SHAPE), _WORLD[0])
        seen = {label: p[:, i] for i, label in enumerate(SIDES) if np.isfinite(p[:, i]).any()}
        if not seen:
            raise file.error("no frame shows a hand")
    else:
        p = file.array("data" if "data" in file.header else "world_landmarks", _SHAPE)
        seen = {file.side() or side: p}
    label = _label_of_side(file, seen, side)
    file.faults.add(NO_HAND, np.flatnonzero(np.isnan(seen[label]).all(axis=(1, 2))))
    return Tracks(seen[label], file.times(len(p), unit_s=1e-3), side=side)


def _label_of_side(file: Source, seen: Mapping[str, np.ndarray], side: str) -> str:
    """Returns the label of the hand (T, 21, 3) whose fingers bend as those of the requested side."""
    fitting = [label for label, p_WK in seen.items() if bent_side(p_WK, label) == side]
    if not fitting and side not in seen:
        what = f"the file's hand is labelled {next(iter(seen))}, and its fingers do not bend as a "
        raise file.error(what + f"{side} one's; a {side} one was requested")
    # If a hand's label changes, its longer part is read. The checks report what does not fit.
    label = max(fitting, key=lambda label: np.isfinite(seen[label]).sum()) if fitting else side
    if label != side:
        what = f"labelled {label}, but the fingers bend as a {side} hand's: read as {side}, because "
        what += "MediaPipe's labels often assume mirrored images"
        advice = f"if the image itself was mirrored, this was a {label} hand: convert it with --mirror"
        file.findings.append(warning("handedness", what, "handedness", advice))
    return label


def _hands(frame: Any, side: str) -> np.ndarray | None:
    """Returns landmarks (2, 21, 3) of the left and right hand; an unlabelled hand has the requested side."""
    if not isinstance(frame, Mapping):
        raise BadFrame(f"expected an object, not {frame!r:.40}")
    hands = _list(frame, _WORLD)
    if not hands and _list(frame, _IMAGE):
        raise BadFrame(
            "contains image landmarks (normalized), which are not metric; save the world landmarks "
            f"({_WORLD[0]})"
        )
    labels = [_label(label) for label in _list(frame, _HANDEDNESS)] or [side][: len(hands)]
    if len(labels) != len(hands) or not set(labels) <= set(SIDES):
        raise BadFrame(f"handedness must be left or right for each of {len(hands)} hands, not {labels!r:.60}")
    seen = np.full((2, *_SHAPE), np.nan)
    # If two hands have the same label, the first is kept.
    for label, hand in reversed(list(zip(labels, hands, strict=True))):
        seen[SIDES.index(label)] = _landmarks(hand)
    return seen if hands else None


def _landmarks(hand: Any) -> np.ndarray:
    points = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, Mapping) else hand
    try:
        p = np.asarray([point(value) for value in points])
    except (TypeError, ValueError):
        p = np.array(None)
    if p.shape != _SHAPE or p.dtype.kind not in "fiu":
        count = f", {len(points)} given" if isinstance(points, list) else ""
        raise BadFrame(f"expected {KEYPOINT_COUNT} landmarks of three numbers{count}")
    return p


def _list(frame: Mapping, fields: Sequence[str]) -> list:
    """Returns the first of the fields that is not empty, a list."""
    value: Any = next((frame[field] for field in fields if frame.get(field)), [])
    if not isinstance(value, list):
        raise BadFrame(f"{fields[0]} must be a list, not {value!r:.40}")
    return value


def _label(value: Any) -> str:
    """Returns "left" or "right" from a category, a list of categories or a name."""
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, Mapping):
        value = next((value[field] for field in _LABEL if value.get(field)), value)
    return str(value).strip().lower()


MEDIAPIPE = Format(
    "MediaPipe, 21 world landmarks", (".json", ".jsonl", ".npy", ".npz"), _is_mediapipe, _read_mediapipe
)

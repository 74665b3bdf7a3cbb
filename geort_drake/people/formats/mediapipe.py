"""MediaPipe's 21 world landmarks: JSON of its results, or (T, 21, 3) in .npy or .npz.

Order: wrist 0, thumb 1–4, index 5–8, middle 9–12, ring 13–16, little finger 17–20, base to tip. World
landmarks are metres about the middle of the hand, x to the right of the picture, y down, z away from the
camera; where the wrist is they do not say. Landmarks of the picture ("normalized") are no metric hand.

JSON: a list of results, or `{"frames": [...]}`, each as `HandLandmarkerResult` names its fields:
`worldLandmarks` (Python: `hand_world_landmarks`) with one list of 21 points per hand seen, `handedness` with
one category each, and `timestampMs` (or `timestamp_ms`) as passed to the detector. The hand of the side
asked for is taken; frames without one are lost. An .npz holds `world_landmarks` and optionally `t`, s, and
`handedness`.

Many versions label hands as if the image were mirrored, so that the right hand in an image that is not is
called left; landmarks are those of what the image shows. So a hand is of the side to which its fingers bend,
and its label counts only where they hardly bend.

Source: https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker,
https://ai.google.dev/edge/api/mediapipe/js/tasks-vision.handlandmarkerresult and, of the labels,
https://github.com/google-ai-edge/mediapipe/issues/1374
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks.anatomy import bent_side
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.formats.tracks import Tracks, frames_of, json_times, numbers, point, side_of, times
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.people.recording import SIDES

SUFFIXES = (".json", ".jsonl", ".npy", ".npz")

_WORLD = ("worldLandmarks", "hand_world_landmarks", "multi_hand_world_landmarks", "multiHandWorldLandmarks")
_PICTURE = ("landmarks", "hand_landmarks", "multi_hand_landmarks", "multiHandLandmarks")
_HANDEDNESS = ("handedness", "handednesses", "multi_handedness", "multiHandedness")
_LABEL = ("categoryName", "category_name", "label", "displayName", "display_name")
_TIME = ("timestampMs", "timestamp_ms")


def recognizes(contents: Any) -> bool:
    if isinstance(contents, dict) and "frames" not in contents:
        if "world_landmarks" in contents:
            return True
        return contents.keys() == {"data"}  # any .npy, whose shape reading judges
    frames = contents["frames"] if isinstance(contents, dict) else contents
    return isinstance(frames, list) and any(
        isinstance(frame, dict) and any(field in frame for field in (*_WORLD, *_PICTURE)) for frame in frames
    )


def read(name: str, contents: Any, side: str) -> Tracks:
    if isinstance(contents, dict) and "frames" not in contents:
        return _read_arrays(name, contents, side)
    frames = frames_of(name, contents)
    hands = [_hands(name, i, frame, side) for i, frame in enumerate(frames)]
    lost = [[np.nan] * 3] * KEYPOINT_COUNT
    labelled = {
        label: np.array([seen.get(label, lost) for seen in hands], dtype=float)
        for label in SIDES
        if any(label in seen for seen in hands)
    }
    if frames and not labelled:
        raise RecordingError(f"{name}: no frame shows a hand")
    p_WK, findings = _of_side(name, labelled or {side: np.empty((0, KEYPOINT_COUNT, 3))}, side)
    field = next((field for field in _TIME if any(field in frame for frame in frames)), _TIME[0])
    return Tracks(p_WK, json_times(name, frames, field, "ms"), side=side, findings=findings)


def _read_arrays(name: str, contents: Any, side: str) -> Tracks:
    field = "world_landmarks" if "world_landmarks" in contents else "data"
    if field not in contents:
        raise RecordingError(f"{name}: landmarks must be called world_landmarks, not {', '.join(contents)}")
    p_WK = numbers(name, "array" if field == "data" else field, contents[field], (KEYPOINT_COUNT, 3))
    p_WK, findings = _of_side(name, {side_of(name, contents) or side: p_WK}, side)
    return Tracks(p_WK, times(name, contents, len(p_WK)), side=side, findings=findings)


def _of_side(name: str, labelled: dict[str, np.ndarray], side: str) -> tuple[np.ndarray, list[Finding]]:
    """The hand (T, 21, 3) of that side by the way its fingers bend, out of those that labels tell apart."""
    bent = {label: bent_side(p_WK, label) for label, p_WK in labelled.items()}
    fitting = [label for label in labelled if bent[label] == side]
    if not fitting and side not in labelled:
        raise RecordingError(
            f"{name}: the file holds a {next(iter(labelled))} hand by its label, and its fingers do not bend "
            f"as a {side} one's; a {side} one was asked for"
        )
    # Of a hand whose label changes, the longer part. What does not fit is named by the checks.
    label = max(fitting, key=lambda label: np.isfinite(labelled[label]).sum()) if fitting else side
    if label == side:
        return labelled[label], []
    finding = Finding(
        "handedness",
        Severity.WARNING,
        f"labelled {label}, but the fingers bend as a {side} hand's: taken for a {side} one, as MediaPipe's "
        "labels are often those of mirrored images",
        "handedness",
        f"if the image itself was mirrored, this was a {label} hand: import it with --mirror",
    )
    return labelled[label], [finding]


def _hands(name: str, i: int, frame: dict, side: str) -> dict[str, list]:
    """21 points of each hand in a frame, by its label; of one without a label by the side asked for."""
    hands = _list(name, i, frame, _WORLD)
    labels = [_label(label) for label in _list(name, i, frame, _HANDEDNESS)]
    if not hands and _list(name, i, frame, _PICTURE):
        raise RecordingError(
            f"{name}: frame {i} holds landmarks of the picture (normalized), which are no metric hand; save "
            f"the world landmarks ({_WORLD[0]})"
        )
    if labels and len(labels) != len(hands):
        raise RecordingError(f"{name}: frame {i} has {len(labels)} handedness for {len(hands)} hands")
    if len(hands) > 1 and not labels:
        raise RecordingError(f"{name}: frame {i} shows {len(hands)} hands and does not say which is which")
    seen: dict[str, list] = {}
    for label, hand in zip(labels or [side], hands, strict=False):
        if label not in SIDES:
            raise RecordingError(
                f"{name}: frame {i}: handedness '{label:.40}' is none of: {', '.join(SIDES)}"
            )
        points = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, dict) else hand
        if not isinstance(points, list) or len(points) != KEYPOINT_COUNT:
            given = len(points) if isinstance(points, list) else type(points).__name__
            raise RecordingError(f"{name}: frame {i}: {KEYPOINT_COUNT} landmarks are wanted, {given} given")
        seen.setdefault(
            label, [point(name, f"frame {i}, landmark {k}", value) for k, value in enumerate(points)]
        )
    return seen


def _list(name: str, i: int, frame: dict, fields: Sequence[str]) -> list:
    """The first of the fields that holds something."""
    field = next((field for field in fields if frame.get(field)), None)
    value = [] if field is None else frame[field]
    if not isinstance(value, list):
        raise RecordingError(f"{name}: frame {i}: {field} must be a list, not {value!r:.40}")
    return value


def _label(value: Any) -> str:
    """left or right from a category, a list of one, or its name alone."""
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, dict):
        value = next((value[field] for field in _LABEL if value.get(field)), value)
    return str(value).strip().lower()

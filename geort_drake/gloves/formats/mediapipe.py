"""MediaPipe's 21 world landmarks: JSON of its results, or (T, 21, 3) in .npy or .npz.

Order: wrist 0, thumb 1–4, index 5–8, middle 9–12, ring 13–16, little finger 17–20, base to tip. World
landmarks are metres about the middle of the hand, x to the right of the picture, y down, z away from the
camera; where the wrist is they do not say. Landmarks of the picture ("normalized") are no metric hand.

JSON: a list of results, or `{"frames": [...]}`, each as `HandLandmarkerResult` names its fields:
`worldLandmarks` (Python: `hand_world_landmarks`) with one list of 21 points per hand seen, `handedness` with
one category each, and `timestampMs` (or `timestamp_ms`) as passed to the detector. The hand of the side
asked for is taken; frames without one are lost. An .npz holds `world_landmarks` and optionally `t`, s.

Source: https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker and
https://ai.google.dev/edge/api/mediapipe/js/tasks-vision.handlandmarkerresult
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.gloves.formats.tracks import Tracks, frames_of, json_times, numbers, point, side_of, times
from geort_drake.gloves.keypoints import KEYPOINT_COUNT

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
        return _read_arrays(name, contents)
    frames = frames_of(name, contents)
    hands = [_hand(name, i, frame, side) for i, frame in enumerate(frames)]
    if hands and all(hand is None for hand in hands):
        other = {"left": "right", "right": "left"}[side]
        if any(_hand(name, i, frame, other) is not None for i, frame in enumerate(frames)):
            raise RecordingError(f"{name}: the file holds a {other} hand, a {side} one was asked for")
        if any(field in frame for frame in frames for field in _PICTURE):
            raise RecordingError(
                f"{name}: holds landmarks of the picture (normalized), which are no metric hand; save the "
                f"world landmarks ({_WORLD[0]})"
            )
        raise RecordingError(f"{name}: no frame shows a hand")
    lost = [[np.nan] * 3] * KEYPOINT_COUNT
    p_WK = np.array([lost if hand is None else hand for hand in hands], dtype=float).reshape(-1, 21, 3)
    field = next((field for field in _TIME if any(field in frame for frame in frames)), _TIME[0])
    return Tracks(p_WK, json_times(name, frames, field, 1e-3), side=side)


def _read_arrays(name: str, contents: Any) -> Tracks:
    field = "world_landmarks" if "world_landmarks" in contents else "data"
    if field not in contents:
        raise RecordingError(f"{name}: landmarks must be called world_landmarks, not {', '.join(contents)}")
    p_WK = numbers(name, "array" if field == "data" else field, contents[field], (KEYPOINT_COUNT, 3))
    return Tracks(p_WK, times(name, contents, len(p_WK)), side=side_of(name, contents))


def _hand(name: str, i: int, frame: dict, side: str) -> list | None:
    """21 points of the hand of that side, or None if the frame shows none."""
    hands = _list(name, i, frame, _WORLD)
    labels = [_label(label) for label in _list(name, i, frame, _HANDEDNESS)]
    if labels and len(labels) != len(hands):
        raise RecordingError(f"{name}: frame {i} has {len(labels)} handedness for {len(hands)} hands")
    if len(hands) > 1 and not labels:
        raise RecordingError(f"{name}: frame {i} shows {len(hands)} hands and does not say which is which")
    for number, hand in enumerate(hands):
        if labels and labels[number] != side:
            continue
        points = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, dict) else hand
        if not isinstance(points, list) or len(points) != KEYPOINT_COUNT:
            given = len(points) if isinstance(points, list) else type(points).__name__
            raise RecordingError(f"{name}: frame {i}: {KEYPOINT_COUNT} landmarks are wanted, {given} given")
        return [point(name, f"frame {i}, landmark {k}", value) for k, value in enumerate(points)]
    return None


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

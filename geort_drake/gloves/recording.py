"""A recording of a human hand, its file, and the checks that keep unusable recordings out."""

import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.files import atomic_path
from geort_drake.gloves.keypoints import (
    BONES,
    FINGER_KEYPOINTS,
    FINGER_NAMES,
    KEYPOINT_COUNT,
    MIDDLE_MCP,
    TIP_KEYPOINT,
    WRIST,
    bone_lengths,
)

# Raised when the meaning of p_HK changes, so that old files are recognised.
CONVENTION = 1
SIDES = ("left", "right")
PINCH_M = 0.015  # a thumb–finger distance below this counts as a pinch

_PALM_M = (0.060, 0.110)  # wrist to middle knuckle of people from a child of ten to a large adult
_TRAINING_FRAMES = 300
_FROZEN_S = 0.5
_GAP_S = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """Keypoints of one hand over time, in the wrist frame H (see `keypoints`).

    Attributes:
        t: (T,) time of each frame from 0, s.
        p_HK: (T, 21, 3) float32, m. A left hand is stored as its mirror image.
        valid: (T,) bool, False where tracking was lost; p_HK of such frames means nothing.
        X_WH: (T, 7) wrist pose in the tracker's world as qw qx qy qz x y z, or None.
        metadata: side, source, rate and whatever else the source said; JSON types only.
    """

    t: np.ndarray
    p_HK: np.ndarray
    valid: np.ndarray
    X_WH: np.ndarray | None = None
    metadata: dict = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        # float32 is what the file holds, so the digest survives a round trip.
        for name, dtype in (("t", np.float64), ("p_HK", np.float32), ("valid", np.bool_)):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=dtype))
        if self.X_WH is not None:
            object.__setattr__(self, "X_WH", np.asarray(self.X_WH, dtype=np.float64))
        frames = len(self.t) if self.t.ndim == 1 else -1
        wanted = {
            "t": (frames,),
            "p_HK": (frames, KEYPOINT_COUNT, 3),
            "valid": (frames,),
            "X_WH": (frames, 7),
        }
        for name, shape in wanted.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise RecordingError(f"recording: {name} must have shape {shape}, not {value.shape}")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def side(self) -> str:
        """Side of the recorded hand, "left" or "right"."""
        return str(self.metadata.get("side", "right"))

    @property
    def duration_s(self) -> float:
        return float(self.t[-1] - self.t[0]) if len(self) else 0.0

    @property
    def rate_hz(self) -> float:
        """Frames per second, from the median period, which gaps in tracking do not disturb."""
        return float(1.0 / np.median(np.diff(self.t)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of side, t, p_HK, valid and X_WH; the same before saving and after loading."""
        digest = hashlib.sha256(self.side.encode())
        for name in ("t", "p_HK", "valid", "X_WH"):
            value = getattr(self, name)
            digest.update(name.encode())
            if value is not None:
                digest.update(np.ascontiguousarray(value).tobytes())
        return digest.hexdigest()

    def fingertips(self, keypoints: Sequence[int] = tuple(TIP_KEYPOINT.values())) -> np.ndarray:
        """p_HF (T, F, 3) float64, m: the given keypoints of the valid frames."""
        return self.p_HK[self.valid][:, list(keypoints)].astype(float)

    def save(self, path: str | os.PathLike) -> None:
        """Writes the recording as .npz without pickle; the file is whole or absent."""
        if Path(path).suffix != ".npz":
            raise RecordingError(f"{path}: a recording is saved as .npz, not '{Path(path).suffix}'")
        arrays: dict[str, np.ndarray] = {"t": self.t, "p_HK": self.p_HK, "valid": self.valid}
        if self.X_WH is not None:
            arrays["X_WH"] = self.X_WH
        metadata = {**self.metadata, "side": self.side, "convention": CONVENTION}
        with atomic_path(path) as draft:
            # The stub takes every array for the argument allow_pickle.
            np.savez_compressed(draft, **arrays, metadata=np.array(json.dumps(metadata)))  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | os.PathLike) -> "Recording":
        """Reads a file written by `save`, without judging its contents (see `read_recording`).

        Raises:
            RecordingError: the file is missing, is no recording or is of another convention.
        """
        arrays = load_arrays(path)
        missing = [name for name in ("t", "p_HK", "valid", "metadata") if name not in arrays]
        if missing:
            raise RecordingError(f"{path}: not a recording, it lacks {', '.join(missing)}")
        try:
            metadata = json.loads(str(arrays["metadata"]))
        except json.JSONDecodeError as error:
            raise RecordingError(f"{path}: metadata is not JSON ({error})") from None
        if not isinstance(metadata, dict) or metadata.get("side") not in SIDES:
            raise RecordingError(f"{path}: metadata must name a side, one of: {', '.join(SIDES)}")
        if metadata.get("convention") != CONVENTION:
            raise RecordingError(
                f"{path}: convention {metadata.get('convention')} is not the one read here, {CONVENTION}"
            )
        try:
            return cls(arrays["t"], arrays["p_HK"], arrays["valid"], arrays.get("X_WH"), metadata)
        except (RecordingError, ValueError) as error:
            raise RecordingError(f"{path}: {str(error).removeprefix('recording: ')}") from None


def load_arrays(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, or of an .npy file under the name "data"; never unpickles."""
    path = Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"data": loaded}
        with loaded:
            return {name: loaded[name] for name in loaded.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        reason = "it holds pickled objects, which are never read" if "pickle" in str(error) else str(error)
        raise RecordingError(f"{path}: not a readable NumPy file: {reason}") from None


def check_recording(recording: Recording, name: str = "recording", training: bool = False) -> Recording:
    """Returns the recording with unusable frames marked invalid and `metadata["warnings"]` filled.

    Args:
        recording: in frame H; a left hand already mirrored.
        name: what error messages call it, usually the file.
        training: also ask for what training needs: 300 valid frames and at least one pinch.

    Raises:
        RecordingError: no or hardly any frames, many non-finite frames, time not increasing,
            wrong unit, wrong side, bones that change length, a signal that stands still.
    """
    warnings: list[str] = []
    if len(recording) < 2:
        raise RecordingError(f"{name}: at least 2 frames are needed, {len(recording)} given")
    _check_time(recording, name, warnings)
    recording = _mark_non_finite(recording, name, warnings)
    p_HK = recording.p_HK[recording.valid].astype(float)
    _check_unit(p_HK, name)
    _check_bones(p_HK, name, warnings)
    _check_side(p_HK, recording.side, name, warnings)
    _check_frozen(recording, name, warnings)
    if len(p_HK) < _TRAINING_FRAMES:
        message = f"{len(p_HK)} valid frames, training needs at least {_TRAINING_FRAMES}"
        if training:
            raise RecordingError(f"{name}: {message}")
        warnings.append(message)
    pinches = check_pinches(recording, name, required=training)
    without = [finger for finger, frames in pinches.items() if frames == 0]
    if without:
        warnings.append(f"the thumb never comes within {1e3 * PINCH_M:.0f} mm of: {', '.join(without)}")
    known = recording.metadata.get("warnings", [])
    metadata = {**recording.metadata, "warnings": known + [w for w in warnings if w not in known]}
    return dataclasses.replace(recording, metadata=metadata)


def check_pinches(
    recording: Recording, name: str = "recording", within_m: float = PINCH_M, required: bool = True
) -> dict[str, int]:
    """Number of valid frames in which the thumb tip is within `within_m` of each finger's tip.

    Raises:
        RecordingError: `required` and no finger is ever pinched.
    """
    p_HF = recording.fingertips()
    distance = np.linalg.norm(p_HF[:, 1:] - p_HF[:, :1], axis=-1)
    frames = {
        finger: int(n) for finger, n in zip(FINGER_NAMES[1:], (distance < within_m).sum(0), strict=True)
    }
    if required and not any(frames.values()):
        nearest = f"nearest {1e3 * distance.min():.0f} mm" if len(distance) else "no valid frame"
        raise RecordingError(
            f"{name}: no pinch: the thumb tip never comes within {1e3 * within_m:.0f} mm of another "
            f"fingertip ({nearest}); pinch each finger a few times while recording"
        )
    return frames


def _check_time(recording: Recording, name: str, warnings: list[str]) -> None:
    if not np.isfinite(recording.t).all():
        frame = int(np.argmin(np.isfinite(recording.t)))
        raise RecordingError(f"{name}: t is not a finite number in frame {frame}")
    step = np.diff(recording.t)
    if step.min() <= 0:
        frame = int(np.argmax(step <= 0)) + 1
        raise RecordingError(
            f"{name}: t must increase, but frame {frame} has {recording.t[frame]:.6f} s "
            f"after {recording.t[frame - 1]:.6f} s"
        )
    if step.max() > _GAP_S:
        frame = int(np.argmax(step)) + 1
        warnings.append(
            f"{(step > _GAP_S).sum()} gaps in time, the longest {step.max():.2f} s before frame {frame}"
        )


def _mark_non_finite(recording: Recording, name: str, warnings: list[str]) -> Recording:
    bad = recording.valid & ~np.isfinite(recording.p_HK).all(axis=(1, 2))
    if recording.X_WH is not None:
        bad |= recording.valid & ~np.isfinite(recording.X_WH).all(axis=1)
    valid = recording.valid & ~bad
    if bad.any():
        first = int(np.argmax(bad))
        message = f"{bad.sum()} of {len(bad)} frames are not finite numbers, the first is frame {first}"
        if bad.mean() > 0.1:
            raise RecordingError(f"{name}: {message}; at most one in ten may be lost")
        warnings.append(f"{message}; marked invalid")
    if valid.sum() < 2:
        raise RecordingError(f"{name}: only {valid.sum()} of {len(valid)} frames are valid")
    return dataclasses.replace(recording, valid=valid)


def _check_unit(p_HK: np.ndarray, name: str) -> None:
    palm = float(np.median(np.linalg.norm(p_HK[:, MIDDLE_MCP] - p_HK[:, WRIST], axis=-1)))
    low, high = _PALM_M
    if low <= palm <= high:
        return
    guess = ""
    for unit, metres in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
        if low <= palm * metres <= high:
            guess = f"; it would be right if the numbers were {unit}"
    raise RecordingError(
        f"{name}: wrist to middle knuckle must be {1e3 * low:.0f} to {1e3 * high:.0f} mm, "
        f"but is {palm:.4g} m{guess}: give keypoints in metres"
    )


def _check_bones(p_HK: np.ndarray, name: str, warnings: list[str]) -> None:
    length = bone_lengths(p_HK)
    mean, spread = length.mean(axis=0), length.std(axis=0) / np.maximum(length.mean(axis=0), 1e-9)
    if mean.min() < 1e-3:
        parent, child = BONES[int(np.argmin(mean))]
        raise RecordingError(f"{name}: keypoints {parent} and {child} coincide; 21 distinct ones are needed")
    worst = int(np.argmax(spread))
    message = (
        f"bone {BONES[worst][0]}–{BONES[worst][1]} changes its length by {100 * spread[worst]:.0f} % "
        f"(standard deviation over mean)"
    )
    if spread[worst] > 0.25:
        raise RecordingError(f"{name}: {message}, at most 25 % is usable; are these 3-D keypoints in metres?")
    if spread[worst] > 0.03:
        warnings.append(f"{message}: a tracker's noise, gloves stay below 3 %")


def _check_side(p_HK: np.ndarray, side: str, name: str, warnings: list[str]) -> None:
    # Fingers bend towards +x whichever pose the hand is in, so the turn from the first to the last
    # bone is about +y. In a mirror image y and z stay as they are and x = y × z changes sign.
    first, last = (
        np.stack([p_HK[:, k[i + 1]] - p_HK[:, k[i]] for k in list(FINGER_KEYPOINTS.values())[1:]], axis=1)
        for i in (0, 2)
    )
    turn = np.cross(first, last)[..., 1]
    turn = turn / (np.linalg.norm(first, axis=-1) * np.linalg.norm(last, axis=-1))
    bending = float(turn.mean())
    if bending < -0.02:
        other = SIDES[1 - SIDES.index(side)]
        raise RecordingError(
            f"{name}: the fingers bend backwards (mean sine {bending:.2f}), so this is a {other} hand "
            f"or a mirror image of a {side} one; read it with side '{other}'"
        )
    if bending < 0.02:
        warnings.append(
            "the fingers hardly bend, so whether this is a left or a right hand cannot be checked"
        )


def _check_frozen(recording: Recording, name: str, warnings: list[str]) -> None:
    p_HF = recording.fingertips()
    travel = np.linalg.norm(p_HF.std(axis=0), axis=-1)
    still = [finger for finger, value in zip(FINGER_NAMES, travel, strict=True) if value < 1e-3]
    if len(p_HF) >= _TRAINING_FRAMES and still:
        raise RecordingError(
            f"{name}: frozen signal: the tip of {', '.join(still)} moves by less than 1 mm "
            f"in {recording.duration_s:.1f} s"
        )
    same = np.all(recording.p_HK[1:] == recording.p_HK[:-1], axis=(1, 2))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    held = recording.t[ends] - recording.t[starts] if len(edges) else np.zeros(0)
    long = held > _FROZEN_S
    if not long.any():
        return
    longest = int(np.argmax(held))
    message = (
        f"frozen signal: frames repeat for {held[longest]:.1f} s from frame {starts[longest]}, "
        f"{held[long].sum():.1f} s in all"
    )
    if held[long].sum() > 0.5 * recording.duration_s:
        raise RecordingError(f"{name}: {message} of {recording.duration_s:.1f} s")
    warnings.append(message)

"""Recordings of a human hand and their file format."""

import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from geort_drake.errors import RecordingError, naming
from geort_drake.files import atomic_path
from geort_drake.people.keypoints import KEYPOINT_COUNT, TIP_KEYPOINT, mirrored, wrist_pose

# Incremented when the meaning of p_HK changes, so that old files are recognised.
CONVENTION = 1
OTHER_SIDE = {"left": "right", "right": "left"}
SIDES = tuple(OTHER_SIDE)
PINCH_M = 0.015  # a distance between the tips of thumb and finger below this counts as a pinch
# Largest size of a file, packed and unpacked; an hour at 120 Hz takes 1.5 GB in the largest format.
MAX_BYTES = 2 << 30
_TIME_TOLERANCE = 1e-6  # s; recorded times are sums of binary fractions

# Arrays that a recording may lack.
_OPTIONAL = ("X_WH", "robot")


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """Keypoints of one hand over time, in the wrist frame H (see `keypoints`).

    Attributes:
        t: (T,) time of each frame from 0, s.
        p_HK: (T, 21, 3) float32, m. A left hand is stored as its mirror image.
        valid: (T,) bool, False where tracking was lost; p_HK of such frames is meaningless.
        X_WH: (T, 7) wrist pose in the tracker's world W as qw qx qy qz x y z, m, or None.
        metadata: side, source and other facts stated by the source; JSON types only.
        robot: (T, n) float32 commanded and measured positions of the joints of a real robot, rad, with their
            names in metadata["robot_signals"], such as "arm.measured.panda_joint1"; or None.

    Raises:
        RecordingError: an array has another shape or type, or the side is neither "left" nor "right".
    """

    t: np.ndarray
    p_HK: np.ndarray
    valid: np.ndarray
    X_WH: np.ndarray | None = None
    metadata: dict = dataclasses.field(default_factory=dict)
    robot: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise RecordingError(f"recording: metadata must name a side, one of: {', '.join(SIDES)}")
        frames = np.size(self.t) if np.ndim(self.t) == 1 else -1
        # These are the types in the file, so the digest survives a round trip.
        fields: dict[str, tuple[type, tuple[int, ...]]] = {
            "t": (np.float64, (frames,)),
            "p_HK": (np.float32, (frames, KEYPOINT_COUNT, 3)),
            "valid": (np.bool_, (frames,)),
            "X_WH": (np.float64, (frames, 7)),
            "robot": (np.float32, (frames, len(self.metadata.get("robot_signals", [])))),
        }
        for name, (dtype, shape) in fields.items():
            if getattr(self, name) is None and name in _OPTIONAL:
                continue
            array = np.asarray(getattr(self, name))
            if array.dtype.kind not in "fiub" or array.shape != shape:
                actual = f"{array.dtype} {array.shape}"
                raise RecordingError(f"recording: {name} must be numbers of shape {shape}, not {actual}")
            if dtype is np.bool_ and not np.isin(array, (0, 1)).all():
                raise RecordingError(f"recording: {name} must be true or false, or 1 or 0, in each frame")
            # Numbers beyond float32 become infinite, which counts as lost.
            with np.errstate(over="ignore"):
                object.__setattr__(self, name, array.astype(dtype, copy=False))

    def __len__(self) -> int:
        return len(self.t)

    @property
    def side(self) -> str:
        """Side of the recorded hand, "left" or "right"."""
        return str(self.metadata.get("side", "right"))

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame, s; 0 if there are no frames."""
        return float(self.t[-1] - self.t[0]) if len(self) else 0.0

    @property
    def rate_hz(self) -> float:
        """Frames per second, from the median period."""
        return float(1.0 / np.median(np.diff(self.t)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of side, t, p_HK, valid and X_WH; unchanged by saving and loading."""
        digest = hashlib.sha256(self.side.encode())
        for name in ("t", "p_HK", "valid", "X_WH"):
            value = getattr(self, name)
            digest.update(name.encode())
            if value is not None:
                digest.update(np.ascontiguousarray(value).tobytes())
        return digest.hexdigest()

    def fingertips(self, keypoints: Sequence[int] = tuple(TIP_KEYPOINT.values())) -> np.ndarray:
        """Returns p_HF (N, F, 3) float64, m: the given keypoints in the N valid frames."""
        return self.p_HK[self.valid][:, list(keypoints)].astype(float)

    def tracked(self) -> "Recording":
        """Returns the recording without the frames in which tracking was lost."""
        return self._rows(self.t[self.valid], self.valid)

    def at(self, t: np.ndarray) -> "Recording":
        """Returns the recording resampled at times t (T,), s, each with the latest frame up to then."""
        return self._rows(t, newest(self.t, t))

    def _rows(self, t: np.ndarray, rows: np.ndarray) -> "Recording":
        names = ("p_HK", "valid", *(name for name in _OPTIONAL if getattr(self, name) is not None))
        return dataclasses.replace(self, t=t, **{name: getattr(self, name)[rows] for name in names})

    def mirrored(self) -> "Recording":
        """Returns the same motion of the other hand, mirrored in the xz-plane of H.

        The numbers do not change, because left hands are stored mirrored; only the side changes.
        `metadata["recorded_side"]` keeps the recorded side.
        """
        metadata = {"recorded_side": self.side, **self.metadata, "side": OTHER_SIDE[self.side]}
        return dataclasses.replace(self, metadata=metadata)

    def save(self, path: str | os.PathLike) -> None:
        """Writes the recording atomically as .npz, without pickle; other suffixes raise RecordingError."""
        if Path(path).suffix != ".npz":
            raise RecordingError(f"{path}: a recording is saved as .npz, not '{Path(path).suffix}'")
        arrays: dict[str, np.ndarray] = {"t": self.t, "p_HK": self.p_HK, "valid": self.valid}
        arrays |= {name: value for name in _OPTIONAL if (value := getattr(self, name)) is not None}
        metadata = {**self.metadata, "side": self.side, "convention": CONVENTION}
        metadata.pop("unit", None)  # of the source; this file is in metres
        with atomic_path(path) as draft:
            # NumPy's type stub mistakes the arrays for the argument allow_pickle.
            np.savez_compressed(draft, **arrays, metadata=np.array(json.dumps(metadata)))  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | os.PathLike) -> "Recording":
        """Reads a file written by `save`, without checks (see `read_recording`).

        Raises:
            RecordingError: the file is missing, not a recording, or of another convention.
        """
        with naming(path, RecordingError):
            return cls.from_arrays(load_arrays(Path(path)))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "Recording":
        """Makes a recording from the arrays that `save` writes; raises as `load` does."""
        missing = [field for field in ("t", "p_HK", "valid", "metadata") if field not in arrays]
        if missing:
            raise RecordingError(f"not a recording: it lacks {', '.join(missing)}")
        try:
            metadata = json.loads(str(arrays["metadata"]))
        except (ValueError, RecursionError) as error:
            raise RecordingError(f"metadata is not JSON ({error})") from None
        if not isinstance(metadata, dict) or metadata.get("side") not in SIDES:
            raise RecordingError(f"metadata must name a side, one of: {', '.join(SIDES)}")
        for field in ("warnings", "robot_signals"):
            texts = metadata.get(field, [])
            if not (isinstance(texts, list) and all(isinstance(text, str) for text in texts)):
                raise RecordingError(f"metadata {field} must be a list of strings, not {texts!r:.60}")
        if metadata.get("convention") != CONVENTION:
            raise RecordingError(
                f"convention {metadata.get('convention')!r} is not supported; expected {CONVENTION}"
            )
        optional = {name: arrays.get(name) for name in _OPTIONAL}
        return cls(arrays["t"], arrays["p_HK"], arrays["valid"], metadata=metadata, **optional)

    @classmethod
    def from_keypoints(
        cls, p_WK: np.ndarray, t: np.ndarray, side: str = "right", in_world: bool = False
    ) -> "Recording":
        """Makes a recording from keypoints in any frame, unchecked; `people.checks.examine` checks it.

        Args:
            p_WK: (T, 21, 3) keypoints of the real hand, m; frames with NaN become invalid.
            t: (T,) times, s; the recording's begin at 0.
            side: "right" or "left".
            in_world: whether W is fixed in space, so that the wrist's pose is kept.

        Raises:
            RecordingError: the shapes do not fit, or there is no such side.
        """
        t, p_WK = np.asarray(t, dtype=float), np.asarray(p_WK, dtype=float)
        if side not in SIDES or p_WK.shape != (len(t), KEYPOINT_COUNT, 3):
            raise RecordingError(
                f"a recording needs keypoints of shape (T, 21, 3), T times and a side of "
                f"{', '.join(SIDES)}, not {p_WK.shape}, {t.shape} and '{side}'"
            )
        p_VK = mirrored(p_WK) if side == "left" else p_WK
        with np.errstate(invalid="ignore", over="ignore"):
            R_WH, p_WH = wrist_pose(p_VK)
            p_HK = (p_VK - p_WH[:, None]) @ R_WH  # of row vectors
        valid = np.isfinite(p_HK).all(axis=(1, 2))
        metadata: dict = {"side": side}
        X_WH = _pose_vectors(R_WH, p_WH, valid) if in_world else None
        if X_WH is not None:
            travel = np.abs(X_WH[valid, 4:] - X_WH[valid, 4:][:1]).max(initial=0.0)
            # A glove without a tracker measures the wrist's orientation, but not its position.
            metadata["wrist_position_tracked"] = bool(travel > 1e-3)
        return cls(t - t[:1], p_HK, valid, X_WH, metadata)


def _pose_vectors(R_WH: np.ndarray, p_WH: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Returns wrist poses X_WH (T, 7) as qw qx qy qz x y z; frames that are not `valid` get the identity."""
    from scipy.spatial.transform import Rotation  # not needed on a robot's computer

    valid = valid & (np.linalg.det(np.nan_to_num(R_WH)) > 0.5)  # where squares overflow, R is unknown
    R_WH, p_WH = np.where(valid[:, None, None], R_WH, np.eye(3)), np.where(valid[:, None], p_WH, 0.0)
    quaternions = Rotation.from_matrix(R_WH).as_quat(scalar_first=True)
    # Signs are chosen so that neighbouring quaternions are close and can be interpolated.
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.where(np.concatenate([[0], np.cumsum(flips)]) % 2, -1.0, 1.0)
    return np.concatenate([quaternions * signs[:, None], p_WH], axis=1)


def newest(sample_times: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Returns for each time t (T,), s, the row of the latest sample up to it, of those at `sample_times`."""
    return np.maximum(np.searchsorted(sample_times, np.asarray(t) + _TIME_TOLERANCE, side="right") - 1, 0)


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of an .npz file, or that of an .npy file under the name "data"; never unpickles.

    Raises:
        RecordingError: the file is missing, not NumPy's, or larger than `MAX_BYTES`, packed or unpacked; the
            message does not name it.
    """
    check_file(path)
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                _check_size(sum(member.file_size for member in archive.infolist()))
        archive = np.load(path, allow_pickle=False)
        if isinstance(archive, np.ndarray):
            return {"data": archive}
        with archive:
            arrays = {name: archive[name] for name in archive.files}
            return {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}
    except RecordingError:
        raise
    except Exception as error:  # a corrupt archive may raise anything
        reason = "it contains pickled objects, which are never read" if "pickle" in str(error) else str(error)
        raise RecordingError(f"not a readable NumPy file: {reason}") from None


def check_file(path: Path) -> None:
    """Raises RecordingError unless `path` is a file of at most `MAX_BYTES`."""
    if not path.is_file():
        raise RecordingError("is no file" if path.exists() else "no such file")
    _check_size(path.stat().st_size)


def _check_size(size: int) -> None:
    if size > MAX_BYTES:
        raise RecordingError(f"has {size / 2**30:.1f} GiB; the limit is {MAX_BYTES >> 30} GiB")

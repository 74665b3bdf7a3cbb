"""Types for format readers: checked access to a file's contents, and the result of reading.

Readers raise RecordingError only if the meaning of a file is ambiguous. Faults of single frames are collected
in `Source.faults`; these frames become invalid and are reported.
"""

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks.findings import Finding, FrameFaults, warning
from geort_drake.people.formats.contents import (
    BadFrame,
    any_frame,
    description,
    empty_frames,
    frames_of,
    shape_of,
)
from geort_drake.people.recording import SIDES, Recording

# The keypoints among 25 joints: wrist, four of the thumb, then five per finger. A finger's first joint, the
# base of the metacarpal, is no keypoint.
KEYPOINTS_OF_25 = tuple(i for i in range(25) if i not in (5, 10, 15, 20))

NO_HAND, UNREADABLE = "show no hand", "cannot be read"

_TIME_FIELDS = ("t", "timestamps", "timestamp", "time", "timestampMs", "timestamp_ms")
_SIDE_FIELDS = ("side", "chirality", "handedness", "hand")
_ONE_WEEK_S = 6e5


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """The keypoints of one hand in a file.

    Attributes:
        p_WK: (T, 21, 3) keypoints in the file's frame W and unit; NaN where the hand was lost.
        t: (T,) times of the frames, s, NaN if a frame has none; None if the file has none (30 Hz assumed).
        world: whether W is fixed in space; if so, the wrist pose is kept.
        side: the side that the file states, or None; it must agree with the requested side.
        unit: unit of p_WK (m, cm, mm or inch) unless the user names another.
    """

    p_WK: np.ndarray
    t: np.ndarray | None = None
    world: bool = False
    side: str | None = None
    unit: str = "m"


class Format(NamedTuple):
    """One format of recordings.

    Attributes:
        title: short description for lists.
        suffixes: suffixes of its files, lower-case.
        recognizes: tells whether the contents of a file with such a suffix have this format.
        read: reads the hand of the requested side from a file.
    """

    title: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[Any], bool]
    read: Callable[["Source", str], Tracks | Recording]


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """A file while it is read.

    Attributes:
        name: name of the file in messages.
        contents: a dict of arrays (.npz, or .npy with the single name "data"), a `Table` (.csv), or the
            objects of a JSON or pickle file.
        faults: faults of single frames.
        findings: faults and repairs of the file as a whole.
    """

    name: str
    contents: Any
    faults: FrameFaults = dataclasses.field(default_factory=FrameFaults)
    findings: list[Finding] = dataclasses.field(default_factory=list)

    def error(self, what: str) -> RecordingError:
        """Makes an error that names the file."""
        return RecordingError(f"{self.name}: {what}")

    @property
    def header(self) -> Mapping[str, Any]:
        """Fields outside the frames."""
        return self.contents if isinstance(self.contents, Mapping) else {}

    def has(self, field: str) -> bool:
        """Whether the file, or one of its frames, has a field."""
        return field in self.header or any_frame(self.contents, lambda frame: field in frame)

    def _of_frames(self, field: str) -> list:
        frames = frames_of(self.contents)
        return [frame.get(field) if isinstance(frame, Mapping) else None for frame in frames]

    def array(self, field: str, *shapes: tuple[int, ...], count: int | None = None) -> np.ndarray:
        """Returns a field of every frame as floats (T, ...), from an archive's array or a list of frames.

        Args:
            field: name of the field.
            shapes: permitted shapes of one frame.
            count: T, if it is known.
        """
        if field in self.header:
            array = np.asarray(self.header[field])
            if array.ndim == 0 or array.shape[1:] not in shapes or array.dtype.kind not in "fiub":
                expected = " or ".join(f"({', '.join(['T', *map(str, shape)])})" for shape in shapes)
                given = f"{array.dtype} {array.shape}"
                raise self.error(f"{field} must be numbers of shape {expected}, not {given}")
            array = array.astype(float)
        elif self.has(field):
            values = self._of_frames(field)
            counts = Counter(shape for value in values if (shape := shape_of(value)) in shapes)
            shape = max(counts, key=counts.__getitem__, default=shapes[0])
            array = self.each(values, lambda value: value, shape, field)
        else:
            raise self.error(f"lacks {field}; it contains {description(self.contents)}")
        if count not in (None, len(array)):
            raise self.error(f"{len(array)} {field} for {count} frames")
        return array

    def each(
        self, values: Sequence[Any], read: Callable[[Any], Any], shape: tuple[int, ...], field: str
    ) -> np.ndarray:
        """Returns the numbers (T, *shape) that `read` returns for each frame; NaN where it returns none.

        `read` returns None if a frame shows no hand, and raises BadFrame if the frame cannot be read.

        Raises:
            RecordingError: no frame can be read.
        """
        result = np.full((len(values), *shape), np.nan)
        lost: list[int] = []
        bad: dict[int, str] = {}
        for i, value in enumerate(values):
            try:
                if (numbers := read(value)) is None:
                    lost.append(i)
                    continue
                array = np.asarray(numbers) if shape_of(numbers) == shape else np.array(None)
                if array.dtype.kind not in "fiu":
                    raise BadFrame(f"{field} must be numbers of shape {shape}, not {numbers!r:.60}")
                result[i] = array
            except BadFrame as error:
                bad[i] = str(error)
        if bad and len(bad) + len(lost) == len(values):
            raise self.error(f"frame {min(bad)}: {bad[min(bad)]}")
        self.faults.add(UNREADABLE, bad)
        self.faults.add(NO_HAND, lost)
        return result

    def times(self, count: int, unit_s: float = 1.0) -> np.ndarray | None:
        """Returns the times (T,) of the frames, s, from the file's time field (see `_TIME_FIELDS`), or None.

        Args:
            count: T, the number of frames.
            unit_s: unit of times within frames, s; an archive's array is in s.
        """
        field = next((name for name in _TIME_FIELDS if self.has(name)), None)
        if field is None:
            return None
        if field in self.header:
            t = self.array(field, (), count=count)
        else:
            t = _relative(self._of_frames(field), unit_s)
        return t if np.isfinite(t).any() else None

    def side(self) -> str | None:
        """Returns the side that the file states, or None.

        Raises:
            RecordingError: it states neither left nor right.
        """
        field = next((name for name in _SIDE_FIELDS if name in self.header), None)
        if field is None:
            return None
        side = str(self.header[field]).strip().lower()
        if side not in SIDES:
            raise self.error(f"{field} '{side:.40}' is none of: {', '.join(SIDES)}")
        return side

    def positions(self, field: str, p: np.ndarray, column_major: bool = False) -> np.ndarray:
        """Returns positions (T, J, 3) of joints given as points, poses or transforms.

        Args:
            field: name of the field in messages.
            p: (T, J, 3) points; (T, J, 7) `px py pz` and a quaternion, which is ignored; (T, J, 4, 4)
                transforms; or (T, J, 16) or (T, J * 16), flattened transforms.
            column_major: whether flattened transforms are column-major, as in graphics APIs.
        """
        if p.shape[-1] in (3, 7):
            return p[..., :3]
        X = p.reshape(len(p), math.prod(p.shape[1:]) // 16, 4, 4)
        return self.transforms(field, X, column_major and p.ndim < 4)[..., :3, 3]

    def mark_unreadable(self, bad: np.ndarray, known: np.ndarray, what: str) -> None:
        """Marks `bad` frames (T,) as unreadable; raises RecordingError if over half of `known` are."""
        if bad.sum() > 0.5 * known.sum():
            raise self.error(what)
        self.faults.add(UNREADABLE, np.flatnonzero(bad), what)

    def transforms(self, field: str, X: np.ndarray, column_major: bool = False) -> np.ndarray:
        """Returns transforms X (T, J, 4, 4) with the translation in the last column, transposed if needed.

        Raises:
            RecordingError: most frames have 0 0 0 1 neither as last row nor as last column.
        """
        end = np.array([0.0, 0.0, 0.0, 1.0])
        known = np.isfinite(X).all(axis=(1, 2, 3)) & ~empty_frames(X)
        upright = np.isclose(X[..., 3, :], end, atol=1e-5).all(axis=(1, 2))
        turned = np.isclose(X[..., :, 3], end, atol=1e-5).all(axis=(1, 2))
        # A matrix without translation fits both.
        uprights, turns = int((known & upright & ~turned).sum()), int((known & turned & ~upright).sum())
        bad = known & ~(turned if turns > uprights else upright)
        self.mark_unreadable(bad, known, f"{field} must be rigid transforms, whose last row is 0 0 0 1")
        X = np.where(bad[:, None, None, None], np.nan, X)
        X = np.swapaxes(X, -1, -2) if turns > uprights else X
        if uprights != turns and (turns > uprights) != column_major:
            advice = "transposed back; their zeros and ones confirm it"
            self.findings.append(warning("axes", "transforms are stored transposed", field, advice))
        return X


def _relative(stamps: Sequence[Any], unit_s: float) -> np.ndarray:
    """Returns times (T,), s, since the first stamp (the median if that is far off); NaN without a number."""
    # JSON's integers are unbounded.
    known = [isinstance(stamp, int | float) and -1e300 < stamp < 1e300 for stamp in stamps]
    numbers = sorted(itertools.compress(stamps, known))
    if not numbers:
        return np.full(len(stamps), np.nan)
    # Nanoseconds since an epoch exceed a double's resolution, so the start is subtracted first.
    start = numbers[len(numbers) // 2]
    if known[0] and abs(stamps[0] - start) * unit_s < _ONE_WEEK_S:
        start = stamps[0]
    return np.array([(t - start) * unit_s if good else np.nan for t, good in zip(stamps, known, strict=True)])

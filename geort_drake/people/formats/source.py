"""Types that format readers work with: a file's contents, checked access to them, and its result.

Readers raise RecordingError only where the meaning of a file stays open. Faults of single frames are noted in
`Source.faults`; these frames become invalid and are reported.
"""

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks.findings import Finding, FrameFaults, warning
from geort_drake.people.checks.timing import TIME_UNITS_S
from geort_drake.people.recording import SIDES, Recording

# Of hands with 25 joints: wrist, four of the thumb, then five per finger, of which the first, the base of the
# metacarpal, is none of the 21 keypoints.
KEYPOINTS_OF_25 = tuple(i for i in range(25) if i not in (5, 10, 15, 20))

NO_HAND, UNREADABLE = "show no hand", "cannot be read"

_TIME_FIELDS = ("t", "timestamps", "timestamp", "time")
_SIDE_FIELDS = ("side", "chirality", "handedness", "hand")
_ONE_WEEK_S = 6e5


class BadFrame(Exception):
    """A single frame cannot be read. The message says what was expected and what was given."""


@dataclasses.dataclass(frozen=True)
class Table:
    """A CSV file: names of the columns, and rows of texts."""

    header: list[str]
    rows: list[list[str]]


@dataclasses.dataclass(frozen=True, eq=False)
class Clock:
    """The times t (T,), s, of a file's frames, NaN where one has none; the file's field and its unit."""

    t: np.ndarray
    field: str
    unit: str = "s"


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """The keypoints of one hand as a file gives them.

    Attributes:
        p_WK: (T, 21, 3) keypoints in the file's frame W and unit; NaN where the hand was lost.
        clock: the times of the frames, or None where the file has none.
        world: whether W stays in place, so that the wrist's pose in it is worth keeping.
        side: which hand the file says it is, or None.
        unit: of p_WK, unless the user names another.
        findings: what is odd about the file as a whole, or was repaired.
    """

    p_WK: np.ndarray
    clock: Clock | None = None
    world: bool = False
    side: str | None = None
    unit: str = "m"
    findings: Sequence[Finding] = ()


@dataclasses.dataclass(frozen=True)
class Format:
    """One format of recordings.

    Attributes:
        title: what it is, for people.
        suffixes: of its files.
        recognizes: whether the contents of a file with such a suffix are of this format.
        read: takes the file and the side that the user asked for.
    """

    title: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[Any], bool]
    read: Callable[["Source", str], Tracks | Recording]


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """A file while it is read.

    Attributes:
        name: for messages.
        contents: a dict of arrays (.npz; of .npy with the one name "data"), a `Table` (.csv), or the objects
            of a JSON or pickle file.
        faults: of single frames.
    """

    name: str
    contents: Any
    faults: FrameFaults = dataclasses.field(default_factory=FrameFaults)

    def error(self, what: str) -> RecordingError:
        """An error that names the file."""
        return RecordingError(f"{self.name}: {what}")

    @property
    def header(self) -> Mapping[str, Any]:
        """The fields beside the frames."""
        return self.contents if isinstance(self.contents, Mapping) else {}

    def frames(self) -> list:
        """The frames of a file that holds a list of them, see `frames_of`."""
        frames = frames_of(self.contents)
        if not any(isinstance(frame, Mapping) for frame in frames):
            raise self.error("expected a list of frames, or an object with such a list named frames")
        return frames

    def has(self, field: str) -> bool:
        """Whether the file, or one of its frames, holds a field."""
        return field in self.header or any_frame(self.contents, lambda frame: field in frame)

    def array(self, field: str, *shapes: tuple[int, ...]) -> np.ndarray:
        """A field of every frame as floats (T, ...), from an archive's array or a list of frames.

        Args:
            field: its name.
            shapes: those that one frame may have.
        """
        if field not in self.header and self.has(field):
            values = [frame.get(field) if isinstance(frame, Mapping) else frame for frame in self.frames()]
            return self.stack(field, values, *shapes)
        if field not in self.header:
            raise self.error(f"lacks {field}; it holds {description(self.contents)}")
        array = np.asarray(self.header[field])
        if array.ndim == 0 or array.shape[1:] not in shapes or array.dtype.kind not in "fiu":
            name = "array" if self.header.keys() == {"data"} else field
            expected = " or ".join(f"({', '.join(['T', *map(str, shape)])})" for shape in shapes)
            raise self.error(f"{name} must hold numbers of shape {expected}, not {array.dtype} {array.shape}")
        return array.astype(float)

    def stack(self, field: str, values: Sequence[Any], *shapes: tuple[int, ...]) -> np.ndarray:
        """One value of each frame as floats (T, ...), with the shape that most frames have."""
        given = Counter(shape for value in values if (shape := shape_of(value)) in shapes)
        shape = given.most_common(1)[0][0] if given else shapes[0]
        return self.each(values, lambda value: value, shape, field)

    def each(
        self, values: Sequence[Any], read: Callable[[Any], Any], shape: tuple[int, ...], field: str
    ) -> np.ndarray:
        """The numbers (T, *shape) that `read` makes of each frame; NaN where it cannot, or returns None."""
        result = np.full((len(values), *shape), np.nan)

        def store(i: int) -> bool:
            if (numbers := read(values[i])) is None:
                return False
            if shape_of(numbers) != shape:
                raise BadFrame(f"{field} must have shape {shape}, not {shape_of(numbers) or numbers!r:.60}")
            array = np.asarray(numbers)
            if array.dtype.kind not in "fiu":
                raise BadFrame(f"{field} must be numbers, not {array.tolist()!r:.60}")
            result[i] = array
            return True

        stored = self.collect(range(len(values)), store)
        self.faults.add(NO_HAND, (i for i, done in enumerate(stored) if not done))
        return result

    def collect(self, values: Sequence[Any], read: Callable[[Any], Any]) -> list:
        """What `read` makes of each frame; None where it raises BadFrame, which is noted.

        Raises:
            RecordingError: nothing is read of any frame.
        """
        results: list[Any] = []
        bad: dict[int, str] = {}
        for i, value in enumerate(values):
            try:
                results.append(read(value))
            except BadFrame as error:
                results.append(None)
                bad[i] = str(error)
        if bad and not any(results):
            raise self.error(f"frame {min(bad)}: {bad[min(bad)]}")
        self.faults.add(UNREADABLE, bad)
        return results

    def times(self, count: int, field: str | None = None, unit: str = "s") -> Clock | None:
        """The times of `count` frames; None without any.

        Args:
            count: of frames.
            field: its name; by default t, timestamps, timestamp or time.
            unit: of its numbers, one of `TIME_UNITS_S`.
        """
        field = field or next((name for name in _TIME_FIELDS if self.has(name)), None)
        if field is None or not self.has(field):
            return None
        if field in self.header:
            t = self.array(field, ())
        else:
            stamps = [frame.get(field) if isinstance(frame, Mapping) else None for frame in self.frames()]
            t = _relative(stamps, TIME_UNITS_S[unit])
        if len(t) != count:
            raise self.error(f"{len(t)} {field} for {count} frames of data")
        return Clock(t, field, unit) if np.isfinite(t).any() else None

    def side(self) -> str | None:
        """The side that the file states, or None.

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

    def positions(
        self, field: str, p: np.ndarray, column_major: bool = False
    ) -> tuple[np.ndarray, list[Finding]]:
        """Positions (T, J, 3) of joints given as points, poses or transforms, and what was repaired.

        Args:
            field: name for messages.
            p: (T, J, 3) points; (T, J, 7) `px py pz` and a quaternion, which is not used; (T, J, 4, 4)
                transforms; or (T, J, 16) and (T, J * 16), the transforms' numbers in a row.
            column_major: whether numbers in a row stand column by column, as graphics APIs give them.
        """
        if p.shape[-1] == 7:
            self._check_quaternions(field, p)
        if p.shape[-1] in (3, 7):
            return p[..., :3], []
        X, findings = self.transforms(field, p.reshape(len(p), -1, 4, 4), column_major and p.ndim < 4)
        return X[..., :3, 3], findings

    def transforms(
        self, field: str, X: np.ndarray, column_major: bool = False
    ) -> tuple[np.ndarray, list[Finding]]:
        """Homogeneous transforms (T, J, 4, 4) with the translation in the last column, turned if need be.

        Raises:
            RecordingError: most have 0 0 0 1 neither as last row nor as last column.
        """
        end = np.array([0.0, 0.0, 0.0, 1.0])
        known = np.isfinite(X).all(axis=(1, 2, 3)) & ~empty_frames(X)
        upright = np.isclose(X[..., 3, :], end, atol=1e-5).all(axis=(1, 2))
        turned = np.isclose(X[..., :, 3], end, atol=1e-5).all(axis=(1, 2))
        # A matrix without translation may be either.
        uprights, turns = int((known & upright & ~turned).sum()), int((known & turned & ~upright).sum())
        bad = known & ~(turned if turns > uprights else upright)
        if len(X) and bad.sum() >= 0.5 * known.sum():
            given = np.round(X[np.argmax(bad), 0, 3], 3).tolist() if bad.any() else "NaN"
            raise self.error(f"{field} must hold rigid transforms, whose last row is 0 0 0 1, not {given}")
        self.faults.add(
            UNREADABLE, np.flatnonzero(bad), f"{field}: no rigid transform, whose last row is 0 0 0 1"
        )
        X = np.where(bad[:, None, None, None], np.nan, X)
        X = np.swapaxes(X, -1, -2) if turns > uprights else X
        if uprights == turns or (turns > uprights) == column_major:
            return X, []
        expected, given = ("columns", "rows") if column_major else ("rows", "columns")
        what = f"transforms are transposed: expected {expected}, got {given}"
        advice = "transposed back; their zeros and ones confirm it"
        return X, [warning("axes", what, field, advice)]

    def _check_quaternions(self, field: str, poses: np.ndarray) -> None:
        """Poses (T, J, 7) are positions and then quaternions, and not the other way round."""
        known = poses[~empty_frames(poses)]

        def off(part: slice) -> float:
            norms = np.linalg.norm(known[..., part], axis=-1)
            norms = norms[np.isfinite(norms)]
            return float(np.median(np.abs(norms - 1.0))) if norms.any() else 0.0

        last, first = off(slice(3, 7)), off(slice(0, 4))
        if last >= 0.1 or (last >= 1e-2 > first):
            advice = "; the quaternion stands first: move the position before it" if first < 1e-2 else ""
            raise self.error(
                f"{field} must hold px py pz and then a unit quaternion, but the norm of the last four "
                f"numbers is off by {last:.3g}{advice}"
            )


def frames_of(contents: Any) -> list:
    """The frames of a file that holds a list of them, or an object with such a list named frames; or none."""
    frames = contents.get("frames") if isinstance(contents, Mapping) else contents
    return frames if isinstance(frames, list) else []


def any_frame(contents: Any, fits: Callable[[Mapping], bool]) -> bool:
    """Whether one of the frames that are objects fits."""
    return any(fits(frame) for frame in frames_of(contents) if isinstance(frame, Mapping))


def shape_in(contents: Any, field: str) -> tuple[int, ...]:
    """The shape of an array in an archive; empty where there is none, or none of numbers."""
    array = contents.get(field) if isinstance(contents, Mapping) else None
    return array.shape if isinstance(array, np.ndarray) and array.dtype.kind in "fiu" else ()


def point(value: Any) -> Any:
    """A point given as [x, y, z], {"x": ..., "y": ..., "z": ...}, or null, which is NaN."""
    if value is None:
        return [np.nan] * 3
    return [value.get(axis) for axis in "xyz"] if isinstance(value, Mapping) else value


def empty_frames(values: np.ndarray) -> np.ndarray:
    """(T,) bool: frames of values (T, ...) that are all zeros, as some trackers store a hand not seen."""
    return (values == 0.0).all(axis=tuple(range(1, values.ndim)))


def shape_of(value: Any) -> tuple[int, ...] | None:
    """The shape of a value in a frame; None where its rows differ in length."""
    try:
        return np.shape(value)
    except ValueError:
        return None


def description(contents: Any) -> str:
    """A file's contents in a few words."""
    if isinstance(contents, Mapping):
        names = (key if isinstance(key, str) else f"<{type(key).__name__}>" for key in contents)
        shapes = (getattr(value, "shape", "") for value in contents.values())
        parts = [f"{name:.40}{shape}" for name, shape in zip(names, shapes, strict=True)]
        return ", ".join(parts[:8]) + (", ..." if len(parts) > 8 else "") or "nothing"
    if isinstance(contents, Table):
        return f"columns {', '.join(contents.header[:5])}, ..."
    if isinstance(contents, list):
        return f"a list of {len(contents)}" + (f" {type(contents[0]).__name__}" if contents else "")
    return type(contents).__name__


def _is_number(value: Any) -> bool:
    """Whether a value of a JSON file is a number that a float holds; JSON's integers have no bound."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 1 << 1000
    return isinstance(value, float) and np.isfinite(value)


def _relative(stamps: Iterable[Any], unit_s: float) -> np.ndarray:
    """Times (T,), s, from the first; NaN for what is no number."""
    stamps = [stamp if _is_number(stamp) else None for stamp in stamps]
    numbers = sorted(stamp for stamp in stamps if stamp is not None)
    if not numbers:
        return np.full(len(stamps), np.nan)
    # Nanoseconds since an epoch exceed what a double resolves, so the start is taken off first.
    start = numbers[len(numbers) // 2]
    if stamps[0] is not None and abs(stamps[0] - start) * unit_s < _ONE_WEEK_S:
        start = stamps[0]
    return np.array([np.nan if stamp is None else (stamp - start) * unit_s for stamp in stamps])

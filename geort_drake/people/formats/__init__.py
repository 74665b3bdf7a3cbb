"""Formats of recordings that are read, by name, and the detection of which one a file is in."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.formats import (
    dex_retargeting,
    geort,
    mano,
    manus,
    manus_csv,
    mediapipe,
    openxr,
    own,
    vision_pro,
    webxr,
)
from geort_drake.people.formats.tracks import Tracks
from geort_drake.people.recording import Recording

AUTO = "auto"


@dataclasses.dataclass(frozen=True)
class Format:
    """One format of recordings.

    Attributes:
        title: what it is, for people.
        suffixes: of its files.
        recognizes: whether contents of a file with such a suffix, as `files.load` gives them, are of it.
        read: takes the file's name for messages, its contents and the side asked for.
    """

    title: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[Any], bool]
    read: Callable[[str, Any, str], Tracks | Recording]


def _of(module: Any, title: str) -> Format:
    return Format(title, module.SUFFIXES, module.recognizes, module.read)


# In the order of detection: contents of one kind that two of them fit are of the first.
FORMATS: dict[str, Format] = {
    "geort_drake": _of(own, "geort-drake's own"),
    "manus": _of(manus, "raw MANUS skeleton, 25 nodes"),
    "manus_csv": _of(manus_csv, "MANUS Core's CSV export"),
    "openxr": _of(openxr, "OpenXR, 26 joints"),
    "webxr": _of(webxr, "WebXR, 25 joints"),
    "vision_pro": _of(vision_pro, "Apple Vision Pro, 25 or 27 transforms"),
    "dex_retargeting": _of(dex_retargeting, "dex-retargeting's hands"),
    "mano": _of(mano, "MANO or HO-3D, 21 joints"),
    "geort": _of(geort, "GeoRT, 21 keypoints in the wrist frame"),
    "mediapipe": _of(mediapipe, "MediaPipe, 21 world landmarks"),
}


def choose(name: str, suffix: str, contents: Any, format: str = AUTO) -> str:
    """The name of the format of a file's contents: the one given, or with "auto" the first that fits.

    Raises:
        UnknownNameError: there is no such format.
        RecordingError: the format has no such files, or no format fits; lists the choices.
    """
    if format != AUTO:
        if format not in FORMATS:
            raise UnknownNameError("format", format, [AUTO, *FORMATS])
        if suffix not in FORMATS[format].suffixes:
            wanted = ", ".join(FORMATS[format].suffixes)
            raise RecordingError(f"{name}: format '{format}' is read from {wanted}, not '{suffix}'")
        return format
    for known, entry in FORMATS.items():
        if suffix in entry.suffixes and entry.recognizes(contents):
            return known
    choices = "; ".join(
        f"{known} ({entry.title})" for known, entry in FORMATS.items() if suffix in entry.suffixes
    )
    raise RecordingError(
        f"{name}: holds {_told(contents)}, which fits no format known; choose one for '{suffix}' files: "
        f"{choices}"
    )


def suffix_of(path: Path) -> str:
    """A file's suffix in lower case; a folder stands for the pickles in it."""
    return ".pkl" if path.is_dir() else path.suffix.lower()


def _told(contents: Any) -> str:
    """A file's contents in a few words."""
    if isinstance(contents, dict):
        names = (key if isinstance(key, str) else f"<{type(key).__name__}>" for key in contents)
        shapes = (getattr(value, "shape", "") for value in contents.values())
        parts = [f"{name:.40}{shape}" for name, shape in zip(names, shapes, strict=True)]
        return ", ".join(parts[:8]) + (", ..." if len(parts) > 8 else "") or "nothing"
    if hasattr(contents, "header"):
        return f"columns {', '.join(contents.header[:5])}, ..."
    if isinstance(contents, list):
        return f"a list of {len(contents)}" + (f" {type(contents[0]).__name__}" if contents else "")
    return type(contents).__name__

"""The formats of recordings by name, and the detection of a file's format."""

from pathlib import Path
from typing import Any

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.formats import keypoint_arrays, manus, mediapipe, vision_pro, xr
from geort_drake.people.formats.contents import description
from geort_drake.people.formats.source import Format

AUTO = "auto"

# In the order of detection: if several formats fit, the first is used.
FORMATS: dict[str, Format] = {
    "geort_drake": keypoint_arrays.OWN,
    "manus": manus.RAW,
    "manus_csv": manus.CSV,
    "openxr": xr.OPENXR,
    "webxr": xr.WEBXR,
    "vision_pro": vision_pro.VISION_PRO,
    "dex_retargeting": keypoint_arrays.DEX_RETARGETING,
    "mano": keypoint_arrays.MANO,
    "geort": keypoint_arrays.GEORT,
    "mediapipe": mediapipe.MEDIAPIPE,
}


def choose(path: Path, contents: Any, format: str = AUTO) -> str:
    """Returns the name of the format of a file's contents: the given one, or with "auto" the first that fits.

    Raises:
        UnknownNameError: there is no such format.
        RecordingError: the format does not use the file's suffix, or no format fits; lists the choices.
    """
    suffix = ".pkl" if path.is_dir() else path.suffix.lower()
    if format != AUTO:
        if format not in FORMATS:
            raise UnknownNameError("format", format, [AUTO, *FORMATS])
        if suffix not in FORMATS[format].suffixes:
            expected = ", ".join(FORMATS[format].suffixes)
            raise RecordingError(f"{path}: format '{format}' is read from {expected} files, not '{suffix}'")
        return format
    candidates = {name: entry for name, entry in FORMATS.items() if suffix in entry.suffixes}
    for name, entry in candidates.items():
        if entry.recognizes(contents):
            return name
    choices = "; ".join(f"{name} ({entry.title})" for name, entry in candidates.items())
    raise RecordingError(
        f"{path}: contains {description(contents)}, which matches no known format; choose one for '{suffix}' "
        f"files: {choices}; or make a Recording from its keypoints in Python"
    )


__all__ = ["AUTO", "FORMATS", "Format", "choose"]

"""Paths of the models and diagrams, in a checkout and in an installed wheel."""

import os
from pathlib import Path

PACKAGE_NAME = "geort_drake"


def resource_root() -> Path:
    """The directory with `models/` and `diagrams/`.

    They are inside the package in a wheel, and next to it in a checkout.
    """
    package = Path(__file__).resolve().parent
    return package if (package / "models").is_dir() else package.parent


def models_dir() -> Path:
    """Directory of the SDF files and hand descriptions."""
    return resource_root() / "models"


def hand_names() -> list[str]:
    """Returns the names of the hands in models/hands, including those that users added."""
    return sorted(path.stem for path in (models_dir() / "hands").glob("*.yaml"))


def object_names() -> list[str]:
    """Returns the names of the objects that come with the package."""
    return sorted(path.stem for path in (models_dir() / "sdf" / "objects").glob("*.sdf"))


def diagrams_dir() -> Path:
    """Directory of the scenarios and model directives."""
    return resource_root() / "diagrams"


def resolve_uri(uri: str | os.PathLike) -> Path:
    """Turns `package://geort_drake/...` into a path; other text is taken as a path."""
    text = os.fspath(uri)
    prefix = f"package://{PACKAGE_NAME}/"
    return resource_root() / text.removeprefix(prefix) if text.startswith(prefix) else Path(text)


def cache_dir() -> Path:
    """Directory for reusable results: `$XDG_CACHE_HOME/geort_drake`, by default in `~/.cache`."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / PACKAGE_NAME

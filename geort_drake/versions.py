"""Versions of the software that made a result."""

import importlib.metadata
import platform
import subprocess
from pathlib import Path

import geort_drake

_PACKAGES = ("numpy", "scipy", "torch", "drake")


def versions() -> dict[str, str]:
    """Versions of this package, Python and the packages that affect results, and the platform, for JSON."""
    return {
        "geort_drake": geort_drake.__version__,
        "python": platform.python_version(),
        **{name: version_of(name) for name in _PACKAGES},
        "platform": platform.platform(),
    }


def git_state() -> dict | None:
    """Commit of the package's checkout and whether it had changes; None for an installed package."""
    root = Path(geort_drake.__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        return {"commit": git("rev-parse", "HEAD"), "changed": bool(git("status", "--porcelain"))}
    except (OSError, subprocess.SubprocessError):
        return None


def version_of(package: str) -> str:
    """Version of an installed package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"  # Drake may be installed without pip

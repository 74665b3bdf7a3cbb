"""Which software a result was made with."""

import importlib.metadata
import platform

import geort_drake

_PACKAGES = ("numpy", "scipy", "torch", "drake")


def versions() -> dict[str, str]:
    """Versions of this package, Python and what decides the figures, and the platform; JSON-ready."""
    return {
        "geort_drake": geort_drake.__version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "platform": platform.platform(),
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"  # Drake may be installed without pip

"""Which software a result was made with."""

import platform

import numpy as np

import geort_drake


def versions() -> dict[str, str]:
    """Versions of this package, Python and what decides the figures, and the platform; JSON-ready."""
    import pydrake
    import scipy
    import torch

    return {
        "geort_drake": geort_drake.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "torch": torch.__version__,
        "drake": getattr(pydrake, "__version__", "unknown"),
        "platform": platform.platform(),
    }

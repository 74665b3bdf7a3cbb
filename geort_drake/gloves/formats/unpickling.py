"""Unpickling of plain data alone: NumPy arrays and Python's own containers, and nothing that runs code."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError

# What NumPy's own pickles of arrays and scalars name, in its versions 1 and 2. Other containers, numbers
# and texts need no name in a pickle.
_MODULES = ("numpy.core.multiarray", "numpy._core.multiarray")
_ALLOWED = {
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy.core.numeric", "_frombuffer"),
    ("numpy._core.numeric", "_frombuffer"),
    *((module, name) for module in _MODULES for name in ("_reconstruct", "scalar")),
}


class _Refused(Exception):
    pass


def _latin1(text: str, encoding: str) -> bytes:
    """What the older protocols make bytes with; other codecs would let a small file grow without bound."""
    if encoding not in ("latin1", "latin-1"):
        raise _Refused(f"_codecs.encode to {encoding:.20}")
    return text.encode("latin1")


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Callable:
        if (module, name) == ("_codecs", "encode"):
            return _latin1
        if (module, name) not in _ALLOWED:
            raise _Refused(f"{module}.{name}")
        return super().find_class(module, name)

    def persistent_load(self, pid: Any) -> Any:
        raise _Refused(f"persistent id {pid!r:.40}")


def load_plain(path: Path) -> Any:
    """The contents of a pickle file that holds arrays, containers, numbers and texts only.

    Raises:
        RecordingError: the file is no pickle, or names anything else, which is not run.
    """
    try:
        with path.open("rb") as file, np.errstate(all="ignore"):
            # Pickles of Python 2 (HO-3D's) hold their arrays' bytes as text of this encoding.
            return _PlainUnpickler(file, encoding="latin1").load()
    except _Refused as refused:
        raise RecordingError(
            f"{path}: the pickle asks for {refused}, which could run code; only NumPy arrays, lists, dicts, "
            "numbers and texts are read"
        ) from None
    except Exception as error:  # a corrupt pickle raises nearly anything
        raise RecordingError(f"{path}: not a readable pickle: {error or type(error).__name__}") from None

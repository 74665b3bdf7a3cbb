"""Unpickles plain data only: NumPy arrays, Python's containers, numbers and strings; never runs code.

NumPy does not check the shapes and types in a pickle, and wrong ones crash the process. Checked stand-ins
therefore replace its functions.
"""

import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np

from geort_drake.errors import RecordingError


class ForbiddenPickle(Exception):
    """A pickle names something other than plain data."""


def _latin1(text: str, encoding: str) -> bytes:
    """Encodes bytes of older pickle protocols; other codecs could expand a small file without bound."""
    if encoding not in ("latin1", "latin-1"):
        raise ForbiddenPickle(f"_codecs.encode to {encoding:.20}")
    return text.encode("latin1")


class _Type:
    """Stand-in for `numpy.dtype`, limited to numbers, strings and objects; `dtype` is NumPy's own."""

    def __init__(self, code: str, *_: object):
        if not re.fullmatch(r"b1|[iufc][0-9]{1,2}|[SU][0-9]{1,6}|O8", code):
            raise ValueError(f"arrays of type {code!r:.40} are not read")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple) -> None:
        _, order, *structure = state
        if order not in ("<", ">", "=", "|") or any(part is not None for part in structure[:3]):
            raise ValueError("the type of an array is not one of numbers or strings")
        self.dtype = self.dtype.newbyteorder(order)


class _Array(np.ndarray):
    """Stand-in for `numpy.ndarray`; empty until its state is set."""

    def __new__(cls, _: object = None, shape: tuple = (), *more: object) -> "_Array":
        if shape != (0,):
            raise ValueError(f"an array of shape {shape!r:.40} without numbers")
        return super().__new__(cls, 0)

    def __setstate__(self, state: tuple) -> None:  # type: ignore[override]
        version, shape, kind, by_column, content = state
        if isinstance(content, str):
            content = content.encode("latin1")
        objects = kind.dtype.hasobject
        held = len(content) if objects else len(content) // kind.dtype.itemsize
        if type(content) is not (list if objects else bytes) or held != _size(shape):
            raise ValueError(f"an array of shape {shape!r:.40} contains something else")
        super().__setstate__((version, shape, kind.dtype, bool(by_column), content))  # type: ignore[arg-type]

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        return np.asarray(self).__reduce_ex__(protocol)  # other processes get a plain NumPy array


def _size(shape: tuple) -> int:
    if type(shape) is not tuple or not all(type(n) is int and n >= 0 for n in shape):
        raise ValueError(f"an array cannot have the shape {shape!r:.40}")
    return math.prod(shape)


def _scalar(kind: _Type, content: bytes | str) -> Any:
    return _from_buffer(content, kind, (1,))[0]


def _from_buffer(content: bytes | str, kind: _Type, shape: tuple, *order: object) -> np.ndarray:
    if kind.dtype.hasobject:
        raise ValueError("bytes cannot contain objects")
    content = content.encode("latin1") if isinstance(content, str) else content
    values = np.frombuffer(content, kind.dtype, _size(shape))
    return values.reshape(shape, order="F" if order[:1] == ("F",) else "C")


# The names in pickles of NumPy 1 and 2 arrays and scalars, and their stand-ins. Containers, numbers and
# strings of Python need no name.
_STAND_INS: dict[tuple[str, str], Callable] = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Type,
    ("_codecs", "encode"): _latin1,
}
for _core in ("numpy.core", "numpy._core"):
    _STAND_INS[f"{_core}.multiarray", "_reconstruct"] = _Array
    _STAND_INS[f"{_core}.multiarray", "scalar"] = _scalar
    _STAND_INS[f"{_core}.numeric", "_frombuffer"] = _from_buffer


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Callable:
        if (module, name) not in _STAND_INS:
            raise ForbiddenPickle(f"{module}.{name}")
        return _STAND_INS[module, name]

    def persistent_load(self, pid: Any) -> Any:
        raise ForbiddenPickle(f"persistent id {pid!r:.40}")


def load_plain(path: Path) -> Any:
    """Returns the contents of a pickle file that contains only arrays, containers, numbers and strings.

    Raises:
        RecordingError: the file is no pickle, or names anything else (the cause is then `ForbiddenPickle`).
    """
    try:
        with path.open("rb") as file, np.errstate(all="ignore"):
            # Python 2 pickles (HO-3D's) store the bytes of arrays as text in this encoding.
            return _PlainUnpickler(file, encoding="latin1").load()
    except ForbiddenPickle as forbidden:
        raise RecordingError(
            f"{path}: the pickle names {forbidden}, which could run code; only NumPy arrays, lists, "
            "dicts, numbers and strings are read"
        ) from forbidden
    except Exception as error:  # a corrupt pickle may raise anything
        raise RecordingError(f"{path}: not a readable pickle: {error or type(error).__name__}") from None

"""21 joints in MANO's order with the tips after them, as in HO-3D and H2O-3D.

Order: wrist 0, then three joints each of index 1–3, middle 4–6, little finger 7–9, ring 10–12 and thumb
13–15, then the tips of thumb 16, index 17, middle 18, ring 19 and little finger 20. Metres. HO-3D gives
them in its camera's frame as `handJoints3D` (OpenGL: y up, −z forward), without times.

.npy (T, 21, 3); .npz with `handJoints3D` or `joints` (T, 21, 3), optionally `t`, s, and `side`; .pkl with a
list of HO-3D's annotations; or HO-3D's own folder `meta`, with one .pkl per frame. Frames without
annotation are lost.
DexYCB and FreiHAND store MediaPipe's order: read them with that format.

Source: https://github.com/shreyashampali/ho3d, vis_HO3D.py (jointsMapManoToSimple) and README; the order
of MANO's joints: https://github.com/otaheri/MANO
"""

from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks.order import MANO_ORDER, ORDERS, fitting_order
from geort_drake.people.formats.tracks import Tracks, numbers, shape_of, side_of, times

SUFFIXES = (".npy", ".npz", ".pkl", ".pickle")

_FIELD = "handJoints3D"
_PLACES = np.argsort(MANO_ORDER)


def recognizes(contents: Any) -> bool:
    if isinstance(contents, list):
        return bool(contents) and isinstance(contents[0], dict) and _FIELD in contents[0]
    if not isinstance(contents, dict):
        return False
    if _FIELD in contents:
        return True
    data = contents.get("data") if contents.keys() == {"data"} else contents.get("joints")
    if not isinstance(data, np.ndarray) or data.shape[1:] != (21, 3) or data.dtype.kind not in "fiu":
        return False
    known = data[np.isfinite(data).all(axis=(1, 2))]
    order = fitting_order(known) if len(known) else None
    return ORDERS.get(order or "") == MANO_ORDER


def read(name: str, contents: Any, side: str) -> Tracks:
    if isinstance(contents, list):
        p = numbers(name, _FIELD, [_frame(name, i, frame) for i, frame in enumerate(contents)], (21, 3))
        return Tracks(p[:, _PLACES], world=True)
    field = next((field for field in (_FIELD, "joints", "data") if field in contents), None)
    if field is None:
        raise RecordingError(f"{name}: MANO's joints must be called {_FIELD}, not {', '.join(contents)}")
    p = numbers(name, "array" if field == "data" else field, contents[field], (21, 3))
    return Tracks(
        p[:, _PLACES], times(name, contents, len(p)), world=field == _FIELD, side=side_of(name, contents)
    )


def _frame(name: str, i: int, frame: Any) -> np.ndarray:
    if not isinstance(frame, dict) or _FIELD not in frame:
        raise RecordingError(f"{name}: frame {i} must be a dict with {_FIELD}")
    joints = frame[_FIELD]
    if joints is None:
        return np.full((21, 3), np.nan)
    shape = shape_of(joints)
    if shape != (21, 3):
        wrist = " (the wrist alone: HO-3D's evaluation split)" if shape == (3,) else ""
        raise RecordingError(f"{name}: frame {i}: {_FIELD} must have shape (21, 3), not {shape}{wrist}")
    return joints

"""Formats that hold the 21 keypoints themselves: geort-drake's own, GeoRT's, dex-retargeting's and MANO's.

geort-drake's own .npz is what `Recording.save` writes: t, p_HK, valid, optionally X_WH, and metadata.
Source: docs/reference/recording-formats.md

GeoRT's .npy is (T, 21, 3) in MediaPipe's order, m, in the wrist frame, without times.
Source: https://github.com/facebookresearch/GeoRT, README (recording of human hands)

dex-retargeting's .pkl is a list of (21, 3) arrays, one per frame, None where no hand was seen: MediaPipe's
world landmarks, m, moved to the wrist and turned to axes that the palm gives; no times, no wrist pose.
Source: https://github.com/dexsuite/dex-retargeting, example/profiling/generate_human_data_from_video.py and
example/vector_retargeting/single_hand_detector.py

MANO's 21 joints are the wrist, then three each of index, middle, little, ring finger and thumb, then the
tips of thumb, index, middle, ring and little finger, m. HO-3D gives them in its camera's frame as
`handJoints3D` (OpenGL: y up, -z forward), without times: a .pkl with a list of its annotations, or its
folder `meta` with one .pkl per frame. Also .npy (T, 21, 3), or .npz with `handJoints3D` or `joints`,
optionally `t`, s, and `side`. DexYCB and FreiHAND store MediaPipe's order.
Source: https://github.com/shreyashampali/ho3d, vis_HO3D.py (jointsMapManoToSimple), and
https://github.com/otaheri/MANO
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geort_drake.people.checks.findings import warning
from geort_drake.people.checks.order import MANO_ORDER, ORDERS, fitting_order
from geort_drake.people.formats.source import Format, Source, Tracks, any_frame, shape_in
from geort_drake.people.keypoints import KEYPOINT_COUNT, mirrored, to_wrist_frame
from geort_drake.people.recording import Recording

_SHAPE = (KEYPOINT_COUNT, 3)
_MOVED_M = 1e-3
_HO3D = "handJoints3D"
_MANO_PLACES = np.argsort(MANO_ORDER)


def _read_own(file: Source, side: str) -> Recording:
    return Recording.from_arrays(file.name, file.header)


def _is_geort(contents: Any) -> bool:
    return shape_in(contents, "data")[1:] == _SHAPE and _moved(contents["data"]) < _MOVED_M


def _read_geort(file: Source, side: str) -> Tracks:
    p_HK = file.array("data", _SHAPE)
    moved = _moved(p_HK)
    if moved <= _MOVED_M:
        return Tracks(p_HK)
    what = f"not given in the wrist frame: moved by {1e3 * moved:.0f} mm to get there"
    return Tracks(p_HK, findings=[warning("axes", what, "array")])


def _moved(p: np.ndarray) -> float:
    """Median distance of keypoints from the wrist frame of either side, for a palm of 0.1 in any unit."""
    known = p[np.isfinite(p).all(axis=(1, 2))].astype(float)
    if not len(known):
        return np.inf
    palm = max(float(np.median(np.linalg.norm(known[:, 9] - known[:, 0], axis=-1))), 1e-12)
    off = (np.abs(to_wrist_frame(q) - q).max(axis=(1, 2)) for q in (known, mirrored(known)))
    return float(min(np.median(np.nan_to_num(distance)) for distance in off) * 0.1 / palm)


def _is_dex_retargeting(contents: Any) -> bool:
    if isinstance(contents, np.ndarray):
        return contents.shape[1:] == _SHAPE
    return isinstance(contents, list) and any(isinstance(frame, np.ndarray) for frame in contents)


def _read_dex_retargeting(file: Source, side: str) -> Tracks:
    if not isinstance(file.contents, list | np.ndarray):
        raise file.error(f"expected a list of (21, 3) arrays, not {type(file.contents).__name__}")
    return Tracks(file.stack("the array", list(file.contents), _SHAPE))


def _is_mano(contents: Any) -> bool:
    if isinstance(contents, list):
        return any_frame(contents, lambda frame: _HO3D in frame)
    if not isinstance(contents, Mapping) or _HO3D in contents:
        return isinstance(contents, Mapping)
    field = "data" if contents.keys() == {"data"} else "joints"
    if shape_in(contents, field)[1:] != _SHAPE:
        return False
    known = contents[field][np.isfinite(contents[field]).all(axis=(1, 2))]
    return len(known) > 0 and ORDERS.get(fitting_order(known) or "") == MANO_ORDER


def _read_mano(file: Source, side: str) -> Tracks:
    field = next((name for name in (_HO3D, "joints", "data") if file.has(name)), _HO3D)
    p = file.array(field, _SHAPE)[:, _MANO_PLACES]
    return Tracks(p, file.times(len(p)), world=field == _HO3D, side=file.side())


OWN = Format("geort-drake's own", (".npz",), lambda contents: "p_HK" in contents, _read_own)
GEORT = Format("GeoRT, 21 keypoints in the wrist frame", (".npy",), _is_geort, _read_geort)
DEX_RETARGETING = Format(
    "dex-retargeting's hands", (".pkl", ".pickle"), _is_dex_retargeting, _read_dex_retargeting
)
MANO = Format("MANO or HO-3D, 21 joints", (".npy", ".npz", ".pkl", ".pickle"), _is_mano, _read_mano)

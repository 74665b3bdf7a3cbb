"""Formats that contain the 21 keypoints themselves: geort-drake's own, GeoRT's, dex-retargeting's and MANO's.

`geort`: (T, 21, 3) in .npy, m, in the wrist frame H.

`dex_retargeting`: a list of (21, 3) arrays or None in .pkl, m: MediaPipe's world landmarks, moved to the
wrist and rotated to axes of the palm.

`mano`: (T, 21, 3), m, in .npy or .npz (the latter with optional `t`, s): wrist, three joints each of index,
middle, little, ring finger and thumb, then the tips of thumb to little finger. HO-3D stores them in .pkl, one
file per frame or all in one, in the camera's frame (y up, −z forward).

An array in .npy is `mano` if its distances fit that order, `geort` if the hands are in H, otherwise
`mediapipe`.

Source: https://github.com/facebookresearch/GeoRT, README (recording of human hands),
https://github.com/dexsuite/dex-retargeting, example/profiling/generate_human_data_from_video.py and
example/vector_retargeting/single_hand_detector.py, https://github.com/shreyashampali/ho3d, vis_HO3D.py
(jointsMapManoToSimple), and https://github.com/otaheri/MANO
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geort_drake.people.checks.anatomy import MANO_ORDER, ORDERS, fitting_order
from geort_drake.people.formats.contents import any_frame, shape_in
from geort_drake.people.formats.source import Format, Source, Tracks
from geort_drake.people.keypoints import KEYPOINT_COUNT, MIDDLE_MCP, WRIST
from geort_drake.people.recording import Recording

_SHAPE = (KEYPOINT_COUNT, 3)
_HO3D = "handJoints3D"
_PICKLES = (".pkl", ".pickle")


def _read_own(file: Source, side: str) -> Recording:
    return Recording.from_arrays(file.name, file.header)


def _is_geort(contents: Any) -> bool:
    """Whether the wrist is the origin in every frame, to 1 % of the palm."""
    if shape_in(contents, "data")[1:] != _SHAPE:
        return False
    distances = np.abs(contents["data"][:, [WRIST, MIDDLE_MCP]]).max(axis=2)
    seen = distances[~np.isnan(distances).any(axis=1)]
    if not len(seen):
        return False
    wrist, knuckle = np.median(seen, axis=0)
    return bool(wrist < 0.01 * knuckle)


def _read_geort(file: Source, side: str) -> Tracks:
    return Tracks(file.array("data", _SHAPE))


def _is_dex_retargeting(contents: Any) -> bool:
    if isinstance(contents, np.ndarray):
        return contents.shape[1:] == _SHAPE
    return isinstance(contents, list) and any(isinstance(frame, np.ndarray) for frame in contents)


def _read_dex_retargeting(file: Source, side: str) -> Tracks:
    if not isinstance(file.contents, list | np.ndarray):
        raise file.error(f"expected a list of (21, 3) arrays, not {type(file.contents).__name__}")
    return Tracks(file.each(list(file.contents), lambda array: array, _SHAPE, "the array"))


def _is_mano(contents: Any) -> bool:
    if isinstance(contents, list):
        return any_frame(contents, lambda frame: _HO3D in frame)
    if not isinstance(contents, Mapping) or _HO3D in contents:
        return isinstance(contents, Mapping)
    field = "data" if contents.keys() == {"data"} else "joints"
    if shape_in(contents, field)[1:] != _SHAPE:
        return False
    known = contents[field][np.isfinite(contents[field]).all(axis=(1, 2))]
    return len(known) > 0 and ORDERS.get(fitting_order(known)[0] or "") == MANO_ORDER


def _read_mano(file: Source, side: str) -> Tracks:
    field = next((name for name in (_HO3D, "joints", "data") if file.has(name)), _HO3D)
    p = file.array(field, _SHAPE)[:, np.argsort(MANO_ORDER)]
    return Tracks(p, file.times(len(p)), world=field == _HO3D, side=file.side())


OWN = Format("geort-drake's own", (".npz",), lambda contents: "p_HK" in contents, _read_own)
GEORT = Format("GeoRT, 21 keypoints in the wrist frame", (".npy",), _is_geort, _read_geort)
DEX_RETARGETING = Format("dex-retargeting's hands", _PICKLES, _is_dex_retargeting, _read_dex_retargeting)
MANO = Format("MANO or HO-3D, 21 joints", (".npy", ".npz", *_PICKLES), _is_mano, _read_mano)

"""Reads signals, states and poses of a recording as arrays at common times."""

import os
import warnings
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from geort_drake.errors import RecordingError
from geort_drake.rerun.writer import TIMELINE, WORLD

_NAMES = "SeriesLines:names"
_SCALARS, _STATE = "Scalars:scalars", "StateChange:state"
_ROTATION, _TRANSLATION = "Transform3D:quaternion", "Transform3D:translation"


@dataclass(frozen=True)
class RecordedSamples:
    """Samples of a recorder. Names are entity paths with dots, in the order of the file.

    Attributes:
        t: (T,) all times at which anything was sampled, s.
        signals: name → (T,) latest values at these times.
        states: name → (T,) names of the states.
        poses: name → X_WB (T, 7) of each moving body as qw qx qy qz x y z, m.
    """

    t: np.ndarray
    signals: dict[str, np.ndarray] = field(default_factory=dict)
    states: dict[str, np.ndarray] = field(default_factory=dict)
    poses: dict[str, np.ndarray] = field(default_factory=dict)


def read_samples(path: str | os.PathLike) -> RecordedSamples:
    """Reads a file written by `RerunRecorder`.

    Raises:
        RecordingError: the file is missing or truncated, is no Rerun recording, or contains no samples.
    """
    columns, names = _columns(Path(path))
    if not columns:
        raise RecordingError(f"{path}: has no samples on the timeline {TIMELINE}")
    t_ns = np.unique(np.concatenate([stamps for stamps, _ in columns.values()]))
    samples = RecordedSamples(1e-9 * t_ns)
    for (entity, component), (stamps, values) in columns.items():
        rows = np.maximum(np.searchsorted(stamps, t_ns, side="right") - 1, 0)
        name = entity.strip("/").replace("/", ".")
        if component == _SCALARS:
            table = _matrix(values)[rows]
            # The legend adds the last part of the signal's key to each name.
            label = name.split(".")[1:2]
            for i, series in enumerate(names[entity]):
                samples.signals[f"{name}.{series.removesuffix(f' {label[0]}' if label else '')}"] = table[
                    :, i
                ]
        elif component == _STATE:
            samples.states[name] = np.array(values.flatten().to_pylist())[rows]
        elif component == _ROTATION:
            xyzw, xyz = _matrix(values)[rows], _matrix(columns[entity, _TRANSLATION][1])[rows]
            X_WB = np.hstack([xyzw[:, 3:], xyzw[:, :3], xyz]).astype(float)
            samples.poses[name.removeprefix(f"{WORLD}.")] = X_WB
    return samples


def _columns(path: Path) -> tuple[dict[tuple[str, str], tuple[np.ndarray, pa.Array]], dict[str, list[str]]]:
    """Returns times, ns, and values of each entity and component, and the names of each entity's series."""
    pieces: dict[tuple[str, str], list[tuple[bytes, np.ndarray, pa.Array]]] = defaultdict(list)
    names: dict[str, list[str]] = {}
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a truncated file raises an error below
            for chunk in RrdReader(path).stream():
                batch = chunk.to_record_batch()
                present = batch.schema.names
                if _NAMES in present:
                    names[chunk.entity_path] = batch.column(_NAMES)[0].as_py()
                if TIMELINE not in present or not batch.num_rows:
                    continue
                row_id = batch.column("rerun.controls.RowId")[0].as_py()
                stamps = batch.column(TIMELINE).cast(pa.int64()).to_numpy()
                for component in (_SCALARS, _STATE, _ROTATION, _TRANSLATION):
                    if component in present:
                        pieces[chunk.entity_path, component].append((row_id, stamps, batch.column(component)))
    except (RuntimeError, ValueError) as error:
        raise RecordingError(f"{path}: not a readable Rerun recording: {error}") from error
    columns = {}
    # Row ids increase in the order of writing.
    for key, parts in sorted(pieces.items(), key=lambda item: min(part[0] for part in item[1])):
        stamps = np.concatenate([part[1] for part in parts])
        order = np.argsort(stamps, kind="stable")
        columns[key] = stamps[order], pa.concat_arrays([part[2] for part in parts]).take(pa.array(order))
    return columns, names


def _matrix(values: pa.Array) -> np.ndarray:
    """Converts one list per row, nested or not, to an array (T, n)."""
    flat = values
    while pa.types.is_nested(flat.type):
        flat = flat.flatten()
    return flat.to_numpy(zero_copy_only=False).reshape(len(values), -1)

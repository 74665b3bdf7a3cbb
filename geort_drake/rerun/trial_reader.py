"""What a trial's Rerun recording holds beside pictures: signals, states and poses, as arrays."""

import os
import warnings
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from geort_drake.errors import RecordingError

TIMELINE = "sim_time"
_ROW, _NAMES = "rerun.controls.RowId", "SeriesLines:names"
_SCALARS, _STATE = "Scalars:scalars", "StateChange:state"
_ROTATION, _TRANSLATION = "Transform3D:quaternion", "Transform3D:translation"


@dataclass(frozen=True)
class Trial:
    """Everything at the times t (T,), s, at which anything was sampled; names are paths with dots.

    Attributes:
        signals: (T,) each.
        states: (T,) names of states.
        poses: X_WB (T, 7) of the moving bodies, qw qx qy qz x y z.
    """

    t: np.ndarray
    signals: dict[str, np.ndarray]
    states: dict[str, np.ndarray]
    poses: dict[str, np.ndarray]


def read_trial(path: str | os.PathLike) -> Trial:
    """Reads a file of `RerunRecorder`; bodies and signals come in the order in which they were written.

    Raises:
        RecordingError: the file is missing, cut off, not Rerun's, or holds no samples.
    """
    columns, names = _columns(Path(path))
    series: dict[tuple[str, str], tuple[np.ndarray, pa.Array]] = {}
    for key, pieces in sorted(columns.items(), key=lambda item: min(piece[0] for piece in item[1])):
        stamps = np.concatenate([piece[1] for piece in pieces])
        order = np.argsort(stamps, kind="stable")
        series[key] = stamps[order], pa.concat_arrays([piece[2] for piece in pieces]).take(pa.array(order))
    sampled = [stamps for stamps, _ in series.values()]
    if not sampled:
        raise RecordingError(f"{path}: nothing was sampled on the time line {TIMELINE}")
    t_ns = np.unique(np.concatenate(sampled))
    trial = Trial(1e-9 * t_ns, {}, {}, {})
    for (entity, component), (stamps, values) in series.items():
        rows = np.maximum(np.searchsorted(stamps, t_ns, side="right") - 1, 0)
        name = entity.strip("/").replace("/", ".")
        if component == _SCALARS:
            table = _matrix(values)[rows]
            labels = names.get(entity, [str(i) for i in range(table.shape[1])])
            # A legend adds the last part of the signal's key to each name.
            short = [label.removesuffix(f" {name.split('.')[1]}") for label in labels]
            trial.signals.update({f"{name}.{label}": table[:, i] for i, label in enumerate(short)})
        elif component == _STATE:
            trial.states[name] = np.array(values.flatten().to_pylist())[rows]
        elif component == _ROTATION and (entity, _TRANSLATION) in series:
            xyzw, xyz = _matrix(values)[rows], _matrix(series[entity, _TRANSLATION][1])[rows]
            trial.poses[name.removeprefix("world.")] = np.hstack([xyzw[:, 3:], xyzw[:, :3], xyz]).astype(
                float
            )
    return trial


def _columns(path: Path) -> tuple[dict, dict[str, list[str]]]:
    """The wanted columns as pieces (first row id, times in ns, values), and the names of the series."""
    columns: dict[tuple[str, str], list[tuple[bytes, np.ndarray, pa.Array]]] = defaultdict(list)
    names: dict[str, list[str]] = {}
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a file that was cut off is an error below
            for chunk in RrdReader(path).stream():
                batch = chunk.to_record_batch()
                held = batch.schema.names
                if _NAMES in held:
                    names[chunk.entity_path] = batch.column(_NAMES)[0].as_py()
                if TIMELINE not in held or not batch.num_rows:
                    continue
                stamps = batch.column(TIMELINE).cast(pa.int64()).to_numpy()
                for component in (_SCALARS, _STATE, _ROTATION, _TRANSLATION):
                    if component in held:
                        piece = batch.column(_ROW)[0].as_py(), stamps, batch.column(component)
                        columns[chunk.entity_path, component].append(piece)
    except (RuntimeError, ValueError) as error:
        raise RecordingError(f"{path}: not a readable Rerun recording: {error}") from error
    return columns, names


def _matrix(values: pa.Array) -> np.ndarray:
    """(T, n) of a list per row, nested or not."""
    flat = values
    while pa.types.is_nested(flat.type):
        flat = flat.flatten()
    return flat.to_numpy(zero_copy_only=False).reshape(len(values), -1)

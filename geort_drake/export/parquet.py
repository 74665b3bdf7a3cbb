"""Writes episodes as Parquet: a row per sample in frames/NAME.parquet, a row per episode in episodes.parquet.

All files in frames/ have the same columns, because readers of a folder take the columns of its first file.
Data that an episode lacks, such as the pose of another episode's object, are null.
"""

import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from geort_drake.export.episode import Episode
from geort_drake.files import atomic_directory, require_replaceable

FRAMES, EPISODES = "frames", "episodes.parquet"


def write_parquet(episodes: Iterable[Episode], output: str | os.PathLike) -> Iterator[str]:
    """Writes a folder atomically and yields the name of each finished episode.

    Raises:
        OutputError: `output` exists and is not an earlier export.
    """
    require_replaceable(output, EPISODES)
    with atomic_directory(output) as draft:
        (draft / FRAMES).mkdir()
        lines = []
        for episode in episodes:
            pq.write_table(frame_table(episode), draft / FRAMES / f"{episode.name}.parquet")
            # Nested facts differ between trials, but a column has one type.
            facts = {
                key: json.dumps(value) if isinstance(value, dict | list) else value
                for key, value in episode.facts.items()
            }
            lines.append({"episode": episode.name, "frames": len(episode.t), "robot": episode.robot, **facts})
            yield episode.name
        _unify_columns(sorted((draft / FRAMES).iterdir()))
        pq.write_table(pa.Table.from_pylist(lines), draft / EPISODES)


def frame_table(episode: Episode) -> pa.Table:
    """Returns the episode's samples; the glove's keypoints and poses are null while the hand is lost."""
    lost = ~episode.glove.valid
    columns: dict[str, pa.Array] = {
        "episode": pa.array([episode.name] * len(lost)).dictionary_encode(),
        "t": episode.samples["t"],
        "glove.valid": pa.array(episode.glove.valid),
        "glove.p_HK": rows(episode.glove.p_HK.reshape(-1, 63), lost),
    }
    if episode.glove.X_WH is not None:
        columns["glove.X_WH"] = rows(episode.glove.X_WH, lost)
    for name in episode.samples.column_names[1:]:
        column = episode.samples[name]
        if name.startswith("pose."):  # null in the files of other objects
            column = column.cast(pa.list_(pa.float64()))
        columns[name] = column
    return pa.table(columns)


def _unify_columns(files: list[Path]) -> None:
    """Adds columns of nulls to each file for the columns that only others have."""
    schema = pa.unify_schemas([pq.read_schema(file) for file in files])
    for file in files:
        if pq.read_schema(file).names != schema.names:
            tables = [schema.empty_table(), pq.read_table(file)]
            pq.write_table(pa.concat_tables(tables, promote_options="default"), file)


def rows(values: np.ndarray, missing: np.ndarray | None = None) -> pa.Array:
    """Makes a list of n numbers per row of values (T, n); null where `missing` (T,)."""
    n = values.shape[1]
    if missing is None:
        return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).ravel()), n)
    # Arrow before version 26 cannot store nulls among lists of fixed size.
    ends = np.cumsum(np.where(missing, 0, n), dtype=np.int32)
    flat = pa.array(np.ascontiguousarray(values[~missing]).ravel())
    return pa.ListArray.from_arrays(pa.array(np.append(np.int32(0), ends)), flat, mask=pa.array(missing))

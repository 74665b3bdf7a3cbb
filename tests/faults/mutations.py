"""Sound files that are changed at random: a reader takes them or refuses them by name, and nothing else."""

import copy
import json
import pickle
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from glove_files import WRITERS, moving

from faults.child import run
from faults.sound import checkpoint
from geort_drake.errors import GeortError
from geort_drake.gloves.health import examine
from geort_drake.gloves.readers import open_recording
from geort_drake.retargeting.retargeter import load_retargeter

VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 3, 10**400, 1e308, float("nan"), float("inf"), "", "right", "\0", [], {}, [[]], [None],
    {"x": 1}, [1, 2, 3], {"position": None},
)  # fmt: skip
ARRAYS: tuple[Any, ...] = (
    np.zeros(0), np.zeros((0, 21, 3)), np.array("text"), np.array(7), np.zeros((3, 3), complex),
    np.full((4, 21, 3), np.nan), np.zeros((4, 21, 3), "f2"), np.zeros(5, "datetime64[s]"),
    np.ones((2, 25, 7)),
    np.array(b"bytes"), np.zeros(2, "i4,f8"), np.full((5, 26, 7), 1e300), np.zeros((1, 400)),
)  # fmt: skip


def mutate(path: Path, rng: np.random.Generator) -> None:
    """Changes a file: its bytes, or, half of the times where that can be, what is in it."""
    within = {".json": _mutate_json, ".npz": _mutate_arrays, ".npy": _mutate_array, ".pkl": _mutate_pickle}
    if path.suffix in within and rng.random() < 0.5:
        within[path.suffix](path, rng)
    else:
        path.write_bytes(mutated(path.read_bytes(), rng))


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes changed, left out, repeated or put in."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        # Half of the changes are in the first bytes, where headers are.
        end = len(data) if rng.random() < 0.5 else min(len(data), 256)
        at, length = (int(rng.integers(0, max(end, 1))), int(rng.choice([1, 2, 8, 100])))
        kind = rng.integers(0, 5)
        if kind == 0:
            data[at : at + length] = rng.bytes(length)
        elif kind == 1:
            del data[at : at + length]
        elif kind == 2:
            data[at:at] = data[at : at + length] * int(rng.integers(1, 50))
        elif kind == 3:
            data[at:at] = rng.choice([b"\xff" * 8, b"\0" * 8, b"[" * 2000, b"9" * 500, b"nan", b'"', b"\n"])
        else:
            del data[at:]
    return bytes(data)


def changed(value: Any, rng: np.random.Generator) -> Any:
    """The same lists and dicts with something else at one place."""
    value = copy.deepcopy(value)
    place = value
    while isinstance(place, list | dict) and place:
        key = (
            list(place)[rng.integers(0, len(place))]
            if isinstance(place, dict)
            else int(rng.integers(len(place)))
        )
        inner = place[key]
        if not isinstance(inner, list | dict) or not inner or rng.random() < 0.25:
            if rng.random() < 0.3:
                del place[key]
            else:
                place[key] = VALUES[rng.integers(0, len(VALUES))]
            break
        place = inner
    return value


def read(path: Path) -> None:
    """Reads a recording and examines it; what is taken must be one."""
    try:
        recording, _ = examine(open_recording(path)[0])
    except GeortError:
        return
    count = len(recording.t)
    if recording.p_HK.shape != (count, 21, 3) or recording.valid.shape != (count,):
        raise AssertionError(f"{path}: was read into arrays of wrong shapes")


def fuzz(count: int, seed: int, folder: Path) -> dict:
    """Changes sound files of every format, and checkpoints, `count` times in all, and reads them.

    Returns:
        files tried, and what failed: anything but a recording, a retargeter or an error of ours.
    """
    folder.mkdir(parents=True)
    ending = run(_fuzz, (count, seed, folder / "files"), folder, folder / "beside")
    if ending.code != 0:
        return {"files": count, "failures": [f"the process ended with {ending.code}: {ending.said[-1000:]}"]}
    return json.loads((folder / "files" / "result.json").read_text())


def _fuzz(count: int, seed: int, folder: Path) -> None:
    rng = np.random.default_rng(seed)
    hand, sound = moving(), {}
    for name, write in WRITERS.items():
        (folder / name).mkdir(parents=True)
        path = write(folder / name, hand)
        # Of HO-3D's folder of pickles, one.
        sound[name] = path if path.is_file() else sorted(path.iterdir())[3]
    (folder / "checkpoint").mkdir()
    stored = checkpoint(folder / "checkpoint")
    parts = [stored / name for name in ("weights.safetensors", "config.json", "hand.json")]
    names = [*sound, *(path.name for path in parts)]
    paths = [*sound.values(), *parts]
    contents = [path.read_bytes() for path in paths]
    tried: Counter[str] = Counter()
    failures = []
    for number in range(count):
        which = number % len(paths)
        path = paths[which]
        mutate(path, rng)
        try:
            if path in parts:
                _load(stored)
            else:
                read(path.parent if path.parent.name == "meta" else path)
        except Exception as error:
            failures.append(f"{names[which]}, file {number}: {type(error).__name__}: {error}")
        finally:
            path.write_bytes(contents[which])
        tried[names[which]] += 1
    result = {"files": count, "tried": dict(tried), "failures": failures}
    (folder / "result.json").write_text(json.dumps(result))


def _load(path: Path) -> None:
    try:
        q = load_retargeter(path)(np.zeros((21, 3)))
    except GeortError:
        return
    if not np.isfinite(q).all():
        raise AssertionError("a retargeter was loaded that gives what is not finite")


def _mutate_json(path: Path, rng: np.random.Generator) -> None:
    path.write_text(json.dumps(changed(json.loads(path.read_text()), rng)))


def _mutate_arrays(path: Path, rng: np.random.Generator) -> None:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    name = list(arrays)[rng.integers(0, len(arrays))]
    kind = rng.integers(0, 4)
    if kind == 0:
        del arrays[name]
    elif kind == 1 and arrays[name].ndim:
        arrays[name] = arrays[name][: int(rng.integers(0, 4))]
    elif kind == 2 and arrays[name].dtype.kind == "f":
        arrays[name] = arrays[name] * rng.choice([0.0, np.nan, -1.0, 1e30, 1e300])
    else:
        arrays[name] = ARRAYS[rng.integers(0, len(ARRAYS))]
    np.savez(path, **arrays)


def _mutate_array(path: Path, rng: np.random.Generator) -> None:
    np.save(path, ARRAYS[rng.integers(0, len(ARRAYS))])


def _mutate_pickle(path: Path, rng: np.random.Generator) -> None:
    contents = changed(pickle.loads(path.read_bytes()), rng)  # noqa: S301 (our own file)
    path.write_bytes(pickle.dumps(contents))

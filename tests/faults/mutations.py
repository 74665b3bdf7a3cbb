"""Valid inputs changed at random: a reader accepts them or refuses them with an error of ours."""

import copy
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from glove_files import read_contents, write_contents

from faults.child import run
from faults.readers import Reader, sound_inputs
from geort_drake.errors import GeortError

PARSED = (".json", ".jsonl", ".yaml", ".pkl")  # endings of files whose contents are changed
BATCH = 250  # inputs that a process reads before the next one takes over

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
    """Changes a file: its bytes, or half of the time its parsed contents, if its format is known."""
    if path.suffix in PARSED and rng.random() < 0.5:
        write_contents(path, changed(read_contents(path), rng))
    elif path.suffix in (".npz", ".npy") and rng.random() < 0.5:
        write_contents(path, changed_arrays(read_contents(path), rng))
    else:
        path.write_bytes(mutated(path.read_bytes(), rng))


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Returns the contents with some bytes changed, removed, repeated or inserted."""
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
    """Returns a copy of nested lists and dicts with one value changed or removed."""
    value = copy.deepcopy(value)
    place = value
    while isinstance(place, list | dict) and place:
        number = int(rng.integers(len(place)))
        key = list(place)[number] if isinstance(place, dict) else number
        inner = place[key]
        if not isinstance(inner, list | dict) or not inner or rng.random() < 0.25:
            if rng.random() < 0.3:
                del place[key]
            else:
                place[key] = VALUES[rng.integers(0, len(VALUES))]
            break
        place = inner
    return value


def changed_arrays(arrays: Any, rng: np.random.Generator) -> Any:
    """Returns other arrays of which one is removed, cut, scaled or replaced; another one for an array."""
    if isinstance(arrays, np.ndarray):
        return ARRAYS[rng.integers(0, len(ARRAYS))]
    name = list(arrays)[rng.integers(0, len(arrays))]
    array = arrays.pop(name)
    kind = rng.integers(0, 4)
    if kind == 1 and array.ndim:
        arrays[name] = array[: int(rng.integers(0, 4))]
    elif kind == 2 and array.dtype.kind == "f":
        arrays[name] = array * rng.choice([0.0, np.nan, -1.0, 1e30, 1e300])
    elif kind:
        arrays[name] = ARRAYS[rng.integers(0, len(ARRAYS))]
    return arrays


def fuzz(count: int, seed: int, folder: Path, report: Callable[[int, int], None] | None = None) -> dict:
    """Reads `count` changed inputs, evenly of every kind.

    Args:
        report: called with how many were read, and of how many.

    Returns:
        inputs, how many of each kind were tried, and the failures: other errors, files written, hangs and
        crashes.
    """
    inputs, beside = folder / "inputs", folder / "beside"
    inputs.mkdir(parents=True)
    readers = sound_inputs(inputs)
    tried: Counter[str] = Counter()
    failures: list[str] = []
    for start in range(0, count, BATCH):
        numbers = range(start, min(start + BATCH, count))
        sound = [reader.path.read_bytes() for reader in readers]
        ending = run(_fuzz, (readers, numbers, seed, folder), inputs, beside)
        number = int((folder / "number.txt").read_text())
        if ending.code != 0:
            failures.append(
                f"the process ended with {ending.code} at input {number}: {ending.output[-1000:]}"
            )
            for reader, content in zip(readers, sound, strict=True):
                reader.path.write_bytes(content)
        failures += (folder / "failures.txt").read_text().splitlines()
        tried += Counter(readers[n % len(readers)].name for n in range(start, number + 1))
        if report:
            report(numbers.stop, count)
    return {"inputs": tried.total(), "tried": dict(tried), "failures": failures}


def _fuzz(readers: list[Reader], numbers: range, seed: int, folder: Path) -> None:
    there = set(Path().rglob("*"))
    with open(folder / "number.txt", "w") as at, open(folder / "failures.txt", "w", buffering=1) as failures:
        for number in numbers:
            reader = readers[number % len(readers)]
            content = reader.path.read_bytes()
            # Each change is reproducible without those before it.
            mutate(reader.path, np.random.default_rng([seed, number]))
            os.pwrite(at.fileno(), str(number).encode(), 0)
            try:
                reader.read(reader.path)
            except GeortError:
                pass
            except Exception as error:
                wrong = f"{type(error).__name__}: {error!r:.300}"
                print(f"{reader.name}, input {number}: {wrong}", file=failures)
            finally:
                reader.path.write_bytes(content)
            if written := set(Path().rglob("*")) - there:
                print(f"{reader.name}, input {number}: wrote {sorted(map(str, written))}", file=failures)
                there |= written

"""Valid contents changed at random: bytes of a message, or the values in its fields."""

import copy
from typing import Any

import numpy as np

VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 3, 10**400, 1e308, float("nan"), float("inf"), "", "right", "\0", [], {}, [[]], [None],
    {"x": 1}, [1, 2, 3], {"position": None},
)  # fmt: skip
JUNK = b"\xff" * 8, b"\0" * 8, b"[" * 2000, b"9" * 500, b"nan", b'"', b"\n"


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Returns the contents with some parts replaced by noise, by nothing, by repetitions or by junk."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        # Half of the changes are in the first bytes, where headers are.
        end = len(data) if rng.random() < 0.5 else min(len(data), 256)
        at, length = int(rng.integers(0, max(end, 1))), int(rng.choice([0, 1, 2, 8, 100, len(data)]))
        part = bytes(data[at : at + length])
        changes = rng.bytes(length), b"", part * int(rng.integers(2, 50)), JUNK[rng.integers(len(JUNK))]
        data[at : at + length] = changes[rng.integers(len(changes))]
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

"""Hostile and damaged files in place of recordings, beside those in test_people_health.py."""

import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from glove_files import manus_table, write_manus, write_manus_csv, write_own
from moving_hands import moving

from faults.hostile import GIB, Calls, doubling, laughs, nested_key, npy_header, zip_bomb
from faults.refusals import Case

Maker = Callable[[Path], Path]  # writes a file into a folder


def holding(name: str, content: bytes) -> Maker:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


def own(**changes: object) -> Maker:
    """Our own format with other fields."""
    return lambda folder: write_own(folder, moving(), **changes)


def archive(members: Callable[[Path], dict[str, bytes]]) -> Maker:
    def make(folder: Path) -> Path:
        with zipfile.ZipFile(folder / "hand.npz", "w") as file:
            for name, content in members(folder).items():
                file.writestr(name, content)
        return folder / "hand.npz"

    return make


def spoiled(folder: Path) -> Path:
    """A sound archive with one byte changed."""
    path = write_manus(folder, moving())
    content = bytearray(path.read_bytes())
    content[int(0.3 * len(content))] ^= 0x55
    path.write_bytes(content)
    return path


def bomb(folder: Path) -> Path:
    shape = (10 * GIB // 504 - 1, 21, 3)
    return zip_bomb(folder / "bomb.npz", "world_landmarks.npy", npy_header(shape), 10 * GIB)


def climbing(folder: Path) -> dict[str, bytes]:
    """Members whose names lead out of any folder that they might be unpacked to."""
    names = ("../../climbed.npy", str(folder.absolute() / "climbed.npy"), "..\\climbed.npy")
    return dict.fromkeys(names, npy_header((2, 21, 3)) + bytes(2 * 504))


def objects(folder: Path) -> Path:
    """An .npy of Python objects: a pickle behind NumPy's header."""
    np.save(folder / "hand.npy", np.array([HARM], dtype=object), allow_pickle=True)
    return folder / "hand.npy"


def pipe(folder: Path) -> Path:
    """A file that whoever opens it waits for."""
    os.mkfifo(folder / "hand.npz")
    return folder / "hand.npz"


def sparse(folder: Path) -> Path:
    """A file of 40 GiB that takes no place on the disk."""
    with (folder / "hand.json").open("wb") as file:
        file.truncate(40 * GIB)
    return folder / "hand.json"


def odd_name(folder: Path) -> Path:
    """A name that is no UTF-8, of a file that is no recording."""
    path = Path(os.fsdecode(os.fsencode(folder) + b"/hand\xff\xfe.npz"))
    path.write_bytes(b"no archive")
    return path


def twice(folder: Path) -> Path:
    """A CSV that has a column twice, with different numbers."""
    return write_manus_csv(folder, moving(), [[*row, row[3]] for row in manus_table(moving())])


HARM = Calls(os.system, "touch harm")
HARMFUL = pickle.dumps(HARM)
ATTRIBUTE = b"\x80\x04\x8c\x16numpy._core.multiarray\x8c\x15_reconstruct.__self__\x93."
HUGE = npy_header((10**12, 21, 3)) + bytes(504)
PICKLE, NUMPY, UNKNOWN = "could run code|not a readable pickle", "not a readable NumPy", "matches no known"
NEGATIVE = npy_header((-4, 21, 3)) + bytes(504)

_MAKERS: dict[str, tuple[Maker, str]] = {
    "empty archive": (holding("hand.npz", b""), NUMPY),
    "archive with one byte changed": (spoiled, NUMPY),
    "archive that unpacks to 10 GiB": (bomb, "10.0 GiB.* 2 GiB"),
    "archive that promises 10¹² frames": (archive(lambda _: {"world_landmarks.npy": HUGE}), NUMPY),
    "archive that names files outside": (archive(climbing), UNKNOWN),
    "archive of torch": (
        archive(lambda _: {"archive/data.pkl": HARMFUL, "archive/version": b"3\n"}),
        UNKNOWN,
    ),
    ".npy of objects": (objects, "holds pickled objects, which are never read"),
    ".npy with a shape below zero": (holding("hand.npy", NEGATIVE), f"{NUMPY}|must hold|at least 2 frames"),
    ".npy that is a pickle": (holding("hand.npy", HARMFUL), NUMPY),
    ".json that is a pickle": (holding("hand.json", HARMFUL), "not a text file in UTF-8|not JSON"),
    "pickle that calls the shell": (holding("hand.pkl", HARMFUL), r"names \w+\.system, which could run code"),
    "pickle that reaches through an attribute": (holding("hand.pkl", ATTRIBUTE), r"_reconstruct\.__self__"),
    "pickle with a foreign reference": (holding("hand.pkl", b"\x80\x04K\x01Q."), "persistent id 1"),
    "pickle that doubles itself": (holding("hand.pkl", doubling(40)), PICKLE),
    "pickle with a key 100,000 deep": (holding("hand.pkl", nested_key(100_000)), UNKNOWN),
    "pickle of a list of lists of lists": (holding("hand.pkl", laughs(20)), UNKNOWN),
    "pickle of 10¹³ numbers": (holding("hand.pkl", pickle.dumps(Calls(np.ndarray, (10**13,)))), PICKLE),
    "JSON 100,000 deep": (holding("hand.json", b"[" * 100_000), "not JSON: maximum recursion depth"),
    "JSON lines, one 100,000 deep": (holding("hand.jsonl", b'{"a": 1}\n' + b"[" * 100_000), UNKNOWN),
    "JSON of 40 GiB": (sparse, "40.0 GiB.* 2 GiB"),
    "table with a column twice": (twice, "has the column Hand_X more than once"),
    "own, of objects nested in its metadata": (own(metadata=np.array("[" * 50_000)), "metadata is not JSON"),
    "own, its keypoints complex": (own(p_HK=np.zeros((400, 21, 3), complex)), "p_HK must hold numbers"),
    "own, its wrist not finite": (own(X_WH=np.full((400, 7), np.nan)), "400 of 400 frames are not finite"),
    "a pipe": (pipe, "no such file"),
    "a name that is no UTF-8": (odd_name, NUMPY),
    "a name without a suffix": (holding("hand", b"x"), "recordings are read from"),
}


def _case(name: str, make: Maker, says: str) -> Case:
    return Case(
        "recording", name, lambda folder: ("convert", make(folder), "out.npz"), "RecordingError", says
    )


CASES = [_case(name, make, says) for name, (make, says) in _MAKERS.items()]

"""Recordings of hands that no reader may take, beside those in test_people_health.py."""

import csv
import io
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from glove_files import (
    manus_table,
    write_manus,
    write_manus_csv,
    write_openxr,
    write_own,
)
from moving_hands import moving

from faults.hostile import GIB, Calls, doubling, laughs, nested_key, npy_header, zip_bomb
from faults.refusals import Case


def with_bytes(name: str, content: bytes) -> Callable[[Path], tuple]:
    """Imports a file of that content."""

    def make(folder: Path) -> tuple:
        (folder / name).write_bytes(content)
        return imports(folder / name)

    return make


def imports(path: Path) -> tuple:
    return "convert", path, "out.npz"


def npz(**arrays: object) -> Callable[[Path], tuple]:
    def make(folder: Path) -> tuple:
        np.savez(folder / "hand.npz", **arrays)
        return imports(folder / "hand.npz")

    return make


def own(**changes: object) -> Callable[[Path], tuple]:
    """Our own format with other fields."""
    return lambda folder: imports(write_own(folder, moving(), **changes))


def spoiled(folder: Path, at: float) -> tuple:
    """A sound archive with one byte changed there."""
    path = write_manus(folder, moving())
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 0x55
    path.write_bytes(content)
    return imports(path)


def bomb(folder: Path) -> tuple:
    shape = (10 * GIB // 504 - 1, 21, 3)
    return imports(zip_bomb(folder / "bomb.npz", "world_landmarks.npy", npy_header(shape), 10 * GIB))


def bomb_of_bytes(folder: Path) -> tuple:
    return imports(zip_bomb(folder / "bomb.npz", "readme.txt", b"", 10 * GIB))


def promised(folder: Path) -> tuple:
    """A small archive whose array says that it has a million million frames."""
    with zipfile.ZipFile(folder / "hand.npz", "w") as file:
        file.writestr("world_landmarks.npy", npy_header((10**12, 21, 3)) + bytes(504))
    return imports(folder / "hand.npz")


def climbing(folder: Path) -> tuple:
    """Members whose names lead out of any folder that they might be unpacked to."""
    array = npy_header((2, 21, 3)) + bytes(2 * 504)
    with zipfile.ZipFile(folder / "hand.npz", "w") as file:
        for name in ("../../climbed.npy", str(folder.absolute() / "climbed.npy"), "..\\climbed.npy"):
            file.writestr(name, array)
    return imports(folder / "hand.npz")


def climbing_symlink(folder: Path) -> tuple:
    """A member that is a symbolic link to a file outside."""
    info = zipfile.ZipInfo("p_HK.npy")
    info.external_attr = 0o120777 << 16
    with zipfile.ZipFile(folder / "hand.npz", "w") as file:
        file.writestr(info, "../../../etc/passwd")
    return imports(folder / "hand.npz")


def torch_archive(folder: Path) -> tuple:
    """What torch.save writes: a zip archive with a pickle in it."""
    with zipfile.ZipFile(folder / "hand.npz", "w") as file:
        file.writestr("archive/data.pkl", pickle.dumps(Calls(os.system, "touch harm")))
        file.writestr("archive/version", "3\n")
    return imports(folder / "hand.npz")


def locked(folder: Path) -> tuple:
    """An archive whose member is marked as encrypted."""
    path = write_openxr(folder, moving())
    content = bytearray(path.read_bytes())
    for mark, flags in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        at = content.find(mark)
        while at >= 0:
            content[at + flags] |= 1
            at = content.find(mark, at + 4)
    path.write_bytes(content)
    return imports(path)


def objects(folder: Path) -> tuple:
    """An .npy of Python objects: a pickle behind NumPy's header."""
    harm = np.array([Calls(os.system, "touch harm")], dtype=object)
    np.save(folder / "hand.npy", harm, allow_pickle=True)
    return imports(folder / "hand.npy")


def pipe(folder: Path) -> tuple:
    """A file that whoever opens it waits for."""
    os.mkfifo(folder / "hand.npz")
    return imports(folder / "hand.npz")


def loop(folder: Path) -> tuple:
    (folder / "hand.npz").symlink_to(folder / "hand.npz")
    return imports(folder / "hand.npz")


def sparse(folder: Path) -> tuple:
    """A file of 40 GiB that takes no place on the disk."""
    with (folder / "hand.json").open("wb") as file:
        file.truncate(40 * GIB)
    return imports(folder / "hand.json")


def odd_name(folder: Path) -> tuple:
    """A name that is no UTF-8, of a file that is no recording."""
    path = os.fsencode(folder) + b"/hand\xff\xfe.npz"
    Path(os.fsdecode(path)).write_bytes(b"no archive")
    return imports(Path(os.fsdecode(path)))


def twice(folder: Path) -> tuple:
    """A CSV that has a column twice, with different numbers."""
    table = [[*row, row[3]] for row in manus_table(moving())]
    return imports(write_manus_csv(folder, moving(), table))


def utf16(folder: Path) -> tuple:
    buffer = io.StringIO()
    csv.writer(buffer).writerows(manus_table(moving()))
    return with_bytes("hand.csv", buffer.getvalue().encode("utf-16"))(folder)


def lost_pose(quaternion: list[float]) -> Callable[[Path], tuple]:
    """Our own format with a wrist pose that is none."""
    pose = np.tile([*quaternion, 0.0, 0.0, 0.0], (len(moving().t), 1))
    return own(X_WH=pose)


PICKLE, NUMPY = "could run code|not a readable pickle", "not a readable NumPy file"

_MAKERS: dict[str, tuple[Callable[[Path], tuple], str]] = {
    "empty archive": (with_bytes("hand.npz", b""), NUMPY),
    "archive with one byte changed": (lambda f: spoiled(f, 0.3), NUMPY),
    "archive with its directory changed": (
        lambda f: spoiled(f, 0.9995),
        f"{NUMPY}|matches no known format|lacks",
    ),
    "archive that is encrypted": (locked, NUMPY),
    "archive that unpacks to 10 GiB of array": (bomb, "holds 10.0 GiB; the limit is 2 GiB"),
    "archive that unpacks to 10 GiB of bytes": (bomb_of_bytes, "holds 10.0 GiB; the limit is 2 GiB"),
    "archive that promises 10¹² frames": (promised, NUMPY),
    "archive that names files outside": (climbing, "matches no known format"),
    "archive with a link to a file outside": (climbing_symlink, "matches no known format"),
    "archive of torch, a pickle inside": (torch_archive, "matches no known format"),
    ".npy that promises 10¹² frames": (
        with_bytes("hand.npy", npy_header((10**12, 21, 3)) + bytes(504)),
        NUMPY,
    ),
    ".npy of objects": (objects, "holds pickled objects, which are never read"),
    ".npy with a shape below zero": (
        with_bytes("hand.npy", npy_header((-4, 21, 3)) + bytes(504)),
        f"{NUMPY}|must hold numbers|at least 2 frames",
    ),
    ".npy of records": (
        with_bytes("hand.npy", npy_header((2,), [("a", "<f8"), ("b", "<f8")]) + bytes(32)),
        "must hold numbers of shape",
    ),
    ".npy that is a pickle": (with_bytes("hand.npy", pickle.dumps(Calls(os.system, "touch harm"))), NUMPY),
    ".json that is a pickle": (
        with_bytes("hand.json", pickle.dumps(Calls(os.system, "touch harm"))),
        "not a text file in UTF-8|not JSON",
    ),
    ".csv that is a pickle": (
        with_bytes("hand.csv", pickle.dumps(Calls(os.system, "touch harm"))),
        "not a text file in UTF-8",
    ),
    "pickle that calls the shell": (
        with_bytes("hand.pkl", pickle.dumps([Calls(os.system, "touch harm")])),
        r"names \w+\.system, which could run code",
    ),
    "pickle that evaluates text": (
        with_bytes("hand.pkl", pickle.dumps([Calls(eval, "open('harm', 'w')")])),
        r"names builtins\.eval, which could run code",
    ),
    "pickle that loads another file": (
        with_bytes("hand.pkl", pickle.dumps([Calls(np.load, "hand.npy", None, True)])),
        r"names numpy\.load, which could run code",
    ),
    "pickle that reaches through an attribute": (
        with_bytes(
            "hand.pkl",
            b"\x80\x04\x8c\x16numpy._core.multiarray\x8c\x15_reconstruct.__self__\x93.",
        ),
        r"names numpy\._core\.multiarray\._reconstruct\.__self__",
    ),
    "pickle with a foreign reference": (with_bytes("hand.pkl", b"\x80\x04K\x01Q."), "persistent id 1"),
    "pickle that doubles itself": (with_bytes("hand.pkl", doubling(40)), PICKLE),
    "pickle with a key 100,000 deep": (
        with_bytes("hand.pkl", nested_key(100_000)),
        "matches no known format",
    ),
    "pickle of a list of lists of lists": (with_bytes("hand.pkl", laughs(20)), "matches no known format"),
    "pickle of an array of 10¹³ numbers": (
        with_bytes("hand.pkl", pickle.dumps([Calls(np.ndarray, (10**13,))])),
        PICKLE,
    ),
    "pickle that ends too soon": (with_bytes("hand.pkl", pickle.dumps([1, 2, 3])[:-4]), PICKLE),
    "JSON 100,000 deep": (with_bytes("hand.json", b"[" * 100_000), "not JSON: maximum recursion depth"),
    "JSON lines, one 100,000 deep": (
        with_bytes("hand.jsonl", b'{"a": 1}\n' + b"[" * 100_000 + b"\n"),
        "matches no known format",
    ),
    "JSON with a number of 10,000 digits": (with_bytes("hand.json", b"[" + b"9" * 10_000 + b"]"), "not JSON"),
    "JSON of 40 GiB": (sparse, "holds 40.0 GiB; the limit is 2 GiB"),
    "JSON lines of numbers": (with_bytes("hand.jsonl", b"1\n2\n"), "matches no known format"),
    "table with a column twice": (twice, "has the column Hand_X more than once"),
    "table in UTF-16": (utf16, "not a text file in UTF-8"),
    "own, of objects nested in its metadata": (
        own(metadata=np.array("[" * 50_000)),
        "metadata is not JSON",
    ),
    "own, its metadata a number": (own(metadata=np.array(7)), "metadata must name a side"),
    "own, its keypoints complex": (own(p_HK=np.zeros((400, 21, 3), complex)), "p_HK must hold numbers"),
    "own, its wrist without rotation": (
        lost_pose([0.0] * 4),
        "400 of 400 .* without a unit quaternion",
    ),
    "own, its wrist not finite": (lost_pose([np.nan] * 4), "400 of 400 frames are not finite numbers"),
    "MANUS, its times texts": (
        lambda f: imports(write_manus(f, moving(), timestamps=np.full(400, "now"))),
        "timestamps must hold numbers",
    ),
    "a pipe": (pipe, "no such file"),
    "a link to itself": (loop, "no such file|Too many levels"),
    "a name that is no UTF-8": (odd_name, NUMPY),
    "a name without a suffix": (with_bytes("hand", b"x"), "recordings are read from"),
}

CASES = [Case("recording", name, make, "RecordingError", says) for name, (make, says) in _MAKERS.items()]

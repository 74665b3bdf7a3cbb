"""Inputs made to harm whoever reads them: bombs, endless files, code in data, paths that lead elsewhere."""

import dataclasses as dc
import hashlib
import io
import json
import os
import pickle
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from faults.child import run
from faults.sound import map_file, play
from geort_drake import load_retargeter
from geort_drake.cli import run_command
from geort_drake.resources import models_dir

GIB = 1 << 30
DEEP = b"[" * 100_000
Make = Callable[[Path], tuple]


@dc.dataclass(frozen=True)
class Case:
    """An input that must be refused.

    Attributes:
        kind: recording, map, scenario or hand.
        name: what is wrong with it.
        make: writes the input into a folder and returns a command and its arguments, or a function and its
            arguments.
        error: class name of the expected error.
        message: pattern that the message must match.
    """

    kind: str
    name: str
    make: Callable[[Path], tuple]
    error: str
    message: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.name}"


def faults_of(case: Case, folder: Path) -> list[str]:
    """Runs a case in an empty folder and returns what is wrong with its refusal.

    Expected are the named error, exit code 2, the message without a traceback, an end in time and within the
    memory, and no file written.
    """
    room = folder / "room"
    room.mkdir(parents=True)
    command, *arguments = case.make(room)
    before = contents(room)
    if isinstance(command, str):
        command, arguments = run_command, [command, [str(word) for word in arguments]]
    ending = run(command, tuple(arguments), room, folder / "beside")
    checks = {
        f"hung for {ending.seconds:.0f} s": ending.code is None,
        f"exit code {ending.code}": ending.code not in (2, None),
        f"error {ending.error or 'none'}, not {case.error}": case.error != ending.error,
        f"does not match {case.message!r}": not re.search(case.message, ending.output, re.DOTALL),
        "a traceback": "Traceback" in ending.output,
        "a file was written": contents(room) != before,
    }
    wrong = [text for text, failed in checks.items() if failed]
    return [*wrong, ending.output[-2000:]] if wrong else []


def contents(folder: Path) -> dict[str, str]:
    """Returns every path below a folder with its mode, and for regular files the digest of their contents."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        found[str(path.relative_to(folder))] = stat.filemode(status.st_mode)
        if stat.S_ISREG(status.st_mode) and status.st_size < 1 << 28:
            found[str(path.relative_to(folder))] += hashlib.sha256(path.read_bytes()).hexdigest()
    return found


class Calls:
    """Pickled, it asks for a call of a function, and gives its result a state."""

    def __init__(self, function: Callable, *arguments: object, state: object = None):
        self.call = (function, arguments, state)

    def __reduce__(self) -> tuple:
        return self.call


SHELL = Calls(os.system, "touch harm")


def recording(name: str, write: bytes | Callable[[Path], object]) -> Make:
    """Converts a file with that content, or what a function makes of its path."""

    def make(folder: Path) -> tuple:
        path = folder / name
        path.write_bytes(write) if isinstance(write, bytes) else write(path)
        return "recording convert", path, "--output", "out.npz"

    return make


def npy_header(shape: tuple[int, ...]) -> bytes:
    """Returns the beginning of an .npy file of that shape."""
    buffer = io.BytesIO()
    np.lib.format.write_array_header_2_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return buffer.getvalue()


def zip_bomb(path: Path) -> None:
    """Writes a small archive with an array that unpacks to 10 GiB."""
    head, zeros, name = npy_header((10 * GIB // 504 - 1, 21, 3)), 10 * GIB, b"world_landmarks.npy"
    block = 1 << 26
    start, middle, end = (zlib.compressobj(9, zlib.DEFLATED, -15) for _ in range(3))
    data = start.compress(head) + start.flush(zlib.Z_FULL_FLUSH)
    # A block that ends with a full flush does not depend on those before it, so it can be repeated.
    data += (middle.compress(bytes(block)) + middle.flush(zlib.Z_FULL_FLUSH)) * (zeros // block) + end.flush()
    sizes = struct.pack("<LLL", 0, 0xFFFFFFFF, 0xFFFFFFFF)
    extra = struct.pack("<HHQQ", 1, 16, zeros + len(head), len(data))
    times = struct.pack("<HHHHH", 45, 0, 8, 0, 33)
    local = b"PK\3\4" + times + sizes + struct.pack("<HH", len(name), len(extra)) + name + extra
    fields = struct.pack("<HHHHHLL", len(name), len(extra), 0, 0, 0, 0, 0)
    central = b"PK\1\2" + struct.pack("<H", 45) + times + sizes + fields + name + extra
    place = struct.pack("<HHHHLLH", 0, 0, 1, 1, len(central), len(local) + len(data), 0)
    path.write_bytes(local + data + central + b"PK\5\6" + place)


def archive(members: dict[str, bytes]) -> Callable[[Path], None]:
    """Writes an archive with these members."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as file:
            for name, content in members.items():
                file.writestr(name, content)

    return write


def sparse(path: Path) -> None:
    """Makes a file grow to 40 GiB that take no space on the disk."""
    with path.open("ab") as file:
        file.truncate(40 * GIB)


PROMISE = npy_header((10**12, 21, 3)) + bytes(504)
OUTSIDE = npy_header((2, 21, 3)) + bytes(2 * 504)
TOO_LARGE = r"has \d+\.0 GiB; the limit is 2 GiB"

RECORDINGS: dict[str, tuple[Make, str]] = {
    "an archive that unpacks to 10 GiB": (recording("bomb.npz", zip_bomb), TOO_LARGE),
    "an archive that promises 10¹² frames": (
        recording("hand.npz", archive({"world_landmarks.npy": PROMISE})),
        "not a readable NumPy file",
    ),
    "an archive that names files outside": (
        recording("hand.npz", archive({"../../climbed.npy": OUTSIDE, "/climbed.npy": OUTSIDE})),
        "matches no known format",
    ),
    "an .npy of pickled objects": (
        recording("hand.npy", lambda path: np.save(path, np.array([SHELL], object), allow_pickle=True)),
        "pickled objects",
    ),
    "a pickle that calls the shell": (recording("hand.pkl", pickle.dumps([SHELL])), r"not '\.pkl'"),
    "JSON 100,000 deep": (recording("hand.json", DEEP), "not JSON: maximum recursion depth"),
    "JSON of 40 GiB": (recording("hand.json", sparse), TOO_LARGE),
    "a pipe": (recording("hand.npz", os.mkfifo), "is no file"),
    "a link to itself": (
        recording("hand.npz", lambda path: path.symlink_to(path)),
        "no such file|Too many levels",
    ),
}


def map_after(change: Callable[[Path], object]) -> Make:
    """Loads a map after a change of its file."""

    def make(folder: Path) -> tuple:
        path = map_file(folder)
        change(path)
        return load_retargeter, path

    return make


def weights(**arrays: np.ndarray) -> Make:
    def change(path: Path) -> None:
        with safe_open(path, "numpy") as file:
            header = file.metadata()
        save_file(load_file(path) | arrays, path, header)

    return map_after(change)


def header(**fields: object) -> Make:
    def change(path: Path) -> None:
        with safe_open(path, "numpy") as file:
            stored = json.loads(file.metadata()["geort_drake"])
        save_file(load_file(path), path, {"geort_drake": json.dumps(stored | fields)})

    return map_after(change)


def replaced_by_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


MAPS: dict[str, tuple[Make, str]] = {
    "weights that are a pickle": (
        map_after(lambda path: path.write_bytes(pickle.dumps(SHELL))),
        "not a safetensors file",
    ),
    "weights with an endless header": (
        map_after(lambda path: path.write_bytes(struct.pack("<Q", 1 << 60) + b"{}")),
        "not a safetensors file",
    ),
    "weights of 40 GiB": (map_after(sparse), "not a safetensors file"),
    "weights that are not finite": (weights(weight1=np.full((4, 8, 8), np.nan)), "'weight1' must be finite"),
    "weights whose products overflow": (
        weights(weight1=np.full((4, 8, 8), 1e200)),
        "'weight1' must be finite",
    ),
    "limits whose difference overflows": (
        header(lower=[-1.7e308] * 16, upper=[1.7e308] * 16),
        r"lower of 'joint_12' must be below upper",
    ),
    "limits that are texts": (header(lower=["a"] * 16), "lower must be 16 finite numbers"),
    "keypoints that no hand has": (header(human_keypoints=[4, 8, 12, 21]), "numbers from 0 to 20"),
    "another kind": (header(kind="pickle"), "kind must be one of"),
    "columns out of range": (weights(columns=np.arange(16) + 1), "columns must be"),
    "a pipe": (map_after(replaced_by_pipe), "no such map"),
}


ENTITIES = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10 if n else "laugh"}">' for n in range(10))


def hand(text: str) -> Make:
    """Trains for a hand with a description of that text."""

    def make(folder: Path) -> tuple:
        path = folder / "hand.yaml"
        path.write_text(text)
        return "train", "--hand", path, "--set", "robot_samples=10", "--output", "out.safetensors", "--quiet"

    return make


def hand_with_model(model: str, text: str = "") -> Make:
    """The Allegro hand with another model, a file of that text if one is given."""

    def make(folder: Path) -> tuple:
        if text:
            (folder / model).write_text(text, encoding="utf-8")
        facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text(encoding="utf-8"))
        return hand(yaml.safe_dump(facts | {"model": model}))(folder)

    return make


def sdf_with_entities(entities: str, use: str) -> Make:
    text = f"<?xml version='1.0'?><!DOCTYPE sdf [{entities}]><sdf version='1.7'>{use}</sdf>"
    return hand_with_model("hand.sdf", text)


UNREADABLE = "not a single readable model|not XML"

HANDS: dict[str, tuple[Make, str]] = {
    "a tag that runs code": (hand("!!python/object/apply:os.system ['touch harm']"), "is malformed"),
    "an alias of itself": (hand("fingers: &a [*a]"), "is malformed"),
    "a model elsewhere": (hand_with_model("package://geort_drake/../../../../../../etc/passwd"), "passwd"),
    "SDF with entities of entities": (sdf_with_entities(ENTITIES, "&a9;"), UNREADABLE),
    "SDF that reads another file": (
        sdf_with_entities("<!ENTITY a SYSTEM 'file:///etc/passwd'>", "&a;"),
        UNREADABLE,
    ),
}


def scenario(text: str) -> Make:
    """Simulates a scenario file of that text."""

    def make(folder: Path) -> tuple:
        path = folder / "bad.scenarios.yaml"
        path.write_bytes(text.encode())
        play().save(folder / "hand.npz")
        options = "--recording", "hand.npz", "--output", "out"
        return "grasp", "--scenario-file", path, "--scenario-name", "Grasp", *options

    return make


ALIASES = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))
MODEL = "Grasp: {{directives: [{{add_model: {{name: arm, file: '{}'}}}}]}}"

SCENARIOS: dict[str, tuple[Make, str]] = {
    "a tag that runs code": (scenario("Grasp: !!python/object/apply:os.system ['touch harm']"), "Grasp|tag"),
    "aliases of aliases, 10⁹ in all": (
        scenario(f"{ALIASES}Grasp: {{arm_posture: *a9}}"),
        "arm_posture|Grasp|alias",
    ),
    "a model elsewhere": (scenario(MODEL.format("package://geort_drake/../../../etc/passwd")), "directives"),
    "a model by the network": (scenario(MODEL.format("https://example.org/arm.sdf")), "directives"),
}


CASES = [
    *(Case("recording", name, make, "RecordingError", text) for name, (make, text) in RECORDINGS.items()),
    *(Case("map", name, make, "MapError", text) for name, (make, text) in MAPS.items()),
    *(Case("hand", name, make, "HandError", text) for name, (make, text) in HANDS.items()),
    *(Case("scenario", name, make, "ScenarioError", text) for name, (make, text) in SCENARIOS.items()),
]

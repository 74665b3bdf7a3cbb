"""Files made to harm whoever reads them: bombs, endless files, code in data, paths that lead elsewhere."""

import json
import os
import pickle
import resource
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from faults.sound import map_file
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from geort_drake import Hand, load_retargeter, load_scenario, read_recording
from geort_drake.errors import HandError, MapError, RecordingError, ScenarioError
from geort_drake.resources import models_dir
from geort_drake.simulation.following import robot_model

GIB = 1 << 30
MEMORY = 2 * GIB  # bytes that a reader may ask for


@pytest.fixture(autouse=True)
def bounds(tmp_path, monkeypatch):
    """Bounds the memory, makes an empty folder the current one, and checks that nothing appears in it."""
    room = tmp_path / "room"
    room.mkdir()
    monkeypatch.chdir(room)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    assert not list(room.iterdir()), "the file wrote something"


pytestmark = pytest.mark.timeout(120)  # s; a reader that takes more hangs


class Call:
    """Pickled, it asks for a call of the shell."""

    def __reduce__(self) -> tuple:
        return os.system, ("touch harm",)


def npy(shape: tuple[int, ...], data: bytes = bytes(504)) -> bytes:
    """An .npy file of float64 that states a shape, whatever data follow."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def archive(**members: bytes) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as file:
            for name, content in members.items():
                file.writestr(name, content)

    return write


def bomb(path: Path) -> None:
    """A small archive with an array that unpacks to 40 GiB, by what archive and array say."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("world_landmarks.npy", npy((40 * GIB // 504, 21, 3), bytes(1 << 20)))
        file.infolist()[0].file_size = 40 * GIB


def grow(path: Path) -> None:
    """Makes a file grow to 40 GiB that take no space on the disk."""
    with path.open("ab") as file:
        file.truncate(40 * GIB)


def replace_by_pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


TOO_LARGE = r"has \d+\.0 GiB; the limit is 2 GiB"
OUTSIDE = {"../../climbed.npy": npy((1, 21, 3)), "/climbed.npy": npy((1, 21, 3))}
RECORDINGS = {
    "an archive that unpacks to 40 GiB": ("npz", bomb, TOO_LARGE),
    "an archive that promises 10¹² frames": (
        "npz",
        archive(**{"world_landmarks.npy": npy((10**12, 21, 3))}),
        "not a readable NumPy file",
    ),
    "an archive that names files outside": ("npz", archive(**OUTSIDE), "matches no known format"),
    "pickled objects in an .npy": (
        "npy",
        lambda path: np.save(path, np.array([Call()], object), allow_pickle=True),
        "pickled objects",
    ),
    "a pickle": ("pkl", lambda path: path.write_bytes(pickle.dumps(Call())), r"not '\.pkl'"),
    "JSON 100,000 deep": (
        "json",
        lambda path: path.write_bytes(b"[" * 100_000),
        "not JSON: maximum recursion depth",
    ),
    "JSON of 40 GiB": ("json", grow, TOO_LARGE),
    "a pipe": ("npz", replace_by_pipe, "is no file"),
    "a link to itself": ("npz", lambda path: path.symlink_to(path), "no such file|Too many levels"),
}


@pytest.mark.parametrize("fault", RECORDINGS)
def test_a_hostile_recording_is_refused(fault, tmp_path):
    suffix, write, message = RECORDINGS[fault]
    path = tmp_path / f"hand.{suffix}"
    write(path)
    with pytest.raises(RecordingError, match=message):
        read_recording(path)


def with_arrays(**arrays: np.ndarray) -> Callable[[Path], None]:
    """Replaces arrays of a map's file."""

    def change(path: Path) -> None:
        with safe_open(path, "numpy") as file:
            header = file.metadata()
        save_file(load_file(path) | arrays, path, header)

    return change


def with_fields(**fields: object) -> Callable[[Path], None]:
    """Replaces fields of the header of a map's file."""

    def change(path: Path) -> None:
        with safe_open(path, "numpy") as file:
            stored = json.loads(file.metadata()["geort_drake"])
        save_file(load_file(path), path, {"geort_drake": json.dumps(stored | fields)})

    return change


ENDLESS = struct.pack("<Q", 1 << 60) + b"{}"
MAPS = {
    "a pickle": (lambda path: path.write_bytes(pickle.dumps(Call())), "not a safetensors file"),
    "an endless header": (lambda path: path.write_bytes(ENDLESS), "not a safetensors file"),
    "40 GiB": (grow, "not a safetensors file"),
    "weights that are not finite": (
        with_arrays(weight1=np.full((4, 8, 8), np.nan)),
        "'weight1' must be finite",
    ),
    "weights whose products overflow": (
        with_arrays(weight1=np.full((4, 8, 8), 1e200)),
        "'weight1' must be finite",
    ),
    "limits whose difference overflows": (
        with_fields(lower=[-1.7e308] * 16, upper=[1.7e308] * 16),
        "lower of 'joint_12' must be below upper",
    ),
    "limits that are texts": (with_fields(lower=["a"] * 16), "lower must be 16 finite numbers"),
    "keypoints that no hand has": (with_fields(human_keypoints=[4, 8, 12, 21]), "numbers from 0 to 20"),
    "another kind": (with_fields(kind="pickle"), "kind must be one of"),
    "columns out of range": (with_arrays(columns=np.arange(16) + 1), "columns must be"),
    "a pipe": (replace_by_pipe, "no such map"),
}


@pytest.mark.parametrize("fault", MAPS)
def test_a_hostile_map_is_refused(fault, tmp_path):
    change, message = MAPS[fault]
    path = map_file(tmp_path)
    change(path)
    with pytest.raises(MapError, match=message):
        load_retargeter(path)


ENTITIES = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10 if n else "laugh"}">' for n in range(10))
UNREADABLE = "not a single readable model|not XML"
MODELS = {
    "another place": ("package://geort_drake/../../../../../../etc/passwd", "", "passwd"),
    "entities of entities": (
        "hand.sdf",
        f"<!DOCTYPE sdf [{ENTITIES}]><sdf version='1.7'>&a9;</sdf>",
        UNREADABLE,
    ),
    "another file as an entity": (
        "hand.sdf",
        "<!DOCTYPE sdf [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><sdf version='1.7'>&a;</sdf>",
        UNREADABLE,
    ),
}


@pytest.mark.parametrize("fault", MODELS)
def test_a_hostile_model_of_a_hand_is_refused(fault, tmp_path):
    model, text, message = MODELS[fault]
    (tmp_path / "hand.sdf").write_text(text)
    facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text(encoding="utf-8"))
    (tmp_path / "hand.yaml").write_text(yaml.safe_dump(facts | {"model": model}))
    with pytest.raises(HandError, match=message):
        Hand(tmp_path / "hand.yaml")


CODE = "!!python/object/apply:os.system ['touch harm']"


@pytest.mark.parametrize("text", [CODE, "fingers: &a [*a]"])
def test_a_hostile_description_of_a_hand_is_refused(text, tmp_path):
    """Code, and an alias of itself."""
    (tmp_path / "hand.yaml").write_text(text)
    with pytest.raises(HandError, match="is malformed"):
        Hand(tmp_path / "hand.yaml")


ALIASES = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))
MODEL = "Grasp: {{directives: [{{add_model: {{name: arm, file: '{}'}}}}]}}"
SCENARIOS = {
    "code": (f"Grasp: {CODE}", "Grasp|tag"),
    "aliases of aliases, 10⁹ in all": (f"{ALIASES}Grasp: {{arm_posture: *a9}}", "arm_posture|Grasp|alias"),
    "a model in another place": (MODEL.format("package://geort_drake/../../../etc/passwd"), "directives"),
    "a model from the network": (MODEL.format("https://example.org/arm.sdf"), "directives"),
}


@pytest.mark.parametrize("fault", SCENARIOS)
def test_a_hostile_scenario_is_refused(fault, allegro, tmp_path):
    text, message = SCENARIOS[fault]
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ScenarioError, match=message):
        robot_model(load_scenario(tmp_path / "bad.yaml", "Grasp"), allegro.description)

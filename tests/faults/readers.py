"""Every reader of input from users, gloves and robots, with a valid input for each."""

import dataclasses as dc
import functools
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from glove_files import WRITERS, moving
from hand_family import HandSpec, write_hand
from live_messages import manus_glove, manus_words, nodes_of, own_fields

from faults.sound import map_file
from geort_drake import HandModel, load_retargeter, load_scenario, read_recording
from geort_drake.hands.description import write_description
from geort_drake.hands.importers.proposal import propose
from geort_drake.live.messages import decode
from geort_drake.live.robot_buses import ALLEGRO, PANDA
from geort_drake.simulation.tasks import find_task

FRAMES = 60  # of a recording: enough to be one, and read quickly


@dc.dataclass(frozen=True)
class Reader:
    """A reader of one kind of input.

    Attributes:
        name: of the kind.
        path: a valid input, which may be changed.
        read: reads the input at a path. Raises GeortError if it refuses it, and AssertionError if it accepts
            something unusable.
    """

    name: str
    path: Path
    read: Callable[[Path], object]


def sound_inputs(folder: Path) -> list[Reader]:
    """Writes a valid input of every kind into a folder, and reads each."""
    readers = [*_recordings(folder), *_maps(folder), *_descriptions(folder), *_messages(folder)]
    for reader in readers:
        reader.read(reader.path)
    return readers


def _recordings(folder: Path) -> list[Reader]:
    hand, readers = moving().part(slice(FRAMES)), []
    for name, write in WRITERS.items():
        path = write(_room(folder, name), hand)
        readers.append(Reader(name, path, recording))
    return readers


def _maps(folder: Path) -> list[Reader]:
    return [Reader("map", map_file(_room(folder, "map")), retargeter)]


def _descriptions(folder: Path) -> list[Reader]:
    room = _room(folder, "descriptions")
    file, scenarios = room / "hand.yaml", room / "grasp.scenarios.yaml"
    write_description(propose(write_hand(room, HandSpec(fingers=2)), "small").description, file)
    shutil.copyfile(find_task("grasp").scenario[0], scenarios)
    return [Reader("hand description", file, hand), Reader("scenarios", scenarios, load_scenario)]


def _messages(folder: Path) -> list[Reader]:
    room, p_HK = _room(folder, "messages"), moving().p_HK[5]
    messages = {
        "glove.json": json.dumps(own_fields(p_HK)).encode(),
        "manus.json": json.dumps(manus_glove(nodes_of(p_HK))).encode(),
        "manus.txt": ",".join(manus_words("aa", nodes_of(p_HK))).encode(),
    }
    for device in (ALLEGRO, PANDA):
        quarters = [0.25] * len(device.joints)
        messages[f"{len(device.joints)} joints.lcm"] = device.encode_status(1.0, quarters, quarters)
    for name, message in messages.items():
        (room / name).write_bytes(message)
    reads = [glove_message] * 3 + [functools.partial(joint_status, device) for device in (ALLEGRO, PANDA)]
    return [Reader(f"message {name}", room / name, read) for name, read in zip(messages, reads, strict=True)]


def _room(folder: Path, name: str) -> Path:
    (folder / name).mkdir(parents=True)
    return folder / name


def recording(path: Path) -> None:
    read = read_recording(path)
    count = len(read.t)
    assert read.p_HK.shape == (count, 21, 3) and read.valid.shape == (count,), "arrays of wrong shapes"


def retargeter(path: Path) -> None:
    q = load_retargeter(path)(np.zeros((21, 3)))
    assert np.isfinite(q).all(), "a retargeter that gives what is not finite"


def hand(path: Path) -> None:
    model = HandModel(path)
    assert (model.lower < model.upper).all() and np.isfinite(model.default_position).all(), "no limits"


def glove_message(path: Path) -> None:
    frame = decode(path.read_bytes(), "right")
    if frame is not None and frame.p_HK is not None:
        assert frame.p_HK.shape == (21, 3) and np.isfinite(frame.p_HK).all(), "keypoints that are none"


def joint_status(device, path: Path) -> None:
    assert np.isfinite(device.decode_status(path.read_bytes()).position).all(), "positions that are none"

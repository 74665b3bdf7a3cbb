"""A hand's digest covers the files of its model, and nothing else."""

import shutil

import numpy as np
import pytest
from hand_family import HandSpec, write_hand

from geort_drake.hands.description import load_hand, write_description
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.model import HandModel

_BOX = '<box size="0.02 0.044 0.08"/>'


def _palm_mesh(depth: float) -> str:
    """A wedge as an .obj file, of which only the depth differs, m."""
    corners = np.array([[0, 0, 0], [0, 0.04, 0], [0, 0, 0.07], [0, 0.04, 0.07], [-depth, 0.02, 0.03]])
    faces = ["1 2 4 3", "1 5 2", "2 5 4", "4 5 3", "3 5 1"]
    return "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {face}\n" for face in faces)


def _described(folder, model):
    write_description(propose(model).description, folder / "hand.yaml")
    return HandModel(load_hand(folder / "hand.yaml"))


@pytest.fixture
def with_mesh(tmp_path) -> HandModel:
    """A hand in URDF whose palm is a mesh beside it."""
    folder = tmp_path / "mine"
    folder.mkdir()
    model = write_hand(folder, HandSpec(3))
    assert _BOX in model.read_text()
    model.write_text(model.read_text().replace(_BOX, '<mesh filename="palm.obj"/>'), encoding="utf-8")
    (folder / "palm.obj").write_text(_palm_mesh(0.03))
    return _described(folder, model)


def test_the_digest_covers_collision_meshes(with_mesh, tmp_path):
    """But neither unused files nor the folder."""
    folder = tmp_path / "mine"
    (folder / "other.obj").write_text(_palm_mesh(0.02))
    shutil.copytree(folder, tmp_path / "elsewhere")
    assert HandModel(load_hand(tmp_path / "elsewhere" / "hand.yaml")).digest == with_mesh.digest
    (folder / "palm.obj").write_text(_palm_mesh(0.031))
    assert HandModel(load_hand(folder / "hand.yaml")).digest != with_mesh.digest


@pytest.mark.parametrize("kind", ["sdf", "xml"])
def test_the_digest_covers_included_files(kind, tmp_path):
    """A whole SDF model in another's file, and actuators in a file of their own in MJCF."""
    (tmp_path / "parts").mkdir()
    inner = write_hand(tmp_path / "parts", HandSpec(3, kind), "inner")
    text = inner.read_text()
    outer = tmp_path / f"hand.{kind}"
    if kind == "sdf":
        include = "<include merge='true'><uri>package://parts/inner.sdf</uri></include>"
        outer.write_text(f'<sdf version="1.11"><model name="outer">{include}</model></sdf>')
        change = ("<mass>0.03</mass>", "<mass>0.04</mass>")
    else:
        begin = text.index("<actuator>")
        end = text.index("</actuator>") + len("</actuator>")
        inner.write_text(f"<mujoco>{text[begin:end]}</mujoco>")
        outer.write_text(text[:begin] + '<include file="parts/inner.xml"/>' + text[end:])
        change = ('kp="1"', 'kp="2"')
    before = _described(tmp_path, outer).digest
    assert HandModel(load_hand(tmp_path / "hand.yaml")).digest == before
    inner.write_text(inner.read_text().replace(*change))
    assert HandModel(load_hand(tmp_path / "hand.yaml")).digest != before


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("allegro_left", "800cb801fb4a12d0"),
        ("allegro_right", "06a693eef3b0f675"),
        ("leap_right", "59d2d7f8cb1425a2"),
    ],
)
def test_shipped_hands_keep_their_digest(name, start):
    """Saved checkpoints fit a hand with the same digest only."""
    assert HandModel(load_hand(name)).digest.startswith(start)

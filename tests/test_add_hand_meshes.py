"""Models with meshes that Drake does not read are described from copies with their convex hulls."""

import json
import struct

import numpy as np
import pytest
from hand_family import HandSpec, write_hand
from pydrake.geometry import Role
from scipy.spatial import ConvexHull

from geort_drake.errors import HandError
from geort_drake.hands.clearance import HandClearance
from geort_drake.hands.importers.conversion import convert_model, unreadable_meshes
from geort_drake.hands.importers.fingertips import surface_points
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.model import HandModel

# A box off its mesh's origin, longer along z than along y.
CORNERS = np.array(np.meshgrid([-0.022, -0.002], [-0.033, 0.033], [0.0, 0.08])).reshape(3, -1).T


def _triangles() -> np.ndarray:
    return CORNERS[ConvexHull(CORNERS).simplices]


def _binary_stl() -> bytes:
    rows = b"".join(
        struct.pack("<12fH", *np.zeros(3), *triangle.ravel(), 0) for triangle in _triangles().astype("<f4")
    )
    return b"\0" * 80 + struct.pack("<I", len(_triangles())) + rows


def _ascii_stl() -> bytes:
    text = "solid box\n"
    for triangle in _triangles():
        lines = "".join(f"vertex {x:g} {y:g} {z:g}\n" for x, y, z in triangle)
        text += f"facet normal 0 0 0\nouter loop\n{lines}endloop\nendfacet\n"
    return (text + "endsolid box\n").encode()


def _glb() -> bytes:
    """With y up, twice as large, and a node that makes up for the size and for half a turn about y."""
    # (x, y, z) -> (x, z, -y)
    points = _triangles().reshape(-1, 3) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T
    points = 2.0 * points * [-1, 1, -1]
    binary = points.astype("<f4").tobytes()
    scene = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [0.5, 0.5, 0.5]}, {"mesh": 0, "rotation": [0, 1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(binary)}],
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942)
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks) + len(binary)) + chunks + binary


def _ply() -> bytes:
    faces = "".join(f"3 {3 * i} {3 * i + 1} {3 * i + 2}\n" for i in range(len(_triangles())))
    rows = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in _triangles().reshape(-1, 3))
    head = f"element vertex {3 * len(_triangles())}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(_triangles())}\nproperty list uchar int vertex_indices\n"
    return f"ply\nformat ascii 1.0\n{head}end_header\n{rows}{faces}".encode()


def _dae() -> bytes:
    """In centimetres, with an axis up that does not count, and a node that makes up for half the size."""
    corners = " ".join(f"{x:g}" for x in 50.0 * _triangles().ravel())
    count = 3 * len(_triangles())
    numbers = " ".join(map(str, range(count)))
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="{3 * count}">{corners}</float_array><technique_common>
<accessor source="#a" count="{count}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="{count // 3}"><input semantic="VERTEX" source="#v" offset="0"/><p>{numbers}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="c"><node><scale>2 2 2</scale><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#c"/></scene></COLLADA>""".encode()


MESHES = {
    "palm.stl": _binary_stl, "text.STL": _ascii_stl, "palm.glb": _glb, "palm.ply": _ply, "palm.dae": _dae,
}  # fmt: skip


def _with_mesh(tmp_path, kind: str, name: str):
    """A hand of the family whose palm is a mesh."""
    model = write_hand(tmp_path, HandSpec(4, kind, mimic=False))
    text = model.read_text()
    if kind == "urdf":
        text = text.replace('<box size="0.02 0.066 0.08"/>', f'<mesh filename="package://parts/{name}"/>')
        text = text.replace('<origin xyz="-0.012 0 0.04" rpy="0 0 0"/>', "")
    else:
        head = f'<asset><mesh file="{name}"/></asset><compiler meshdir="parts"/>'
        text = text.replace("<worldbody>", f"{head}<worldbody>")
        begin = text.index('<geom type="box"')
        end = text.index("/>", begin) + 2
        text = f'{text[:begin]}<geom type="mesh" mesh="{name[:4]}"/>{text[end:]}'
    model.write_text(text, encoding="utf-8")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / name).write_bytes(MESHES[name]())
    return model


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("kind", ["urdf", "xml"])
def test_a_mesh_becomes_its_hull_in_its_place(kind, name, tmp_path):
    """From STL of both kinds, binary glTF, whose y is up, PLY, and COLLADA in its unit."""
    model = _with_mesh(tmp_path, kind, name)
    assert [mesh.name for mesh in unreadable_meshes(model)] == [name]
    copy = convert_model(model, tmp_path / "copy")
    assert unreadable_meshes(copy) == []
    hand = HandModel(propose(copy).description)
    inspector = hand.scene_graph.model_inspector()
    palm = hand.plant.GetBodyFrameIdOrThrow(hand.plant.GetBodyByName("palm").index())
    (geometry,) = inspector.GetGeometries(palm, Role.kProximity)
    points = inspector.GetPoseInFrame(geometry) @ surface_points(inspector, geometry).T
    np.testing.assert_allclose(points.min(axis=1), CORNERS.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(points.max(axis=1), CORNERS.max(axis=0), atol=1e-6)


def test_the_guard_takes_a_mesh_for_the_box_around_it(tmp_path, rng):
    """This mesh is a box, so all gaps are those of the same hand with a box, but for rounding."""
    plain = HandModel(propose(write_hand(tmp_path, HandSpec(4, "urdf", mimic=False))).description)
    model = convert_model(_with_mesh(tmp_path, "urdf", "palm.stl"), tmp_path / "copy")
    meshed = HandModel(propose(model).description)
    ours, wanted = HandClearance(meshed, 0.1), HandClearance(plain, 0.1)

    def gaps(hand: HandModel, clearance: HandClearance, q: np.ndarray) -> dict[tuple, float]:
        near = clearance.near(q)
        links = (tuple(sorted(map(hand.link_of, pair))) for pair in near.pairs)
        return dict(sorted(zip(links, near.gap, strict=True)))

    for q in rng.uniform(plain.lower, plain.upper, (5, len(plain.lower))):
        near, box = gaps(meshed, ours, q), gaps(plain, wanted, q)
        assert any("palm" in links for links in near)
        assert near == pytest.approx(box, abs=1e-4)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"short", "not a readable .stl mesh"),
        (b"\0" * 80 + struct.pack("<I", 9), "not a readable"),
        (_ascii_stl().replace(b"vertex -0.022", b"vertex nan"), "not a readable .stl mesh"),
        (None, "missing"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_named(content, said, tmp_path):
    """By its file; nothing is left behind."""
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    mesh = tmp_path / "parts" / "palm.stl"
    if content is None:
        mesh.unlink()
    else:
        mesh.write_bytes(content)
    with pytest.raises(HandError, match=said) as error:
        convert_model(model, tmp_path / "copy")
    assert str(mesh) in str(error.value)
    assert not (tmp_path / "copy").exists()

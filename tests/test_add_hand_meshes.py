"""Models with meshes that Drake does not read are described from copies with convex hulls."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hand_family import HandSpec, write_hand
from pydrake.geometry import Role

from geort_drake.errors import HandError
from geort_drake.hands.importers.checks import examine
from geort_drake.hands.importers.conversion import convert_model, unreadable_meshes
from geort_drake.hands.importers.fingertips import surface_points
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.model import HandModel

# A box off its mesh's origin, longer along z than along y, m.
CORNERS = np.array(np.meshgrid([-0.022, -0.002], [-0.033, 0.033], [0.0, 0.08])).reshape(3, -1).T
BOX = trimesh.convex.convex_hull(CORNERS)


def _glb() -> bytes:
    """With y up, twice as large, below a node of half the size."""
    box = BOX.copy()
    box.apply_transform(
        trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]) @ np.diag([2, 2, 2, 1])
    )
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=np.diag([0.5, 0.5, 0.5, 1]))
    return scene.export(file_type="glb")


def _dae() -> bytes:
    """In centimetres, with an up axis that does not count, below a node of twice the size."""
    corners = " ".join(f"{x:g}" for x in 50.0 * BOX.triangles.ravel())
    count = 3 * len(BOX.triangles)
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
    "palm.stl": BOX.export(file_type="stl"),
    "text.STL": BOX.export(file_type="stl_ascii").encode(),
    "palm.glb": _glb(),
    "palm.ply": BOX.export(file_type="ply"),
    "palm.dae": _dae(),
}


def _with_mesh(folder: Path, kind: str, name: str) -> Path:
    """A hand of the family whose palm is a mesh."""
    changes = {
        '<origin xyz="-0.012 0 0.04" rpy="0 0 0"/>': "",
        '<box size="0.02 0.066 0.08"/>': f'<mesh filename="package://parts/{name}"/>',
    }
    if kind == "xml":
        head = f'<asset><mesh file="{name}"/></asset><compiler meshdir="parts"/><worldbody>'
        changes = {"<worldbody>": head, '<geom type="box".*?/>': f'<geom type="mesh" mesh="{name[:4]}"/>'}
    (folder / "parts").mkdir()
    (folder / "parts" / name).write_bytes(MESHES[name])
    return write_hand(folder, HandSpec(4, kind, mimic=False), changes=changes)


@pytest.mark.parametrize(
    ("kind", "name"), [*(("urdf", name) for name in MESHES), ("xml", "palm.stl"), ("xml", "palm.glb")]
)
def test_a_hull_replaces_a_mesh(kind, name, tmp_path):
    """In its place and unit: STL of both kinds, binary glTF, whose y is up, PLY, and COLLADA.

    The copy can be moved.
    """
    model = _with_mesh(tmp_path, kind, name)
    assert [mesh.name for mesh in unreadable_meshes(model)] == [name]
    convert_model(model, tmp_path / "copy")
    copy = (tmp_path / "copy").rename(tmp_path / "moved") / model.name
    assert unreadable_meshes(copy) == []
    hand = HandModel(propose(copy).description)
    inspector = hand.scene_graph.model_inspector()
    palm = hand.plant.GetBodyFrameIdOrThrow(hand.plant.GetBodyByName("palm").index())
    (geometry,) = inspector.GetGeometries(palm, Role.kProximity)
    points = inspector.GetPoseInFrame(geometry) @ surface_points(inspector, geometry).T
    np.testing.assert_allclose(points.min(axis=1), CORNERS.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(points.max(axis=1), CORNERS.max(axis=0), atol=1e-6)


def test_hulls_that_overlap_near_a_joint_are_ignored_and_told(tmp_path):
    """The hull of the palm reaches beyond the knuckles, where it blocks links that it should not touch."""
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    model.write_text(model.read_text().replace('palm.stl"', 'palm.stl" scale="1 1 2"'))
    proposal = propose(convert_model(model, tmp_path / "copy"))
    description = proposal.description
    assert description.ignored_collisions == [["middle_l1", "palm"]]
    assert "shapes overlap are ignored: 'middle_l1' and 'palm'" in "\n".join(proposal.notes)
    assert not any("touch in" in fault for fault in examine(HandModel(description)))
    description.ignored_collisions = []
    assert any("touch in" in fault for fault in examine(HandModel(description)))


LFS_POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"short", "not a readable .stl mesh"),
        (MESHES["text.STL"].replace(b"vertex -", b"vertex nan"), "not a readable .stl mesh"),
        (None, "missing"),
        (LFS_POINTER, "a Git LFS pointer.*git lfs pull"),
    ],
    ids=["cut off", "not finite", "missing", "LFS pointer"],
)
def test_an_unusable_mesh_is_named(content, message, tmp_path):
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    mesh = tmp_path / "parts" / "palm.stl"
    mesh.unlink()
    if content is not None:
        mesh.write_bytes(content)
    with pytest.raises(HandError, match=message) as error:
        convert_model(model, tmp_path / "copy")
    assert str(mesh) in str(error.value)
    assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize("file", ["hand.urdf", "palm.obj"])
def test_a_git_lfs_pointer_is_named(file, tmp_path):
    """In place of the model, or of a mesh that Drake reads."""
    model = write_hand(tmp_path, HandSpec(3), changes={"<box .*?/>": '<mesh filename="palm.obj"/>'})
    (tmp_path / "palm.obj").write_text(BOX.export(file_type="obj"))
    description = propose(model).description
    (tmp_path / file).write_bytes(LFS_POINTER)
    with pytest.raises(HandError, match=rf"{file}: is a Git LFS pointer.*git lfs pull"):
        HandModel(description)

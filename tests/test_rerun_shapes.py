"""Shapes, meshes, poses and colours of a scene graph in a recording."""

import io
import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Mesh,
    MeshcatCone,
    ProximityProperties,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from rerun.chunk import RrdReader
from rerun_world import World, entities, read
from scipy.spatial.transform import Rotation


def test_shapes_are_placed_and_coloured_as_the_plant_has_them(tmp_path):
    """A capsule begins half its length below Drake's centre; what is welded to the world is static."""
    path = World().finalize().record(tmp_path / "shapes.rrd", until=0.1).recorder.path
    times, p_WB = read(path, "/world/arm/base", "Transform3D:translation")
    assert times == [None]
    np.testing.assert_allclose(p_WB[0], [[0.3, 0, 0.2]], atol=1e-6)

    def value(entity, component):
        return np.squeeze(read(path, entity, component)[1][0])

    base, upper, ball = "/world/arm/base/boxes", "/world/arm/upper/capsules", "/world/ball/body/ellipsoids"
    np.testing.assert_allclose(value(base, "Boxes3D:half_sizes"), [0.05, 0.1, 0.15], atol=1e-6)
    np.testing.assert_allclose(value(ball, "Ellipsoids3D:half_sizes"), [0.05] * 3, atol=1e-6)
    red, green, blue, alpha = int(value(ball, "Ellipsoids3D:colors")).to_bytes(4, "big")
    assert (red, green, blue, alpha) == (51, 102, 153, 255)
    X_BG = RigidTransform(RollPitchYaw(0.3, 0.2, 0.1), [0.01, 0.02, 0.1])
    R = Rotation.from_quat(value(upper, "Capsules3D:quaternions"))
    np.testing.assert_allclose(R.as_matrix(), X_BG.rotation().matrix(), atol=1e-6)
    length = value(upper, "Capsules3D:lengths")
    middle = value(upper, "Capsules3D:translations") + R.apply([0, 0, length / 2])
    np.testing.assert_allclose(middle, X_BG.translation(), atol=1e-6)
    assert (length, value(upper, "Capsules3D:radii")) == pytest.approx((0.2, 0.02))
    # The ground has collision geometry only.
    np.testing.assert_allclose(value("/world/ground/slab/boxes", "Boxes3D:half_sizes"), [0.5, 0.5, 0.05])


def test_every_shape_of_drake_is_drawn_or_named(tmp_path):
    """What cannot be drawn is warned about by name."""
    (tmp_path / "tetrahedron.obj").write_text(OBJ)
    file = str(tmp_path / "tetrahedron.obj")
    world = World()
    body = world.plant.AddRigidBody(
        "many", world.ball.model_instance(), SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    )
    X_BG = RigidTransform([0, 0, 2.0])
    plain = Box(1, 2, 3), Sphere(1), Ellipsoid(1, 2, 3), Cylinder(1, 2), Capsule(1, 2)
    for shape in (*plain, Mesh(file, 0.1), Convex(file, 0.2), MeshcatCone(1, 1, 1)):
        name = f"a {type(shape).__name__}"
        world.plant.RegisterVisualGeometry(body, X_BG, shape, name, [0.5, 0.5, 0.5, 1])
    world.finalize()
    with pytest.warns(UserWarning, match=r"a MeshcatCone.*cannot draw"):
        world.record(tmp_path / "shapes.rrd")
    world.recorder.close()
    of_body = {entity.rsplit("/", 1)[-1] for entity in entities(world.recorder.path) if "/many/" in entity}
    assert of_body == {"boxes", "ellipsoids", "cylinders", "capsules", r"a\ Mesh", r"a\ Convex"}


CORNERS = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]], dtype="<f4")
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype="<u2")
VTK = """# vtk DataFile Version 3.0
a tetrahedron
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 4 double
0 0 0  0.3 0 0  0 0.2 0  0 0 0.1
CELLS 1 5
4 0 1 2 3
CELL_TYPES 1
10
"""
OBJ = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write_gltf(folder, buffer):
    """A tetrahedron whose buffer has that name, with a space in its URI; returns the file's path."""
    mesh = trimesh.Trimesh(CORNERS, FACES, process=False)
    files = mesh.export(file_type="gltf", merge_buffers=True)
    (folder / buffer).write_bytes(files["gltf_buffer.bin"])
    model = json.loads(files["model.gltf"])
    model["buffers"][0]["uri"] = buffer.replace(" ", "%20")
    (folder / "t.gltf").write_text(json.dumps(model))
    return str(folder / "t.gltf")


def drawn(tmp_path, shape, role=Role.kIllustration):
    """The entity of a mesh on the ball, in a recording."""
    world = World()
    X_BG = RigidTransform(RollPitchYaw(0, 0, np.pi / 2), [1, 0, 0])
    if role == Role.kIllustration:
        world.plant.RegisterVisualGeometry(world.ball, X_BG, shape, "mesh", [0.2, 0.4, 0.6, 1])
    else:
        properties = ProximityProperties()
        AddContactMaterial(1.0, 1e6, CoulombFriction(0.5, 0.5), properties)
        world.plant.RegisterCollisionGeometry(world.ball, X_BG, shape, "mesh", properties)
    world.finalize().record(tmp_path / "mesh.rrd", role=role, until=0.0)
    return lambda component: read(tmp_path / "mesh.rrd", "/world/ball/body/mesh", component)[1][0]


# Where the corners of a mesh, scaled by 1, 2 and 3 along its axes, are in the body.
IN_BODY = np.array([[1, 0, 0], [1, 0.3, 0], [0.6, 0, 0], [1, 0, 0.3]])


def same_points(found, wanted):
    assert {tuple(np.round(p, 5) + 0.0) for p in found} == {tuple(np.round(p, 5) + 0.0) for p in wanted}


@pytest.mark.parametrize(
    ("kind", "name", "text", "role"),
    [(Convex, "t.obj", OBJ, Role.kIllustration), (Mesh, "t.vtk", VTK, Role.kProximity)],
)
def test_a_mesh_keeps_its_vertices(tmp_path, kind, role, name, text):
    """Visual and collision geometry, scaled differently along their axes, with normals outward."""
    (tmp_path / name).write_text(text)
    value = drawn(tmp_path, kind(str(tmp_path / name), np.array([1.0, 2.0, 3.0])), role)
    same_points(value("Mesh3D:vertex_positions"), IN_BODY)
    corners = value("Mesh3D:vertex_positions").reshape(-1, 3, 3)
    outward = corners.mean(axis=1) - IN_BODY.mean(axis=0)
    assert ((value("Mesh3D:vertex_normals")[::3] * outward).sum(axis=1) > 0).all()


def test_a_gltf_file_is_whole_and_turned_as_drake_turns_it(tmp_path):
    """The recording contains all buffers; the file's y axis is Drake's z."""
    scale = np.array([1.0, 2.0, 3.0])
    value = drawn(tmp_path, Mesh(write_gltf(tmp_path, "a b.bin"), scale))
    contents = np.asarray(value("Asset3D:blob")[0], dtype=np.uint8).tobytes()
    held = trimesh.load_scene(io.BytesIO(contents), file_type="glb", process=False).to_mesh()
    np.testing.assert_allclose(held.triangles, CORNERS[FACES.astype(int)], atol=1e-7)
    # The file has no materials.
    assert int(value("Asset3D:albedo_factor")[0]) == 0x336699FF
    matrix = value("Transform3D:mat3x3").reshape(3, 3).T  # stored by columns
    found = CORNERS @ matrix.T + value("Transform3D:translation")
    # y of the file is up: (x, y, z) becomes (x, -z, y), then scaled, then placed.
    turned = CORNERS[:, [0, 2, 1]] * [1, -1, 1] * scale
    np.testing.assert_allclose(found, np.stack([1 - turned[:, 1], turned[:, 0], turned[:, 2]], 1), atol=1e-6)


MTL = "newmtl red\nKd 1 0.2 0\nd 0.5\nnewmtl a photo\nKd 0.1 0.1 0.1\nmap_Kd photo.png\n"
PAINTED = "mtllib t.mtl\nv 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nvt 0 0\nvt 1 0\nvt 0 1\n"


def photo():
    """Half green, half blue, one below the other."""
    file = io.BytesIO()
    Image.fromarray(np.repeat([[[0, 255, 0]], [[0, 0, 255]]], 2, axis=1).astype(np.uint8)).save(file, "PNG")
    return file.getvalue()


def test_an_obj_file_has_the_colours_and_textures_of_its_materials(tmp_path):
    """Each material is an entity; faces without one have the geometry's colour."""
    text = PAINTED + "f 1 3 2\nusemtl red\nf -4 2 4\nusemtl a photo\nf 1/1 4/2 3/3\nusemtl red\nf 2 3 4\n"
    (tmp_path / "t.obj").write_text(text)
    (tmp_path / "t.mtl").write_text(MTL)
    (tmp_path / "photo.png").write_bytes(photo())
    drawn(tmp_path, Mesh(str(tmp_path / "t.obj"), 2.0))
    parts = {}
    for entity in sorted(e for e in entities(tmp_path / "mesh.rrd") if "/ball/body/mesh/" in e):
        corners = read(tmp_path / "mesh.rrd", entity, "Mesh3D:vertex_positions")[1][0]
        held = {c for chunk in RrdReader(tmp_path / "mesh.rrd").stream() if chunk.entity_path == entity
                for c in chunk.to_record_batch().schema.names}  # fmt: skip
        if "Mesh3D:albedo_factor" in held:
            look = int(read(tmp_path / "mesh.rrd", entity, "Mesh3D:albedo_factor")[1][0][0])
        else:
            look = "texture"
            places = read(tmp_path / "mesh.rrd", entity, "Mesh3D:vertex_texcoords")[1][0]
            # They count from the bottom in the file, and from the top in Rerun.
            assert {tuple(place) for place in places} == {(0, 1), (1, 1), (0, 0)}
            buffer = read(tmp_path / "mesh.rrd", entity, "Mesh3D:albedo_texture_buffer")[1][0]
            assert np.ravel(buffer).size == 2 * 2 * 3
        parts[look] = corners
    assert {look: len(corners) for look, corners in parts.items()} == {
        0x336699FF: 3, 0xFF330080: 6, "texture": 3,
    }  # fmt: skip
    turned = 2.0 * CORNERS.astype(float)
    same_points(
        np.concatenate(list(parts.values())).astype(float),
        np.stack([1 - turned[:, 1], turned[:, 0], turned[:, 2]], -1),
    )


def test_a_damaged_file_is_drawn_as_its_hull_or_left_out(tmp_path):
    mesh = Mesh(write_gltf(tmp_path, "lost.bin"))
    (tmp_path / "lost.bin").unlink()
    world = World()
    world.plant.RegisterVisualGeometry(world.ball, RigidTransform(), mesh, "mesh", [1, 1, 1, 1])
    with pytest.warns(UserWarning) as warned:
        world.finalize().record(tmp_path / "mesh.rrd")
    world.recorder.close()
    text = " ".join(str(warning.message) for warning in warned)
    assert "mesh: drawn as its convex hull; " in text
    assert "mesh: cannot draw a Mesh" in text  # Drake cannot compute a hull of it either

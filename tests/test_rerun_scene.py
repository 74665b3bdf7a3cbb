"""What a recording shows: shapes, signals, states, hands, points, cameras and contact forces."""

import io
import json
from pathlib import Path

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
from pydrake.multibody.tree import FixedOffsetFrame, SpatialInertia
from rerun.chunk import RrdReader
from rerun_world import GRAVITY, MASS, World, constant, entities, pose_source, read, steps
from scipy.spatial.transform import Rotation

from geort_drake import CloseUpSpec, ContactSpec, HandSpec, PointsSpec, SignalSpec, StateSpec
from geort_drake.errors import ScenarioError
from geort_drake.people.keypoints import BONES


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
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    body = world.plant.AddRigidBody("many", world.ball.model_instance(), inertia)
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
VTK = Path(__file__).with_name("tetrahedron.vtk").read_text("utf-8")
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
    found = np.concatenate(list(parts.values())).astype(float)
    same_points(found, np.stack([1 - turned[:, 1], turned[:, 0], turned[:, 2]], -1))


def test_a_damaged_file_is_drawn_as_its_hull_or_left_out(tmp_path):
    mesh = Mesh(write_gltf(tmp_path, "lost.bin"))
    (tmp_path / "lost.bin").unlink()
    with pytest.warns(UserWarning) as warned:
        drawn(tmp_path, mesh)
    text = " ".join(str(warning.message) for warning in warned)
    assert "mesh: drawn as its convex hull; " in text
    assert "mesh: cannot draw a Mesh" in text  # Drake cannot compute a hull of it either


def test_signals_are_grouped_by_the_part_before_the_slash_and_may_be_derived(tmp_path):
    """Each group is one entity with its own named series.

    Derived values are computed on writing, from several ports and for all samples at once; a shared port is
    read once.
    """
    world = World(height=2.0).finalize()
    port = steps(world.builder, [0, 0.05, 1], [[1, 2, 2], [3, 4, 4], [5, 6, 6]])
    ports = [port, constant(world.builder, [10])]
    names = ["index/a", "thumb/b", "index/c"]
    specs = {
        "joints/command": SignalSpec(port, names, "command"),
        "joints/sum": SignalSpec(ports, ["a", "b", "c"], derive=lambda v: v[:, :3] + v[:, 3:]),
    }
    world.record(tmp_path / "s.rrd", specs=specs, until=0.08)
    inputs = [world.recorder.get_input_port(i).get_name() for i in range(world.recorder.num_input_ports())]
    assert inputs == ["body_poses", "contact_results", "joints/command", "joints/sum/1"]
    times, values = read(world.recorder.path, "/joints/command/index", "Scalars:scalars")
    before = np.array(times) < 0.05
    np.testing.assert_array_equal(np.array(values)[before], np.tile([1, 5], (3, 1)))
    np.testing.assert_array_equal(np.array(values)[~before], np.tile([2, 6], (2, 1)))
    _, labels = read(world.recorder.path, "/joints/command/index", "SeriesLines:names")
    assert labels[0].tolist() == ["a command", "c command"]
    _, values = read(world.recorder.path, "/joints/command/thumb", "Scalars:scalars")
    assert values[-1].tolist() == [4]
    _, sums = read(world.recorder.path, "/joints/sum", "Scalars:scalars")
    np.testing.assert_allclose(sums, [[11, 13, 15]] * 3 + [[12, 14, 16]] * 2)


def test_states_are_written_where_they_change(tmp_path):
    """Codes become names; a code without a name shows as a number. One's own spec may have rows of text."""

    class Text(StateSpec):
        def read(self, value):
            return str(value[0])

        def write(self, writer, key, rows):
            super().write(writer, key, [float(row) for row in rows])

    world = World().finalize()
    port = steps(world.builder, [0, 0.1, 0.2, 0.3, 1], [[0, 0, 1, 7, 7]])
    specs = {key: kind(port, ["reach", "grasp"]) for key, kind in (("phase", StateSpec), ("text", Text))}
    world.record(tmp_path / "p.rrd", specs=specs, period=0.05, until=0.4)
    for path in ("/phase", "/text"):
        times, states = read(world.recorder.path, path, "StateChange:state")
        np.testing.assert_allclose(times, [0, 0.2, 0.3], atol=1e-9)
        assert [state[0] for state in states] == ["reach", "grasp", "code 7"]


def test_the_hand_is_drawn_where_it_is_tracked(tmp_path, rng):
    """Keypoints are p_WK = X_WO X_OH p_HK, and every bone's capsule ends at its two keypoints."""
    world = World().finalize()
    p_HK = rng.uniform(-0.1, 0.1, (21, 3))
    p_HK[8] = p_HK[7] - [0, 0, 0.03]  # one straight down, which a shortest rotation must survive
    X_OH = RigidTransform(RollPitchYaw(0, 0, 0), [0.1, 0.2, 0.3])
    X_WO = RigidTransform(RollPitchYaw(np.pi, 0, np.pi / 2), [0, 0, 1])
    valid = steps(world.builder, [0, 0.1, 0.2, 1], [[1, 0, 1, 1]])
    hand = HandSpec(constant(world.builder, p_HK.ravel()), pose_source(world.builder, X_OH), valid, X_WO=X_WO)
    world.record(tmp_path / "h.rrd", specs={"operator/hand": hand}, period=0.05, until=0.25)
    times, drawn = read(world.recorder.path, "/world/operator/hand/keypoints", "Points3D:positions")
    assert [len(points) for points in drawn] == [21, 21, 0, 0, 21, 21]
    np.testing.assert_allclose(times, np.arange(6) * 0.05, atol=1e-9)
    p_WK = (X_WO.GetAsMatrix4() @ X_OH.GetAsMatrix4() @ np.c_[p_HK, np.ones(21)].T)[:3].T
    np.testing.assert_allclose(drawn[-1], p_WK, atol=1e-6)
    bones = "/world/operator/hand/bones"
    start, turn, length = (
        read(world.recorder.path, bones, f"Capsules3D:{name}")[1][-1]
        for name in ("translations", "quaternions", "lengths")
    )
    parents, children = np.array(BONES).T
    np.testing.assert_allclose(start, p_WK[parents], atol=1e-6)
    end = start + Rotation.from_quat(turn).apply(np.c_[np.zeros((20, 2)), length])
    np.testing.assert_allclose(end, p_WK[children], atol=1e-6)


def test_points_follow_the_frame_they_are_measured_in_and_keep_their_colours(tmp_path):
    """Coordinates in a moving frame are drawn in the world; points of glass are ellipsoids.

    One that is not a number is left out, and takes its colour along.
    """
    world = World(height=2.0)
    offset = RigidTransform(RollPitchYaw(0, np.pi / 2, 0), [0, 0, 0.1])
    frame = world.plant.AddFrame(FixedOffsetFrame("F", world.ball.body_frame(), offset))
    world.finalize()
    colors = [(255, 0, 0, 100), (0, 255, 0, 100), (0, 0, 255, 100)]
    beads = constant(world.builder, [1, 0, 0, np.nan, 0, 0, 3, 0, 0])
    points = {
        "goal": PointsSpec(constant(world.builder, [0.5, 0, 0, np.nan, 0, 0]), frame=frame),
        "glass": PointsSpec(beads, radius=0.02, color=colors),
    }
    world.record(tmp_path / "pts.rrd", specs=points)
    world.simulator.AdvanceTo(0.2)
    p_WB = world.plant.EvalBodyPoseInWorld(world.context, world.ball).translation()
    world.recorder.close()
    _, found = read(world.recorder.path, "/world/goal", "Points3D:positions")
    # Pitch by a right angle turns x to -z.
    np.testing.assert_allclose(found[-1], [p_WB + [0, 0, 0.1 - 0.5]], atol=1e-6)
    _, found = read(world.recorder.path, "/world/glass", "Ellipsoids3D:centers")
    np.testing.assert_allclose(found[-1], [[1, 0, 0], [3, 0, 0]])
    _, shades = read(world.recorder.path, "/world/glass", "Ellipsoids3D:colors")
    assert shades[-1].tolist() == [0xFF000064, 0x0000FF64]
    _, sizes = read(world.recorder.path, "/world/glass", "Ellipsoids3D:half_sizes")
    np.testing.assert_allclose(sizes[-1], np.full((2, 3), 0.02), rtol=1e-6)


def test_a_close_up_of_a_hand_that_is_not_recorded_is_refused(tmp_path):
    close_ups = {"c": CloseUpSpec("left", (1, 0, 0))}
    with pytest.raises(ScenarioError, match="the hand 'left'; the recorded hands are: none"):
        World().finalize().record(tmp_path / "no.rrd", close_ups=close_ups)


def test_a_table_has_the_samples_that_the_file_has(tmp_path):
    """Signals by joint, states by name, forces by body, and poses as quaternion and position."""
    world = World(height=0.06).finalize()
    names = ["index/a", "thumb/b"]
    specs = {
        "joints/command": SignalSpec(constant(world.builder, [1, 2]), names, "command"),
        "phase": StateSpec(steps(world.builder, [0, 0.1, 1], [[0, 1, 1]]), ["fall", "rest"]),
    }
    world.record(tmp_path / "t.rrd", specs=specs, period=1 / 16)
    world.simulator.AdvanceTo(5 / 16)
    table = world.recorder.table()
    world.recorder.close()
    np.testing.assert_allclose(table["t"], np.arange(6) / 16, atol=1e-9)
    assert table["joints.command.thumb.b"].to_pylist() == [2.0] * 6
    assert table["state.phase"].to_pylist() == ["fall"] * 2 + ["rest"] * 4
    for column, entity, component in (
        ("pose.ball.body", "/world/ball/body", "Transform3D:translation"),
        ("contact.force.ball.body", "/contact/force/ball/body", "Scalars:scalars"),
    ):
        _, expected = read(world.recorder.path, entity, component)
        values = np.array(table[column].to_pylist()).reshape(6, -1)[:, -np.ravel(expected[0]).size :]
        np.testing.assert_allclose(values, np.reshape(expected, (6, -1)), atol=1e-6)


def test_a_text_has_a_panel_and_a_recording_its_name(tmp_path):
    world = World().finalize().record(tmp_path / "about.rrd", text="not over")
    world.recorder.describe("cube, held", "# Held")
    world.recorder.close()
    assert read(world.recorder.path, "/about", "TextDocument:text")[1][0].tolist() == ["# Held"]
    assert read(world.recorder.path, "/__properties", "RecordingInfo:name")[1][0].tolist() == ["cube, held"]


def test_contact_arrows_appear_with_the_contact_and_vanish_with_it(tmp_path):
    """A resting ball has arrows, none while a kick makes it fly, and again when it is back.

    Without groups, each touched body has a series.
    """
    world = World(height=0.0499).finalize().record(tmp_path / "contact.rrd", period=1 / 64)
    with world.recorder:
        world.simulator.AdvanceTo(0.25)
        world.kick(1.0)
        world.simulator.AdvanceTo(0.75)
    times, vectors = read(world.recorder.path, "/world/contact/forces", "Arrows3D:vectors")
    times, touching = np.array(times), np.array([len(v) > 0 for v in vectors])
    back = 0.25 + 2 * 1.0 / GRAVITY  # s
    assert touching[(times > 0.01) & (times < 0.25)].all()
    assert not touching[(times > 0.26) & (times < back - 0.01)].any()
    assert touching[times > back + 0.02].all()
    # The ground does not move, and nothing touches the arm.
    series = {entity for entity in entities(world.recorder.path) if entity.startswith("/contact/")}
    assert series == {"/contact/force/ball/body"}


@pytest.mark.parametrize("contact_model", ["point", "hydroelastic"])
def test_contact_force_of_a_resting_ball_is_its_weight(tmp_path, contact_model):
    """Both arrows of a contact are as long as the force, and opposite; the series contains the force."""
    world = World(0.0499, contact_model=contact_model).finalize()
    spec = ContactSpec(metres_per_newton=0.1, groups={"ball": [world.ball], "arm": [world.upper]})
    world.record(tmp_path / "rest.rrd", contact=spec, until=1.0)
    _, vectors = read(world.recorder.path, "/world/contact/forces", "Arrows3D:vectors")
    _, origins = read(world.recorder.path, "/world/contact/forces", "Arrows3D:origins")
    up, down = sorted(vectors[-1].tolist(), key=lambda v: -v[2])
    np.testing.assert_allclose(up, [0, 0, 0.1 * MASS * GRAVITY], atol=5e-3)
    np.testing.assert_allclose(down, np.negative(up), atol=1e-6)
    # A sphere of compliant facets may roll onto one of them.
    np.testing.assert_allclose(origins[-1], np.zeros((2, 3)), atol=2e-2)
    np.testing.assert_allclose(origins[-1][:, 2], 0, atol=1e-3)
    for group, weight in (("ball", MASS * GRAVITY), ("arm", 0.0)):
        _, force = read(world.recorder.path, f"/contact/force/{group}", "Scalars:scalars")
        np.testing.assert_allclose(force[-1], [weight], atol=2e-2)
        _, names = read(world.recorder.path, f"/contact/force/{group}", "SeriesLines:names")
        assert names[0].tolist() == [group]

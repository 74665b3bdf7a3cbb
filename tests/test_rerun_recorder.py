"""The Rerun recorder on small worlds; files are read back with Rerun's own reader and tools."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, MeshcatCone, Role, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError, ScenarioError
from geort_drake.gloves.keypoints import BONES
from geort_drake.systems._rerun_screenshot import take_screenshot
from geort_drake.systems.rerun_recorder import (
    ContactSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    StateSpec,
    add_rerun_recorder,
)

GRAVITY = 9.81
MASS = 0.2

GROUND = """
<model name="ground"><static>true</static><link name="slab">
  <collision name="top"><pose>0 0 -0.05 0 0 0</pose>
    <geometry><box><size>1 1 0.1</size></box></geometry>HYDRO</collision>
</link></model>"""

BALL = f"""
<model name="ball"><link name="body">
  <inertial><mass>{MASS}</mass><inertia><ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial>
  <visual name="skin"><geometry><sphere><radius>0.05</radius></sphere></geometry>
    <material><diffuse>0.2 0.4 0.6 1</diffuse></material></visual>
  <collision name="solid"><geometry><sphere><radius>0.05</radius></sphere></geometry>HYDRO</collision>
</link></model>"""

ARM = """
<model name="arm">
  <joint name="fixed" type="fixed"><parent>world</parent><child>base</child></joint>
  <link name="base"><pose>0.3 0 0.2 0 0 0</pose><inertial><mass>1</mass></inertial>
    <visual name="foot"><geometry><box><size>0.1 0.2 0.3</size></box></geometry></visual></link>
  <link name="upper"><pose>0.3 0 0.5 0 0 0</pose>
    <inertial><mass>0.3</mass><inertia><ixx>1e-2</ixx><iyy>1e-2</iyy><izz>1e-2</izz></inertia></inertial>
    <visual name="tube"><pose>0.01 0.02 0.1 0.3 0.2 0.1</pose>
      <geometry><capsule><radius>0.02</radius><length>0.2</length></capsule></geometry></visual></link>
  <joint name="shoulder" type="revolute"><parent>base</parent><child>upper</child>
    <axis><xyz>0 1 0</xyz></axis></joint>
</model>"""

HYDROELASTIC = """<drake:proximity_properties><drake:compliant_hydroelastic/>
  <drake:hydroelastic_modulus>1e6</drake:hydroelastic_modulus>
  <drake:mesh_resolution_hint>0.02</drake:mesh_resolution_hint></drake:proximity_properties>"""


class World:
    """A ball above the ground and a loose arm; further systems may be added before `record`."""

    def __init__(self, height=0.5, contact_model="point"):
        self.builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.002, contact_model=contact_model)
        self.plant, self.scene_graph = AddMultibodyPlant(config, self.builder)
        hydro = HYDROELASTIC if contact_model == "hydroelastic" else ""
        for model in (GROUND, BALL, ARM):
            sdf = model.replace("HYDRO", hydro)
            text = f"<sdf version='1.10' xmlns:drake='http://drake.mit.edu'>{sdf}</sdf>"
            Parser(self.plant).AddModelsFromString(text, "sdf")
        self.ball = self.plant.GetBodyByName("body")
        self.upper = self.plant.GetBodyByName("upper")
        self.height = height

    def finalize(self):
        self.plant.Finalize()
        self.plant.SetDefaultFloatingBaseBodyPose(self.ball, RigidTransform([0, 0, self.height]))
        return self

    def record(self, path, **options):
        self.recorder = add_rerun_recorder(self.builder, self.plant, self.scene_graph, path, **options)
        self.simulator = Simulator(self.builder.Build())
        root = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyMutableContextFromRoot(root)
        return self

    def kick(self, speed):
        """Sets the ball's upward velocity, m/s."""
        velocities = self.plant.GetVelocities(self.context).copy()
        # Angular velocity, then linear; its z comes last of six.
        velocities[self.ball.floating_velocities_start_in_v() + 5] = speed
        self.plant.SetVelocities(self.context, velocities)


def constant(builder, values):
    return builder.AddSystem(ConstantVectorSource(np.array(values, float))).get_output_port()


def steps(builder, times, values):
    trajectory = PiecewisePolynomial.ZeroOrderHold(times, np.atleast_2d(np.array(values, float)))
    return builder.AddSystem(TrajectorySource(trajectory)).get_output_port()


def pose_source(builder, X):
    return builder.AddSystem(ConstantValueSource(AbstractValue.Make(X))).get_output_port()


def rerun(*arguments):
    command = [sys.executable, "-m", "rerun", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def read(path, entity, component):
    """Times (s; None for static data) and one array per time of a component in a file."""
    times, values = [], []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        static = "sim_time" not in batch.schema.names
        stamps = [None] * chunk.num_rows if static else batch.column("sim_time").cast("int64").to_pylist()
        times += [None if stamp is None else stamp * 1e-9 for stamp in stamps]
        values += [np.array(row) for row in batch.column(component).to_pylist()]
    assert values, f"{entity} has no {component}"
    return times, values


def entities(path):
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def test_recordings_pass_reruns_own_verification(tmp_path):
    """Every kind of track in one file."""
    world = World().finalize()
    builder = world.builder
    world.record(
        tmp_path / "all.rrd",
        signals={"joints": SignalSpec(constant(builder, [1, 2]), ["a", "b"])},
        states={"phase": StateSpec(steps(builder, [0, 0.1, 0.3], [[0, 1, 1]]), ["reach", "hold"])},
        hands={"hand": HandSpec(constant(builder, np.ones(63)), pose_source(builder, RigidTransform()))},
        points={"goals": PointsSpec(constant(builder, np.ones(6)))},
        properties={"seed": 3},
    )
    with world.recorder:
        world.simulator.AdvanceTo(0.2)
    checked = rerun("rrd", "verify", world.recorder.path)
    assert checked.returncode == 0, checked.stderr
    assert "1 file verified without error" in checked.stdout + checked.stderr


def test_poses_in_the_file_are_those_of_the_plant(tmp_path):
    """The last sample is the plant's pose at that time; the ball's path is that of a free fall."""
    world = World(height=2.0).finalize().record(tmp_path / "poses.rrd", period=0.1)
    world.simulator.AdvanceTo(0.5)
    X_WU = world.plant.EvalBodyPoseInWorld(world.context, world.upper)
    world.recorder.close()
    times, p_WU = read(world.recorder.path, "/world/arm/upper", "Transform3D:translation")
    _, quaternions = read(world.recorder.path, "/world/arm/upper", "Transform3D:quaternion")
    np.testing.assert_allclose(times, np.arange(6) * 0.1, atol=1e-9)
    np.testing.assert_allclose(p_WU[-1][0], X_WU.translation(), atol=1e-6)
    R_WU = Rotation.from_quat(quaternions[-1][0]).as_matrix()
    np.testing.assert_allclose(R_WU, X_WU.rotation().matrix(), atol=1e-6)
    _, p_WB = read(world.recorder.path, "/world/ball/body", "Transform3D:translation")
    # Euler's steps of 2 ms are off by g t dt / 2, and a sample may lie on either side of a step at
    # its time, which is g t dt: 15 mm together.
    expected = 2.0 - GRAVITY / 2 * np.square(times)
    np.testing.assert_allclose([p[0][2] for p in p_WB], expected, atol=15e-3)


def test_what_is_welded_to_the_world_is_written_once(tmp_path):
    """Static data belongs to every time."""
    world = World().finalize().record(tmp_path / "static.rrd")
    with world.recorder:
        world.simulator.AdvanceTo(0.1)
    times, p_WB = read(world.recorder.path, "/world/arm/base", "Transform3D:translation")
    assert times == [None]
    np.testing.assert_allclose(p_WB[0], [[0.3, 0, 0.2]], atol=1e-6)


def test_shapes_are_placed_and_coloured_as_the_plant_has_them(tmp_path):
    """A capsule begins half its length below Drake's centre; a sphere is an ellipsoid."""
    world = World().finalize().record(tmp_path / "shapes.rrd")
    world.recorder.close()
    path = world.recorder.path

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
    """Meshes keep their vertices; what cannot be drawn is warned about by name."""
    (tmp_path / "tetrahedron.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    file = str(tmp_path / "tetrahedron.obj")
    world = World()
    body = world.plant.AddRigidBody(
        "many", world.ball.model_instance(), SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    )
    X_BG = RigidTransform([0, 0, 2.0])
    for shape in (
        Box(1, 2, 3),
        Sphere(1),
        Ellipsoid(1, 2, 3),
        Cylinder(1, 2),
        Capsule(1, 2),
        Mesh(file, 0.1),
        Convex(file, 0.2),
        MeshcatCone(1, 1, 1),
    ):
        name = f"a {type(shape).__name__}"
        world.plant.RegisterVisualGeometry(body, X_BG, shape, name, [0.5, 0.5, 0.5, 1])
    world.finalize()
    with pytest.warns(UserWarning, match=r"a MeshcatCone.*cannot draw"):
        world.record(tmp_path / "shapes.rrd")
    world.recorder.close()
    of_body = {entity.rsplit("/", 1)[-1] for entity in entities(world.recorder.path) if "/many/" in entity}
    assert of_body == {"boxes", "ellipsoids", "cylinders", "capsules", r"a\ Mesh", r"a\ Convex"}
    model = next(e for e in entities(world.recorder.path) if e.endswith("/many/boxes")).rsplit("/", 1)[0]
    corners = {(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)}
    for name, scale in ((r"a\ Mesh", 0.1), (r"a\ Convex", 0.2)):
        vertices = read(world.recorder.path, f"{model}/{name}", "Mesh3D:vertex_positions")[1][0]
        assert vertices.shape == (12, 3)  # four triangles
        found = {tuple(np.round((v - [0, 0, 2.0]) / scale, 5)) for v in vertices}
        assert found == corners


def test_equal_simulations_give_equal_recordings(tmp_path):
    """Neither the clock nor chance gets into a file."""
    paths = [tmp_path / folder / "trial.rrd" for folder in ("one", "two")]
    for path in paths:
        world = World(height=0.06).finalize().record(path, properties={"seed": 3})
        with world.recorder:
            world.simulator.AdvanceTo(0.2)
    compared = rerun("rrd", "compare", "--unordered", *paths)
    assert compared.returncode == 0, compared.stderr[-2000:]
    ids = {RrdReader(path).recordings()[0].recording_id for path in paths}
    assert len(ids) == 1
    other = World(height=0.07).finalize().record(tmp_path / "other" / "trial.rrd", properties={"seed": 3})
    with other.recorder:
        other.simulator.AdvanceTo(0.2)
    compared = rerun("rrd", "compare", "--unordered", paths[0], other.recorder.path)
    assert compared.returncode != 0


def test_contact_arrows_appear_with_the_contact_and_vanish_with_it(tmp_path):
    """A resting ball has arrows, none while a kick makes it fly, and again when it is back."""
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


@pytest.mark.parametrize("contact_model", ["point", "hydroelastic"])
def test_contact_force_of_a_resting_ball_is_its_weight(tmp_path, contact_model):
    """Both arrows of a contact are as long as the force, and opposite; the series holds the force."""
    world = World(0.0499, contact_model=contact_model).finalize()
    spec = ContactSpec(metres_per_newton=0.1, groups={"ball": [world.ball], "arm": [world.upper]})
    world.record(tmp_path / "rest.rrd", contact=spec)
    with world.recorder:
        world.simulator.AdvanceTo(1.0)
    _, vectors = read(world.recorder.path, "/world/contact/forces", "Arrows3D:vectors")
    _, origins = read(world.recorder.path, "/world/contact/forces", "Arrows3D:origins")
    up, down = sorted(vectors[-1].tolist(), key=lambda v: -v[2])
    np.testing.assert_allclose(up, [0, 0, 0.1 * MASS * GRAVITY], atol=5e-3)
    np.testing.assert_allclose(down, np.negative(up), atol=1e-6)
    # A sphere of compliant facets may roll onto one of them.
    np.testing.assert_allclose(origins[-1], np.zeros((2, 3)), atol=2e-2)
    np.testing.assert_allclose(origins[-1][:, 2], 0, atol=1e-3)
    _, force = read(world.recorder.path, "/contact/force", "Scalars:scalars")
    np.testing.assert_allclose(force[-1], [MASS * GRAVITY, 0], atol=2e-2)
    _, names = read(world.recorder.path, "/contact/force", "SeriesLines:names")
    assert names[0].tolist() == ["ball", "arm"]


def test_long_contact_arrows_are_cut(tmp_path):
    """An impact must not fill the screen."""
    world = World(height=0.06).finalize()
    spec = ContactSpec(metres_per_newton=10.0, max_length=0.3)
    world.record(tmp_path / "cut.rrd", contact=spec)
    with world.recorder:
        world.simulator.AdvanceTo(0.3)
    _, vectors = read(world.recorder.path, "/world/contact/forces", "Arrows3D:vectors")
    np.testing.assert_allclose(np.linalg.norm(vectors[-1], axis=1), 0.3, rtol=1e-5)


def test_signals_are_grouped_by_what_stands_before_the_slash(tmp_path):
    """Each group is one entity with its own named series."""
    world = World().finalize()
    port = steps(world.builder, [0, 0.05, 1], [[1, 2, 2], [3, 4, 4], [5, 6, 6]])
    names = ["index/a", "thumb/b", "index/c"]
    world.record(tmp_path / "s.rrd", signals={"joints/command": SignalSpec(port, names, "command")})
    with world.recorder:
        world.simulator.AdvanceTo(0.08)
    times, values = read(world.recorder.path, "/joints/command/index", "Scalars:scalars")
    before = np.array(times) < 0.05
    np.testing.assert_array_equal(np.array(values)[before], np.tile([1, 5], (3, 1)))
    np.testing.assert_array_equal(np.array(values)[~before], np.tile([2, 6], (2, 1)))
    _, labels = read(world.recorder.path, "/joints/command/index", "SeriesLines:names")
    assert labels[0].tolist() == ["a command", "c command"]
    _, values = read(world.recorder.path, "/joints/command/thumb", "Scalars:scalars")
    assert values[-1].tolist() == [4]


def test_states_are_written_where_they_change(tmp_path):
    """Codes become names; a code without a name shows as a number."""
    world = World().finalize()
    port = steps(world.builder, [0, 0.1, 0.2, 0.3, 1], [[0, 0, 1, 7, 7]])
    world.record(tmp_path / "p.rrd", states={"phase": StateSpec(port, ["reach", "grasp"])}, period=0.05)
    with world.recorder:
        world.simulator.AdvanceTo(0.4)
    times, states = read(world.recorder.path, "/phase", "StateChange:state")
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
    world.record(tmp_path / "h.rrd", hands={"operator/hand": hand}, period=0.05)
    with world.recorder:
        world.simulator.AdvanceTo(0.25)
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


def test_points_follow_the_frame_they_are_measured_in(tmp_path):
    """Coordinates in a moving frame are drawn in the world; points with a NaN are left out."""
    world = World(height=2.0)
    offset = RigidTransform(RollPitchYaw(0, np.pi / 2, 0), [0, 0, 0.1])
    frame = world.plant.AddFrame(FixedOffsetFrame("F", world.ball.body_frame(), offset))
    world.finalize()
    port = constant(world.builder, [0.5, 0, 0, np.nan, 0, 0])
    world.record(tmp_path / "pts.rrd", points={"goal": PointsSpec(port, frame=frame)})
    world.simulator.AdvanceTo(0.2)
    p_WB = world.plant.EvalBodyPoseInWorld(world.context, world.ball).translation()
    world.recorder.close()
    _, points = read(world.recorder.path, "/world/goal", "Points3D:positions")
    # Pitch by a right angle turns x to -z.
    np.testing.assert_allclose(points[-1], [p_WB + [0, 0, 0.1 - 0.5]], atol=1e-6)


def test_properties_keep_their_types_from_one_recording_to_the_next(tmp_path):
    """Rerun remembers the first type of a name; that must not leak between recordings."""
    for number, seed in enumerate((3, "three", 3.5, True)):
        world = World().finalize()
        world.record(tmp_path / f"{number}.rrd", properties={"seed": seed})
        world.recorder.set_properties({"outcome": "held"})
        world.recorder.close()
        _, value = read(world.recorder.path, "/__properties/run", "seed")
        assert value[0].tolist() == [seed]
        _, value = read(world.recorder.path, "/__properties/run", "outcome")
        assert value[0].tolist() == ["held"]


def test_an_interrupted_simulation_leaves_a_whole_file(tmp_path):
    """The samples up to the failure are what one wants to look at."""
    world = World().finalize().record(tmp_path / "broken.rrd")

    def fail(context):
        if context.get_time() > 0.1:
            raise RuntimeError("the hand is on fire")

    world.simulator.set_monitor(fail)
    with pytest.raises(RuntimeError, match="on fire"), world.recorder:
        assert not world.recorder.path.exists()
        world.simulator.AdvanceTo(1.0)
    assert rerun("rrd", "verify", world.recorder.path).returncode == 0
    times, _ = read(world.recorder.path, "/world/ball/body", "Transform3D:translation")
    assert times[-1] == pytest.approx(0.1)


def test_a_failure_while_writing_leaves_nothing(tmp_path, monkeypatch):
    """Half a file would look like a short simulation."""
    world = World().finalize().record(tmp_path / "half.rrd")
    world.simulator.AdvanceTo(0.1)
    monkeypatch.setattr(type(world.recorder._recording.tracks[-1]), "write", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        world.recorder.close()
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    world.recorder.close()
    assert rerun("rrd", "verify", world.recorder.path).returncode == 0


def test_rerun_switched_off_writes_nothing_and_says_so(tmp_path, monkeypatch):
    """Rerun's own environment variable would otherwise leave an empty file."""
    monkeypatch.setenv("RERUN", "off")
    world = World().finalize().record(tmp_path / "off.rrd")
    with pytest.warns(UserWarning, match="RERUN=off"):
        world.recorder.close()
    assert list(tmp_path.iterdir()) == []


def test_closing_twice_or_going_on_changes_nothing(tmp_path):
    """The file is written once."""
    world = World().finalize().record(tmp_path / "new" / "folder" / "once.rrd")
    world.simulator.AdvanceTo(0.1)
    world.recorder.close()
    written = world.recorder.path.read_bytes()
    world.simulator.AdvanceTo(0.2)
    world.recorder.close()
    assert world.recorder.path.read_bytes() == written
    assert world.recorder.times[-1] == pytest.approx(0.1)


def test_a_file_is_written_when_the_process_ends_without_close(tmp_path):
    """Also after an uncaught exception."""
    code = f"""
        import sys
        sys.path.insert(0, {str(sys.path[0])!r})
        from test_rerun_recorder import World
        world = World().finalize().record({str(tmp_path / "exit.rrd")!r})
        world.simulator.AdvanceTo(0.1)
        raise SystemExit("no close")
    """
    folder = __file__.rsplit("/", 1)[0]
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=folder, capture_output=True, text=True, check=False
    )
    assert "no close" in done.stderr
    times, _ = read(tmp_path / "exit.rrd", "/world/ball/body", "Transform3D:translation")
    assert times[-1] == pytest.approx(0.1)


def test_going_back_in_time_starts_over_from_there(tmp_path):
    """A simulator initialized anew does not leave two samples of the same instant."""
    world = World().finalize().record(tmp_path / "again.rrd", period=1 / 16)
    world.simulator.AdvanceTo(4 / 16)
    world.simulator.get_mutable_context().SetTime(2 / 16)
    world.simulator.Initialize()
    world.simulator.AdvanceTo(3 / 16)
    np.testing.assert_allclose(world.recorder.times, np.arange(4) / 16, atol=1e-9)
    assert all(len(track.rows) == 4 for track in world.recorder._recording.tracks)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (lambda w: {"period": 0.0}, "period must be positive"),
        (
            lambda w: {"signals": {"q": SignalSpec(constant(w.builder, [1, 2]), ["a"])}},
            "'q'.*size 2.*wanted 1",
        ),
        (lambda w: {"states": {"s": StateSpec(constant(w.builder, [1, 2]), [])}}, "'s'.*size 2; wanted 1"),
        (lambda w: {"points": {"p": PointsSpec(constant(w.builder, [1] * 4))}}, "'p'.*size 4; wanted 3"),
        (
            lambda w: {"signals": {"x": SignalSpec(pose_source(w.builder, RigidTransform()), ["a"])}},
            "'x'.*is abstract; wanted a vector",
        ),
        (
            lambda w: {"hands": {"h": HandSpec(constant(w.builder, [0] * 60), constant(w.builder, [0]))}},
            "'h/keypoints'.*size 60; wanted 63",
        ),
        (
            lambda w: {"hands": {"h": HandSpec(constant(w.builder, [0] * 63), constant(w.builder, [0]))}},
            "'h/wrist_pose'.*RigidTransform",
        ),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, options, message):
    """Key, port and sizes are in the message."""
    world = World().finalize()
    with pytest.raises(ScenarioError, match=message):
        world.record(tmp_path / "no.rrd", **options(world))


def test_an_unfinalized_plant_is_refused(tmp_path):
    """Its bodies are not all there yet."""
    with pytest.raises(ScenarioError, match="finalized"):
        World().record(tmp_path / "no.rrd")


def test_the_role_chooses_the_geometry(tmp_path):
    """Proximity geometry can be recorded instead of what is there for the eye."""
    world = World().finalize().record(tmp_path / "role.rrd", role=Role.kProximity)
    world.recorder.close()
    found = entities(world.recorder.path)
    assert "/world/ball/body/ellipsoids" in found
    assert "/world/arm/upper/capsules" not in found


def test_a_screenshot_is_a_picture_or_a_reason(tmp_path):
    """Without a graphics driver the error says what to install; a missing file is named."""
    world = World().finalize().record(tmp_path / "seen.rrd")
    with world.recorder:
        world.simulator.AdvanceTo(0.1)
    picture = tmp_path / "pictures" / "seen.png"
    with pytest.raises(RecordingError, match="no such recording"):
        take_screenshot(tmp_path / "missing.rrd", picture)
    try:
        take_screenshot(world.recorder.path, picture, size=(320, 240))
    except RecordingError as error:
        assert "mesa-vulkan-drivers" in str(error)
        assert not picture.exists()
    else:
        assert picture.read_bytes().startswith(b"\x89PNG")

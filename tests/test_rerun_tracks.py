"""Signals, states, hands, points, cameras and contact forces in a recording."""

import io

import numpy as np
import pytest
from PIL import Image
from pydrake.common.value import AbstractValue
from pydrake.geometry import ClippingRange, ColorRenderCamera, RenderCameraCore
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import FixedOffsetFrame
from pydrake.systems.framework import LeafSystem
from pydrake.systems.sensors import CameraInfo, ImageRgba8U
from rerun_world import GRAVITY, MASS, World, constant, entities, pose_source, read, steps
from scipy.spatial.transform import Rotation

from geort_drake.errors import ScenarioError
from geort_drake.people.keypoints import BONES
from geort_drake.rerun import (
    CameraSpec,
    CloseUpSpec,
    ContactSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    StateSpec,
)


def test_signals_are_grouped_by_the_part_before_the_slash(tmp_path):
    """Each group is one entity with its own named series."""
    world = World().finalize()
    port = steps(world.builder, [0, 0.05, 1], [[1, 2, 2], [3, 4, 4], [5, 6, 6]])
    names = ["index/a", "thumb/b", "index/c"]
    world.record(tmp_path / "s.rrd", specs={"joints/command": SignalSpec(port, names, "command")}, until=0.08)
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
    world.record(
        tmp_path / "p.rrd", specs={"phase": StateSpec(port, ["reach", "grasp"])}, period=0.05, until=0.4
    )
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


def test_points_follow_the_frame_they_are_measured_in(tmp_path):
    """Coordinates in a moving frame are drawn in the world; points with a NaN are left out."""
    world = World(height=2.0)
    offset = RigidTransform(RollPitchYaw(0, np.pi / 2, 0), [0, 0, 0.1])
    frame = world.plant.AddFrame(FixedOffsetFrame("F", world.ball.body_frame(), offset))
    world.finalize()
    port = constant(world.builder, [0.5, 0, 0, np.nan, 0, 0])
    world.record(tmp_path / "pts.rrd", specs={"goal": PointsSpec(port, frame=frame)})
    world.simulator.AdvanceTo(0.2)
    p_WB = world.plant.EvalBodyPoseInWorld(world.context, world.ball).translation()
    world.recorder.close()
    _, points = read(world.recorder.path, "/world/goal", "Points3D:positions")
    # Pitch by a right angle turns x to -z.
    np.testing.assert_allclose(points[-1], [p_WB + [0, 0, 0.1 - 0.5]], atol=1e-6)


def test_points_of_several_colours_keep_theirs(tmp_path):
    """One that is not a number takes its colour along; points of glass are ellipsoids."""
    world = World().finalize()
    port = constant(world.builder, [1, 0, 0, np.nan, 0, 0, 3, 0, 0])
    colors = [(255, 0, 0, 100), (0, 255, 0, 100), (0, 0, 255, 100)]
    points = {"glass": PointsSpec(port, radius=0.02, color=colors)}
    world.record(tmp_path / "c.rrd", specs=points, until=0.04)
    _, found = read(world.recorder.path, "/world/glass", "Ellipsoids3D:centers")
    np.testing.assert_allclose(found[-1], [[1, 0, 0], [3, 0, 0]])
    _, shades = read(world.recorder.path, "/world/glass", "Ellipsoids3D:colors")
    assert shades[-1].tolist() == [0xFF000064, 0x0000FF64]
    _, sizes = read(world.recorder.path, "/world/glass", "Ellipsoids3D:half_sizes")
    np.testing.assert_allclose(sizes[-1], np.full((2, 3), 0.02), rtol=1e-6)


def test_derived_values_are_computed_on_writing(tmp_path):
    """From several ports, for all samples at once; a shared port is read once."""
    world = World(height=2.0).finalize()
    one = steps(world.builder, [0, 0.1, 1], [[1, 2, 2], [3, 4, 4]])
    other = constant(world.builder, [10])
    world.record(
        tmp_path / "d.rrd",
        period=0.05,
        specs={
            "one/raw": SignalSpec(one, ["a", "b"]),
            "one/sum": SignalSpec([one, other], ["a", "b"], derive=lambda v: v[:, :2] + v[:, 2:]),
        },
        until=0.12,
    )
    inputs = [world.recorder.get_input_port(i).get_name() for i in range(world.recorder.num_input_ports())]
    assert inputs == ["body_poses", "contact_results", "one/raw", "one/sum/1"]
    _, found = read(world.recorder.path, "/one/sum", "Scalars:scalars")
    np.testing.assert_allclose(found, [[11, 13], [11, 13], [12, 14]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            lambda w: {"specs": {"q": SignalSpec(constant(w.builder, [1, 2]), ["a"])}},
            "'q'.*size 2, but 1 names",
        ),
        (
            lambda w: {"specs": {"x": SignalSpec(pose_source(w.builder, RigidTransform()), ["a"])}},
            "'x'.*is abstract; expected a vector",
        ),
        (
            lambda w: {"specs": {"q": SignalSpec(constant(w.builder, [1, 2]), ["a"], derive=lambda x: x)}},
            r"'q'.*derive makes \(1, 2\) of \(1, 2\) values; expected \(1, 1\)",
        ),
        (
            lambda w: {"close_ups": {"c": CloseUpSpec("left", (1, 0, 0))}},
            "close-up 'c' follows the hand 'left'; the recorded hands are: none",
        ),
        (
            lambda w: {"specs": {"h": HandSpec(constant(w.builder, [0] * 63), constant(w.builder, [0]))}},
            "'h/wrist_pose'.*RigidTransform",
        ),
    ],
)
def test_ports_that_do_not_fit_are_refused(tmp_path, options, message):
    """Key, port and sizes are in the message, and nothing has been added."""
    world = World().finalize()
    options = options(world)
    systems = world.builder.GetSystems()
    with pytest.raises(ScenarioError, match=message):
        world.record(tmp_path / "no.rrd", **options)
    assert world.builder.GetSystems() == systems


class RedCamera(LeafSystem):
    """Has what a recorder asks an `RgbdSensor` for, and needs no graphics driver: it sees red."""

    def __init__(self, X_BC):
        super().__init__()
        core = RenderCameraCore("red", CameraInfo(64, 48, np.pi / 4), ClippingRange(0.1, 9), X_BC)
        self._camera = ColorRenderCamera(core)
        self.pictures = 0
        self.DeclareAbstractInputPort("X_WB", AbstractValue.Make(RigidTransform()))
        self.DeclareAbstractOutputPort(
            "color_image", lambda: AbstractValue.Make(ImageRgba8U(64, 48)), self._see
        )
        self.DeclareAbstractOutputPort(
            "body_pose_in_world", lambda: AbstractValue.Make(RigidTransform()), self._stand
        )

    def _see(self, _context, image):
        self.pictures += 1
        image.get_mutable_value().mutable_data[:] = [255, 0, 0, 255]

    def _stand(self, context, X_WB):
        X_WB.set_value(self.GetInputPort("X_WB").Eval(context))

    def default_color_render_camera(self):
        return self._camera

    def color_image_output_port(self):
        return self.GetOutputPort("color_image")

    def body_pose_in_world_output_port(self):
        return self.GetOutputPort("body_pose_in_world")


def test_cameras_give_images_and_poses(tmp_path):
    """A picture is taken at most once per period of its own, and is not rendered in between."""
    world = World().finalize()
    X_WB = RigidTransform(RollPitchYaw(np.pi, 0, 0.3), [0, 0, 0.2])
    X_BC = RigidTransform([0.01, 0, 0])
    sensor = world.builder.AddSystem(RedCamera(X_BC))
    world.builder.Connect(pose_source(world.builder, X_WB), sensor.get_input_port())
    world.record(
        tmp_path / "camera.rrd", specs={"eye": CameraSpec(sensor, period=0.1)}, period=0.05, until=0.4
    )
    times, pictures = read(world.recorder.path, "/world/eye", "EncodedImage:blob")
    np.testing.assert_allclose(times, np.arange(5) * 0.1, atol=1e-9)
    assert sensor.pictures == 5
    picture = Image.open(io.BytesIO(np.asarray(pictures[-1][0], dtype=np.uint8).tobytes()))
    assert picture.size == (64, 48)
    np.testing.assert_allclose(np.asarray(picture).reshape(-1, 3).mean(axis=0), [255, 0, 0], atol=3)
    _, p_WC = read(world.recorder.path, "/world/eye", "Transform3D:translation")
    np.testing.assert_allclose(p_WC[-1][0], (X_WB @ X_BC).translation(), atol=1e-6)
    _, size = read(world.recorder.path, "/world/eye", "Pinhole:resolution")
    assert size[0].tolist() == [[64, 48]]


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

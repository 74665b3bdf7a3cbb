"""The live page's server: its scene, its gates, broken connections, and whole sessions over sockets."""

import asyncio
import contextlib
import dataclasses as dc
import functools
import json
import random
import signal
import socket
import ssl
import time
from pathlib import Path

import aiohttp
import numpy as np
import pytest
import trimesh
from faults.sound import map_file
from live_messages import headset, hello, station
from live_page import live_program
from pydrake.geometry import Mesh, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake import Recording, load_hand, load_scenario
from geort_drake.errors import LiveError
from geort_drake.hands.assembly import add_hand_model
from geort_drake.live.robots import SimulatedRobot
from geort_drake.live.transports import wait_for
from geort_drake.live.web import serve
from geort_drake.live.web.messages import MAX_BYTES
from geort_drake.live.web.scene import PageScene, measured_poses
from geort_drake.live.web.serve import find_page, host_names, is_loopback, self_signed_context
from geort_drake.live.web.server import WebServer
from geort_drake.simulation.following import RobotModel
from geort_drake.systems.port_values import pose_to_vector

KEY = "a-secret"
PATIENCE_S = 120.0  # a busy machine takes long to start a program


@contextlib.contextmanager
def serving(page=Path(__file__).parent, tls=None):
    operated = station()
    server = WebServer(operated, "127.0.0.1", 0, KEY, page, tls)
    try:
        yield server, operated, f"{'https' if tls else 'http'}://127.0.0.1:{server.port}"
    finally:
        server.close()


async def greet(page) -> dict:
    """Asks for the controls; the first answer comes before and tells what the robot is."""
    assert (await page.receive_json(timeout=PATIENCE_S))["role"] == "spectator"
    await page.send_str(hello())
    return await page.receive_json(timeout=PATIENCE_S)


@contextlib.asynccontextmanager
async def page_of(base: str, **options):
    """A page's connection, with options of `ws_connect`."""
    async with aiohttp.ClientSession() as session:
        async with session.ws_connect(f"{base}/ws?key={KEY}", **options) as page:
            yield page


def asynchronous(test):
    """Lets a test be a coroutine function."""
    return functools.wraps(test)(lambda *given, **named: asyncio.run(test(*given, **named)))


@asynchronous
async def test_the_built_page_is_served_and_loads_nothing_from_elsewhere(tmp_path):
    (tmp_path / "index.html").write_text("a page")
    (tmp_path / "app.js").write_text("a script")
    with serving(tmp_path) as (server, _, base):
        server.show(b'{"scene": 7}', [b"triangles"])
        async with aiohttp.ClientSession() as session:
            for path, expected in (("/", "a page"), ("/app.js", "a script"), ("/mesh/0", "triangles")):
                async with session.get(base + path) as answer:
                    assert await answer.text() == expected
                    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            async with session.get(base + "/scene") as answer:
                assert (await answer.json())["scene"] == 7
            for path in ("/mesh/1", "/..%2f..%2fetc/passwd", "/none.js"):
                async with session.get(base + path) as answer:
                    assert answer.status == 404


def test_the_page_is_taken_from_the_package_or_the_clone_and_its_absence_is_told_with_the_mend(
    tmp_path, monkeypatch
):
    """Before anything is served: a wheel that was built without Node.js has no page."""
    installed, clone = tmp_path / "site-packages/static", tmp_path / "clone"
    monkeypatch.setattr(serve, "_PAGE", installed)
    (clone / "docs").mkdir(parents=True)
    monkeypatch.chdir(clone / "docs")
    with pytest.raises(LiveError, match=r"Install Node\.js 20 .* `make live`"):
        find_page()
    built = clone / "geort_drake/live/web/static"
    for page in (built, installed):
        page.mkdir(parents=True)
        (page / "index.html").write_text("a page")
        assert find_page() == page


@asynchronous
async def test_a_wrong_key_a_foreign_page_and_a_ninth_connection_are_turned_away():
    with serving() as (server, _, base):
        async with aiohttp.ClientSession() as session, contextlib.AsyncExitStack() as stack:

            async def status(key: str, origin: str | None = None) -> int:
                headers = {"Origin": origin} if origin else {}
                try:
                    async with session.ws_connect(f"{base}/ws?key={key}", headers=headers) as page:
                        return 101 if not page.closed else 0
                except aiohttp.WSServerHandshakeError as error:
                    return error.status

            assert await status("") == await status("another") == await status("é") == 403
            assert await status(KEY, "http://evil.example") == 403
            assert await status(KEY, f"https://127.0.0.1:{server.port}") == 403
            assert await status(KEY, base) == await status(KEY) == 101
            for _ in range(8):
                await stack.enter_async_context(page_of(base))
            assert await status(KEY) == 503


def test_a_port_in_use_is_an_error_in_words():
    with serving() as (server, station, _):
        with pytest.raises(LiveError, match=str(server.port)):
            WebServer(station, "127.0.0.1", server.port, KEY, Path(__file__).parent)


@asynchronous
async def test_beyond_this_machine_there_is_a_certificate():
    assert is_loopback("127.0.0.1") and is_loopback("::1") and is_loopback("localhost")
    assert not is_loopback("0.0.0.0") and not is_loopback("192.168.1.2") and not is_loopback("desk.local")
    assert "0.0.0.0" not in host_names("0.0.0.0")
    with serving(tls=self_signed_context(["127.0.0.1", "desk.local"])) as (server, _, base):
        async with page_of(base, ssl=False) as page:
            assert (await greet(page))["role"] == "operator"
        with pytest.raises(aiohttp.ClientConnectorCertificateError):
            async with page_of(base):
                pass
        certificate = ssl.get_server_certificate(("127.0.0.1", server.port))
        assert "BEGIN CERTIFICATE" in certificate


@asynchronous
async def test_states_and_frames_reach_the_page_and_refusals_are_few():
    with serving() as (server, station, base):
        async with page_of(base) as page:
            await greet(page)
            began, told = time.monotonic(), []
            for _ in range(50):
                await page.send_str("nonsense")
            while station.refused < 50:
                await asyncio.sleep(0.01)
            server.publish('{"type": "state"}', b"poses")
            while (message := await page.receive()).type == aiohttp.WSMsgType.TEXT:
                told.append(json.loads(message.data)["type"])
            assert message.type == aiohttp.WSMsgType.BINARY
            assert told.pop() == "state" and {*told} == {"refused"}
            assert len(told) <= 1 + time.monotonic() - began  # one a second


@pytest.mark.parametrize("fault", ["a long message", "a flood"])
@asynchronous
async def test_who_sends_too_much_is_disconnected_and_leaves_the_controls(fault):
    with serving() as (server, station, base):
        async with page_of(base) as page:
            await greet(page)

            async def speak():
                while True:
                    await page.send_str("x" if fault == "a flood" else "x" * (MAX_BYTES + 1))
                    await asyncio.sleep(0)

            speaking = asyncio.create_task(speak())
            while not page.closed:
                await page.receive()
            speaking.cancel()
            assert page.close_code in (1008, 1009, 1006)
        wait_for(lambda: station.operator is None, PATIENCE_S, lambda: "it still has the controls")
        assert (server.dropped == 1000) == (fault == "a flood")


@asynchronous
async def test_a_hundred_broken_connections_leave_the_server_serving():
    """Garbage, half a handshake, frames that are none, and connections that end in the middle."""
    rng = random.Random(1)
    with serving() as (server, station, base):
        upgrade = (
            f"GET /ws?key={KEY} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        ).encode()
        for number in range(100):
            with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S) as wire:
                first = (rng.randbytes(50), upgrade[: rng.randrange(len(upgrade))], upgrade)[number % 3]
                wire.sendall(first)
                if first is upgrade:
                    wire.recv(4096)
                    wire.sendall(rng.randbytes(30))
                if number % 2:  # the end comes as a reset
                    wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        async with asyncio.timeout(PATIENCE_S), page_of(base) as page:
            assert (await greet(page))["role"] == "operator"
        wait_for(lambda: station.spectators == 0, PATIENCE_S, lambda: "they still look on")


def test_the_scene_holds_every_body_that_moves_and_frames_follow_it():
    scenario = load_scenario()
    description = load_hand(scenario.hand)
    robot = SimulatedRobot(scenario, RobotModel(scenario, description))
    plant, body = robot.stage.plant, robot.stage.handled.body
    inspector = robot.stage.scene_graph.model_inspector()
    scene = PageScene(plant, inspector, dc.replace(description, side="left"))
    facts = json.loads(json.dumps(scene.description))
    names, looks = facts["moving"], facts["geometries"]
    assert names[facts["hand_base"]["moving"]].startswith("hand::")
    assert {look["moving"] for look in looks} - {None} == {*range(len(names))}
    points, root = np.arange(63.0).reshape(21, 3), robot.diagram.CreateDefaultContext()
    robot.stage.initialize(root)
    X_WO = plant.GetDefaultFloatingBaseBodyPose(body)
    link = plant.GetBodyByName("link_15").EvalPoseInWorld(plant.GetMyContextFromRoot(root))
    poses = robot.diagram.GetOutputPort("body_poses").Eval(root)
    first = np.frombuffer(scene.frame(0.0, poses, points), "<f4")
    assert len(first) == 1 + 7 * len(names) + 63
    for name, X in (("hand::link_15", link), ("cylinder::cylinder", X_WO)):
        begin = 1 + 7 * names.index(name)
        np.testing.assert_allclose(first[begin : begin + 7], pose_to_vector(X), atol=1e-6)
    # A left hand is no longer its mirror image.
    np.testing.assert_array_equal(first[-63:].reshape(21, 3), points * [1, -1, 1])


def test_a_mesh_is_served_as_triangles_in_drakes_axes(tmp_path):
    """In metres at the mesh's scale; one that cannot be read as its convex hull."""
    trimesh.creation.box((1.0, 2.0, 3.0)).export(tmp_path / "box.obj")
    description = load_hand("allegro_right")
    builder = DiagramBuilder()
    plant, graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    hand = add_hand_model(plant, description, "hand")
    body = plant.GetBodyByName("link_0", hand)
    box = Mesh(str(tmp_path / "box.obj"), 0.1)
    plant.RegisterVisualGeometry(body, RigidTransform(), box, "box", np.ones(4))
    plant.RegisterVisualGeometry(plant.world_body(), RigidTransform(), Sphere(0.1), "sun", np.ones(4))
    plant.Finalize()
    scene = PageScene(plant, graph.model_inspector(), description)
    used = {geometry["moving"] for geometry in scene.description["geometries"]}
    assert used == {None, *range(len(scene.moving))}  # also what does not move
    shape = next(g for g in scene.description["geometries"] if g["shape"] == "mesh")
    assert shape["url"] == "/mesh/0"
    triangles = np.frombuffer(scene.meshes[0], "<f4").reshape(-1, 3, 3)
    np.testing.assert_allclose(triangles.max(axis=(0, 1)), [0.05, 0.1, 0.15], atol=1e-6)


def test_a_real_robots_bodies_are_where_its_joints_say():
    scenario = load_scenario()
    description = load_hand(scenario.hand)
    model = RobotModel(scenario, description)
    plant = model.standing_at({}).plant()
    q_arm = model.arm.start + 0.1
    joints = {model.hand.name: model.hand.start, model.arm.name: q_arm}
    poses = measured_poses(plant)({name: np.concatenate([q, 0 * q]) for name, q in joints.items()})
    moved = model.standing_at(dict(zip(model.arm.joints, q_arm.tolist(), strict=True))).plant()
    link = moved.GetBodyByName("panda_link7")
    X_WB = moved.EvalBodyPoseInWorld(moved.CreateDefaultContext(), link)
    np.testing.assert_allclose(poses[link.index()].GetAsMatrix34(), X_WB.GetAsMatrix34(), atol=1e-9)


def test_a_session_is_engaged_recorded_and_reset_from_the_page(tmp_path):
    """The command, driven by a page that sends a headset's joints; `grasp --replay` replays the recording."""
    map_file(tmp_path)
    # The page's script is not needed, which is there only where Node.js is.
    page = tmp_path / "geort_drake/live/web/static"
    page.mkdir(parents=True)
    (page / "index.html").write_text("a page")
    with live_program(tmp_path, "--retargeter", str(tmp_path / "map.safetensors")) as (program, address, key):
        scenes = asyncio.run(_drive(f"{address}/ws?key={key}"))
        program.send_signal(signal.SIGINT)
        out, log = program.communicate(timeout=3 * PATIENCE_S)
    assert program.returncode == 0, log
    assert scenes == {1, 2, 3, 4}
    report = json.loads(out)
    assert report["states"]["tracking"] > 0.5 and report["glove"]["received"] > 50
    (file,) = (tmp_path / "runs" / "live").glob("*.npz")
    recording = Recording.load(file)
    assert recording.valid.sum() > 50
    facts = recording.metadata
    assert facts["consent"] and facts["object"] == "sphere" and facts["device"] == "scripted"
    assert facts["outcome"]["phase"] == "reach" and facts["delay"]["count"] > 20


async def _drive(address: str) -> set[int]:
    """Engages, records until the robot follows for a while, and resets with another object and task."""
    scenes: set[int] = set()
    state: dict = {}
    robot: dict = {}

    async with aiohttp.ClientSession() as session, session.ws_connect(address) as page:

        async def read():
            async for message in page:
                if message.type == aiohttp.WSMsgType.TEXT and '"welcome"' in message.data:
                    robot.update(json.loads(message.data))
                if message.type == aiohttp.WSMsgType.TEXT and '"state"' in message.data:
                    state.update(json.loads(message.data))
                    scenes.add(state["scene"])

        reader = asyncio.create_task(read())
        await page.send_str(hello())
        number = 0

        async def send_until(holds, *commands: dict) -> None:
            nonlocal number
            deadline = time.monotonic() + PATIENCE_S
            while not holds():
                assert time.monotonic() < deadline, state
                await page.send_str(headset(number % 360, time.monotonic()))
                number += 1
                if number > 10 and commands:
                    await page.send_str(json.dumps(commands[0]))
                    commands = commands[1:]
                await asyncio.sleep(1 / 60)

        await send_until(lambda: state.get("scene") == 1)
        await send_until(lambda: state["scene"] == 2, {"type": "reset", "object": "sphere"})
        await send_until(lambda: state.get("recording"), {"type": "engage"}, {"type": "record", "keep": True})
        await send_until(lambda: state["following"] and state["time"] > 2.0)
        await send_until(lambda: state["scene"] == 3, {"type": "stop"}, {"type": "reset", "task": "keys"})
        assert (state["task"], state["object"], state["outcome"]["phase"]) == ("keys", "keys", "none")
        assert (robot["mount"], state["mount"]) == ("arm", "floating")  # keys have no arm
        assert not state["engaged"] and state["recording"] is None
        await send_until(lambda: state["scene"] == 4, {"type": "reset", "mount": "floating"})
        assert (
            robot["mount"] == "floating"
            and robot["hands"] == []
            and (state["task"], state["object"]) == ("grasp", "cylinder")
        )
        reader.cancel()
    return scenes

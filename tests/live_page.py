"""Chromium with the live web page, a server for the page alone, and a person who sees only the page."""

import base64
import dataclasses as dc
import functools
import http.server
import itertools
import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_messages import joints_of
from pydrake.math import RigidTransform

from geort_drake import load_hand
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.person.engine import Person
from geort_drake.simulation.person.handling import GRASP
from geort_drake.simulation.person.perception import Percept
from geort_drake.systems.port_values import vector_to_pose

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "geort_drake" / "live" / "web" / "static"
WEB = ROOT / "web"
CHROMIUM = Path("/usr/bin/chromium")
# WebGL without a GPU, by Chromium's own software renderer. Pages are composed by the simpler one, as GL in
# software would take half as long again.
_SOFTWARE_GL = (
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    "--disable-gpu-compositing",
)
# The page gets the camera without a question.
_FAKE_CAMERA = ("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream")


def require_page() -> None:
    """Skips the test where the browser, its driver or the built page is absent."""
    pytest.importorskip("playwright", reason="needs Playwright for Python")
    if not CHROMIUM.is_file():
        pytest.skip(f"needs {CHROMIUM}")
    require_built_page()


def require_built_page() -> None:
    """Skips the test where the page has not been built."""
    if not (PAGE / "main.js").is_file():
        pytest.skip("needs the built page: `make live`")


def require_package(name: str) -> None:
    """Skips the test where a package that only tests need is absent."""
    if not (WEB / "node_modules" / name).is_dir():
        pytest.skip(f"needs the npm package {name}: `make live NPM_ARGS=`")


def launch(playwright, clip: Path | None = None, *flags: str):
    """Starts a browser with Chromium's `flags`; its camera plays `clip`, or it has none."""
    camera = [*_FAKE_CAMERA, f"--use-file-for-fake-video-capture={clip}"] if clip else []
    return playwright.chromium.launch(executable_path=str(CHROMIUM), args=[*_SOFTWARE_GL, *flags, *camera])


def new_page(browser, **options):
    """A page that waits long, as a busy machine takes long."""
    page = browser.new_page(**options)
    page.set_default_timeout(120_000)
    return page


@contextmanager
def live_program(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen, str, str]]:
    """Runs the command `live` in a folder; yields its process, the page's address and the key to it."""
    command = [
        sys.executable,
        "-m",
        "geort_drake",
        "live",
        "--no-open",
        "--port",
        "0",
        "--json",
        "-",
        *options,
    ]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=folder, **pipes) as program:
        try:
            log: list[str] = []
            for line in program.stderr:
                log.append(line)
                if "Hold up your hand" in line:
                    break
            else:
                raise RuntimeError(f"`live` ended before it served its page: {''.join(log)}")
            yield program, *re.search(r"(http://\S+)/#(\S+)", line).groups()
        finally:
            program.kill()


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Serves a folder's files at the address that it yields."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


TASKS = {"grasp": ["cylinder", "sphere"], "keys": ["keys"]}
WORDS = {"grasp": "lift an object", "keys": "press a key"}
ABOUT = RobotInfo("right", "allegro_right", "simulation", TASKS, "universal map", WORDS)
WELCOME = OperatorStation(ABOUT).join(1) | {"role": "operator"}
# What the server sends of a session, and its scene.
STATE, SCENE = json.loads((WEB / "test" / "messages.json").read_text("utf-8")).values()


@dc.dataclass
class StubServer:
    """The server's end of the page's WebSocket."""

    messages: list[dict] = dc.field(default_factory=list)
    requests: list[str] = dc.field(default_factory=list)
    socket: object = None
    silent: bool = False  # at first

    def attach(self, page, scene: dict = SCENE) -> None:
        page.on("request", lambda request: self.requests.append(request.url))
        page.route("**/scene", lambda route: route.fulfill(json=scene))
        page.route_web_socket("**/ws?key=*", self._open)

    def send(self, **state) -> None:
        self.socket.send(json.dumps({**STATE, **state}))

    def send_poses(self, poses: np.ndarray, p_BK: np.ndarray) -> None:
        self.socket.send(np.concatenate([[0.0], poses.ravel(), p_BK.ravel()]).astype("<f4").tobytes())

    def welcome(self, **changes) -> None:
        self.socket.send(json.dumps({**WELCOME, **changes}))

    def of(self, kind: str) -> list[dict]:
        return [message for message in self.messages if message["type"] == kind]

    def _open(self, socket) -> None:
        self.socket = socket
        socket.on_message(lambda text: self._receive(json.loads(text)))
        if not self.silent:
            self.welcome(role="spectator")

    def _receive(self, message: dict) -> None:
        self.messages.append(message)
        if message["type"] == "hello":
            self.welcome()
            self.send()


FLAT = {"curl": [0.15, 0.1, 0.1, 0.15], "thumb": [0.0, 0.0, 0.0, 0.0, 0.0], "turn": [0.0, 0.3, 0.0]}
PINCH = {"curl": [0.8, 0.15, 0.1, 0.1], "thumb": [-0.44, 0.15, -0.03, 0.36, 0.09], "turn": [0.0, 0.3, 0.0]}
CURL = {"curl": [0.8, 0.8, 0.8, 0.8], "thumb": [0.0, 0.0, 0.0, 0.0, 0.0], "turn": [0.2, 0.3, 0.1]}


def film_hand(browser, file: Path, pictures: int = 4, repeats: int = 3) -> np.ndarray:
    """Films the rendered hand as it pinches and curls, into Motion JPEG at 30 pictures a second.

    Each of a movement's `pictures` comes `repeats` times. A row of squares in it is its number in binary.

    Returns:
        The joints in each picture, (T, 25, 3), m, in the order of XRHand.
    """
    joints = []
    stops = [FLAT, PINCH, PINCH, FLAT, CURL, FLAT]
    with serve(WEB) as address, file.open("wb") as film:
        page = new_page(browser)
        page.goto(f"{address}/test/hand.html")
        page.wait_for_function("window.ready")
        for begin, end in itertools.pairwise(stops):
            for share in (1 - np.cos(np.linspace(0, np.pi, pictures, endpoint=False))) / 2:
                posture = {
                    name: ((1 - share) * np.array(begin[name]) + share * np.array(end[name])).tolist()
                    for name in begin
                }
                joints.append(page.evaluate("posture => pose(posture)", posture))
                picture = page.evaluate("number => draw(number)", len(joints) - 1).split(",")[1]
                film.write(repeats * base64.b64decode(picture))
        page.close()
    return np.array(joints)


FRAME_S = 1.0 / 30.0
# From a hand to its picture on a busy machine; the person judges a movement after that.
DELAY_S = 12 * FRAME_S
TOUCHING_M = 1e-3  # gap between a fingertip and the object that no picture shows


class PagePerson:
    """Decides after the page's frames how to move.

    Args:
        scene: contents of `/scene`.
        hand: name of the robot's hand, as in `welcome`.
        thing: name of the object, as in `state`.
        goal: of the grasp.
    """

    def __init__(self, scene: dict, hand: str, thing: str, goal):
        names = scene["moving"]
        self._base, self._X_LB = scene["hand_base"]["moving"], vector_to_pose(scene["hand_base"]["pose"])
        self._object = names.index(f"{thing}::{thing}")
        self._tips = [(names.index(f"hand::{f.tip_link}"), f.tip_point) for f in load_hand(hand).fingers]
        self._tip_radii = np.array([f.tip_radius for f in load_hand(hand).fingers])
        self._radius = next(g["size"][0] for g in scene["geometries"] if g["moving"] == self._object)
        self._bodies = len(names)
        config = OperatorConfig(period=FRAME_S, visual_delay=DELAY_S, contact_noise=0.0, visual_noise=0.0,
                                visual_depth_noise=0.0, visual_turn_noise=0.0, motor_noise=0.0,
                                correction_rate=2.0)  # fmt: skip
        self._hand = HumanHand.anatomical()
        self._rng = np.random.default_rng(0)
        self._person = Person(self._hand, goal, GRASP, "servo", config, None, self._rng)
        self._tremor = config.tremor
        self._state = None

    @property
    def phase(self) -> str:
        """What the person is doing."""
        return self._person.phases[self._state.phase].name if self._state else "waiting"

    def hand(self, frames: list[bytes], following: bool) -> list[list[float]]:
        """The joints of a headset after these frames; at rest while the page says that the robot waits."""
        for frame in frames:
            values = np.frombuffer(frame, "<f4").astype(float)
            poses = values[1 : 1 + 7 * self._bodies].reshape(-1, 7)
            X_WB = vector_to_pose(poses[self._base]) @ self._X_LB
            if self._state is None:
                self._state = self._person.start(RigidTransform(X_WB.rotation(), np.zeros(3)))
            if following:
                tips = [vector_to_pose(poses[body]) @ np.array(point) for body, point in self._tips]
                X_WO = vector_to_pose(poses[self._object])
                seen = Percept(np.array(tips), X_WB, X_WO, self._touching(np.array(tips), X_WO))
                self._state = self._person.step(self._state, values[0], seen)
        p_HK = self._hand.keypoints(self._state.theta)
        p_HK[1:] += self._rng.normal(0.0, self._tremor, (20, 3))
        return joints_of(self._state.X_WH.multiply(p_HK.T).T)

    def _touching(self, p_WF: np.ndarray, X_WO: RigidTransform) -> np.ndarray:
        """A force of 3 N, or none, at each fingertip as the picture shows it on the upright object or not."""
        across = np.linalg.norm((p_WF - X_WO.translation())[:, :2], axis=1)
        return np.where(across - self._radius - self._tip_radii < TOUCHING_M, 3.0, 0.0)

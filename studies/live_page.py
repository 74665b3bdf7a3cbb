"""Makes the docs' film of the live page: a scripted hand that sees only the page grasps the cylinder.

python studies/live_page.py --output docs/images

The simulation is stepped between pictures, so any machine gives the same film. The camera shows a rendered
hand, which the page tracks, but the script's exact joints move the robot. Needs Chromium and
`make live NPM_ARGS=`. `--states DIR` also writes pictures of the page's states, light and dark, on desktop
and phone.
"""

import argparse
import io
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from grasp_setup import planned_goal  # noqa: E402
from live_page import FLAT, PINCH, WEB, PagePerson, launch, serve  # noqa: E402
from pydrake.systems.analysis import Simulator  # noqa: E402

from geort_drake.hands.description import load_hand  # noqa: E402
from geort_drake.live.glove_stream import HANDSHAKE_FRAMES  # noqa: E402
from geort_drake.live.teleoperation import RobotModel  # noqa: E402
from geort_drake.live.web.control import PageControl  # noqa: E402
from geort_drake.live.web.messages import Engage, Guide  # noqa: E402
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo  # noqa: E402
from geort_drake.live.web.personal_map import PersonalMap  # noqa: E402
from geort_drake.live.web.server import WebServer  # noqa: E402
from geort_drake.live.web.session import WebTeleoperation  # noqa: E402
from geort_drake.retargeting.retargeter import load_retargeter  # noqa: E402
from geort_drake.simulation.scenario_files import load_scenario  # noqa: E402
from geort_drake.simulation.tasks import find_task, task_names  # noqa: E402

STEP_S, FILM_HZ = 1.0 / 60.0, 6.0
PATIENCE_MS = 300_000.0
SIZE, WIDTH, QUALITY = (1040, 660), 720, 50
PHONE = {"width": 390, "height": 844}
TASKS = {name: find_task(name).cases() for name in task_names()}
SCRIPTS = """
  const parameter = WebGL2RenderingContext.prototype.getParameter;
  WebGL2RenderingContext.prototype.getParameter = function (name) {
    return name === 37446 ? "a GPU" : parameter.call(this, name);
  };
  const canvas = Object.assign(document.createElement("canvas"), { width: 640, height: 480 });
  const context = canvas.getContext("2d");
  const picture = new Image();
  picture.onload = () => context.drawImage(picture, 0, 0);
  window.film = (url) => (picture.src = url);
  setInterval(() => context.drawImage(picture, 0, 0), 300);
  navigator.mediaDevices.getUserMedia = async () => canvas.captureStream(3);
"""
# Reads the first canvas; `draw` writes its number only into a copy of it.
DRAW = "(draw(0), document.querySelector('canvas').toDataURL('image/jpeg', 0.92))"


class ScriptedStation(OperatorStation):
    """A station where the page is the operator but the script moves the hand."""

    def take(self, person, text):
        return None if '"camera"' in text[:60] or '"lost"' in text[:60] else super().take(person, text)

    def lose(self) -> None:
        super().take(self.operator.number, json.dumps({"type": "lost", "t": time.monotonic()}))

    def move(self, joints) -> None:
        hand = {"type": "headset", "t": time.monotonic(), "joints": joints}
        super().take(self.operator.number, json.dumps(hand))


class Theatre:
    """The simulation, its server and the page, advanced together."""

    def __init__(self, browser, folder: Path):
        self.scenario = load_scenario()
        about = RobotInfo("right", self.scenario.hand, "simulation", TASKS, "universal map")
        self.station = ScriptedStation(about, lambda: self.time)
        self.time, self.frames = 100.0, []
        self.server = WebServer(self.station, "127.0.0.1", 0, "key")
        publish = self.server.publish
        self.shown = True

        def shown(state: str | None = None, frame: bytes | None = None) -> None:
            if frame:
                self.frames.append(frame)
            if self.shown:
                publish(state, frame)

        self.server.publish = shown
        retarget = load_retargeter(self.scenario.hand)
        personal_map = PersonalMap(folder, lambda _: retarget)
        self.control = PageControl(self.station, self.server.publish, folder, personal_map, lambda *_: None)
        description = load_hand(self.scenario.hand)
        session = WebTeleoperation(
            {"grasp": self.scenario}, description, RobotModel(self.scenario, description), retarget,
            self.station, self.server, self.control,
        )  # fmt: skip
        self.loop = session._begin(1, 0.0)
        self.simulator = Simulator(self.loop.diagram)
        self.context, self.engaged = self.simulator.get_mutable_context(), False
        self.loop.simulation.stage.scene.initialize(self.context)
        self.loop.engage(self.context, False)
        with serve(WEB) as address:
            self.hand = browser.new_page()
            self.hand.set_default_timeout(PATIENCE_MS)
            self.hand.goto(f"{address}/test/hand.html")
            self.hand.wait_for_function("window.ready")
        self.page = browser.new_page(viewport=dict(zip(("width", "height"), SIZE, strict=True)))
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.add_init_script(SCRIPTS)
        self.page.goto(f"http://127.0.0.1:{self.server.port}/#key")
        self.person = None

    def show_hand(self, share: float) -> None:
        """Poses the hand in front of the camera, `share` of the way from flat to pinching."""
        posture = {name: (np.array(FLAT[name]) * (1 - share) + np.array(PINCH[name]) * share).tolist()
                   for name in FLAT}  # fmt: skip
        self.hand.evaluate("posture => pose(posture)", posture)
        self.page.evaluate("url => film(url)", self.hand.evaluate(DRAW))

    def step(self, *commands) -> None:
        """Advances by `STEP_S`; the person sees the frames that the page gets."""
        self.station.commands.extend(commands)
        self.control._published = -np.inf
        engaged = self.control.step(self.context, self.engaged)
        if engaged != self.engaged:
            self.engaged = engaged
            self.loop.engage(self.context, engaged)
        self.simulator.AdvanceTo(self.context.get_time() + STEP_S)
        self.time += STEP_S
        if self.frames and self.person:
            frames, self.frames = self.frames, []
            self.station.move(self.person.hand(frames, self.engaged))

    def picture(self, wait_ms: int = 700) -> Image.Image:
        self.page.wait_for_timeout(wait_ms)
        return Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")

    def save(self, folder: Path | None, name: str) -> None:
        """Writes pictures of the present state, light and dark, on desktop and phone."""
        desktop = self.page.viewport_size
        for device, size in (("phone", PHONE), ("desktop", desktop)) if folder else ():
            self.page.set_viewport_size(size)
            for scheme in ("dark", "light"):
                self.page.emulate_media(color_scheme=scheme)
                self.picture(1500).save(folder / f"{name}_{device}_{scheme}.png")


def main(argv: Sequence[str] | None = None) -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--output", type=Path, required=True)
    options.add_argument("--states", type=Path)
    arguments = options.parse_args(argv)
    for made in filter(None, (arguments.output, arguments.states)):
        made.mkdir(parents=True, exist_ok=True)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        theatre = Theatre(launch(playwright), Path(folder))
        page, station = theatre.page, theatre.station
        page.wait_for_selector("body[data-state=waiting]")
        for _ in range(6):
            theatre.step()
        theatre.save(arguments.states, "welcome")
        theatre.show_hand(0.0)
        page.click("#camera")
        page.wait_for_selector("body[data-state=tracking]")
        scene = json.loads(theatre.server._scene)
        theatre.person = PagePerson(scene, theatre.scenario.hand, "cylinder",
                                    planned_goal("cylinder"))  # fmt: skip
        for _ in range(2 * HANDSHAKE_FRAMES + 10):
            theatre.step()
        theatre.step(Guide())
        theatre.save(arguments.states, "guided")
        theatre.control._guide = None
        theatre.step(Engage())
        film, every = [], round(1.0 / (FILM_HZ * STEP_S))
        held = 0
        while not (outcome := theatre.loop.outcome(theatre.context)).over or held < 5:
            held += outcome.over
            # The page gets only the frames that are pictured.
            for number in range(every):
                theatre.shown = number >= every - 2
                theatre.step()
            phase = theatre.person.phase
            theatre.show_hand({"reach": 0.0, "approach": 0.2, "surround": 0.5}.get(phase, 1.0))
            film.append(theatre.picture(100))
            if phase == "hold" and held == 0 and len(film) % 5 == 0:
                theatre.save(arguments.states, "holding")
            print(f"{theatre.context.get_time():.1f} s: {phase}, {outcome.phase.name}", flush=True)
        frames = [one.resize((WIDTH, round(WIDTH * SIZE[1] / SIZE[0])), Image.LANCZOS) for one in film]
        frames[0].save(arguments.output / "live_film.webp", save_all=True, append_images=frames[1:],
                       duration=round(1e3 / FILM_HZ), loop=0, quality=QUALITY, method=6)  # fmt: skip
        page.evaluate("film('')")
        station.lose()
        theatre.person = None
        for _ in range(10):
            theatre.step()
        theatre.save(arguments.states, "held")
        theatre.server.close()


if __name__ == "__main__":
    main()

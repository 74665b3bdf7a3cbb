"""The live web page in Firefox, with its own server and a camera that shows a rendered hand."""

import asyncio
import json

import pytest
from firefox import PATIENCE_S, Firefox, require_firefox
from live_page import FLAT, PINCH, SCENE, STATE, WEB, require_built_page, require_package, serve

from geort_drake.live.web.messages import Disengage, Engage
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.live.web.server import WebServer

# In place of the camera: a canvas that shows the pictures in turns.
CAMERA = """() => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 640, height: 480 });
  const pictures = PICTURES.map((src) => Object.assign(new Image(), { src }));
  const context = canvas.getContext("2d");
  let number = 0;
  setInterval(() => context.drawImage(pictures[number++ % pictures.length], 0, 0, 640, 480), 40);
  navigator.mediaDevices.getUserMedia = async () => canvas.captureStream(25);
}"""


@pytest.fixture
def server():
    require_built_page()
    station = OperatorStation(
        RobotInfo("right", "allegro_right", "simulation", {"grasp": ["cylinder"]}, "a map")
    )
    server = WebServer(station, "127.0.0.1", 0, "key")
    server.show(json.dumps(SCENE).encode(), [])
    yield server, station
    server.close()


def test_firefox_tracks_the_hand_and_engages(tmp_path, server):
    """MediaPipe finds the hand, and the server gets and understands it."""
    require_firefox(with_3d=True)
    require_package("@webxr-input-profiles/assets")
    asyncio.run(_track(tmp_path / "profile", *server))


def test_without_3d_the_page_still_has_words_and_keys(tmp_path, server):
    require_firefox(with_3d=False)
    asyncio.run(_steer(tmp_path / "profile", *server))


async def _steer(profile, server: WebServer, station: OperatorStation) -> None:
    async with Firefox(profile, with_3d=False) as firefox:
        await firefox.open(f"http://127.0.0.1:{server.port}/#key")
        await firefox.until("document.body.dataset.state === 'waiting'")
        assert "no 3D" in await firefox.value("document.querySelector('#blind').innerText")
        server.publish(json.dumps({**STATE, "engaged": True}))
        await firefox.until("document.body.hasAttribute('data-engaged')")
        await firefox.press(" ")
        await _command(station, Disengage)


async def _command(station: OperatorStation, kind: type) -> None:
    """Waits until the page has sent a command."""
    async with asyncio.timeout(PATIENCE_S):
        while not any(isinstance(command, kind) for command in station.commands):
            await asyncio.sleep(0.05)
    assert station.refused == 0


async def _track(profile, server: WebServer, station: OperatorStation) -> None:
    async with Firefox(profile, with_3d=True) as firefox:
        with serve(WEB) as address:
            await firefox.open(f"{address}/test/hand.html")
            await firefox.until("Boolean(window.ready)")
            pictures = []
            for number, posture in enumerate((FLAT, PINCH)):
                await firefox.value(f"void pose({json.dumps(posture)})")
                pictures.append(await firefox.value(f"draw({number})"))
        camera = CAMERA.replace("PICTURES", json.dumps(pictures))
        await firefox.open(f"http://127.0.0.1:{server.port}/#key", camera)
        await firefox.until("document.body.dataset.state === 'waiting'")
        assert "right hand" in await firefox.value("document.querySelector('#headline').innerText")
        server.publish(json.dumps(STATE))
        await firefox.value("document.querySelector('#camera').click()")
        await firefox.until("document.body.dataset.state === 'tracking'")
        async with asyncio.timeout(PATIENCE_S):
            while station.received < 3:
                await asyncio.sleep(0.05)
        await firefox.press(" ")
        await _command(station, Engage)

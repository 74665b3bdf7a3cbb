"""The live web page in Firefox and WebKit, with its own server and a camera that shows a rendered hand."""

import asyncio
import json

import pytest
from browsers import PATIENCE_S, Browser, Firefox, WebKit
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

# Whether the view has anything in it.
DRAWN = """() => {
  const { width, height } = document.querySelector("#view");
  const { data } = document.querySelector("#view").getContext("2d").getImageData(0, 0, width, height);
  return data.some(Boolean);
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


@pytest.mark.parametrize("browser", [Firefox, WebKit])
def test_the_page_tracks_the_hand_and_engages(browser, tmp_path, server):
    """MediaPipe finds the hand, and the server gets and understands it; a headset is excused in words."""
    browser.require()
    require_package("@webxr-input-profiles/assets")
    asyncio.run(_track(browser(tmp_path / "profile"), *server))


def test_without_webgl_the_page_shows_the_scene(tmp_path, server):
    Firefox.require(with_3d=False)
    asyncio.run(_steer(tmp_path / "profile", *server))


async def _steer(profile, server: WebServer, station: OperatorStation) -> None:
    async with Firefox(profile, with_3d=False) as firefox:
        await firefox.open(f"http://127.0.0.1:{server.port}/#key")
        await firefox.until("document.body.dataset.state === 'waiting'")
        server.publish(json.dumps({**STATE, "engaged": True}))
        await firefox.until("document.body.hasAttribute('data-engaged')")
        await firefox.until(f"({DRAWN})()")
        await firefox.press(" ")
        await _command(station, Disengage)


async def _command(station: OperatorStation, kind: type) -> None:
    """Waits until the page has sent a command."""
    async with asyncio.timeout(PATIENCE_S):
        while not any(isinstance(command, kind) for command in station.commands):
            await asyncio.sleep(0.05)
    assert station.refused == 0


async def _track(browser: Browser, server: WebServer, station: OperatorStation) -> None:
    async with browser as page:
        with serve(WEB) as address:
            await page.open(f"{address}/test/hand.html")
            await page.until("Boolean(window.ready)")
            pictures = []
            for number, posture in enumerate((FLAT, PINCH)):
                await page.value(f"void pose({json.dumps(posture)})")
                pictures.append(await page.value(f"draw({number})"))
        await page.open(f"http://127.0.0.1:{server.port}/#key")
        await page.value(f"void ({CAMERA.replace('PICTURES', json.dumps(pictures))})()")
        await page.until("document.body.dataset.state === 'waiting'")
        assert "right hand" in await page.value("document.querySelector('#headline').innerText")
        if isinstance(browser, WebKit):
            assert "no headset" in await page.value("document.querySelector('#no-headset').innerText")
        server.publish(json.dumps(STATE))
        await page.value("document.querySelector('#camera').click()")
        await page.until("document.body.dataset.state === 'tracking'")
        async with asyncio.timeout(PATIENCE_S):
            while station.received < 3:
                await asyncio.sleep(0.05)
        await page.press(" ")
        await _command(station, Engage)

"""The live web page in Firefox and WebKit, with its own server and a rendered hand as the camera."""

import asyncio
import itertools
import json
import os
import re
import shutil
import signal
import socket
import time
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from live_page import FLAT, PAGE, PINCH, SCENE, STATE, WEB, require_built_page, require_package, serve

from geort_drake.live.web.messages import Engage
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.live.web.server import WebServer

FIREFOX = shutil.which("firefox") or shutil.which("firefox-esr")
WEBKIT_DRIVER = shutil.which("WebKitWebDriver")
MINI_BROWSER = next(Path("/usr/lib").glob("*/webkit2gtk-4.*/MiniBrowser"), None)
XVFB = shutil.which("Xvfb")
PATIENCE_S = 120.0


class Browser:
    """A browser with one page; an asynchronous context manager.

    Args:
        folder: of its profile.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._processes: list[asyncio.subprocess.Process] = []

    async def __aenter__(self) -> "Browser":
        self._folder.mkdir()
        self._session = aiohttp.ClientSession()
        environment = dict(os.environ)
        screen = ("-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp")
        display = await self._run(XVFB, *screen, stdout=asyncio.subprocess.PIPE)
        environment["DISPLAY"] = f":{(await display.stdout.readline()).decode().strip()}"
        try:
            await self._start(environment)
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._session.close()
        for process in reversed(self._processes):
            os.killpg(process.pid, signal.SIGKILL)
            await process.wait()

    async def _run(self, *command: str | Path, **options: Any) -> asyncio.subprocess.Process:
        pipes = {"stdout": asyncio.subprocess.DEVNULL, "stderr": asyncio.subprocess.DEVNULL} | options
        process = await asyncio.create_subprocess_exec(*command, **pipes, start_new_session=True)
        self._processes.append(process)
        return process

    async def until(self, expression: str) -> None:
        """Waits until an expression holds."""
        deadline = time.monotonic() + PATIENCE_S
        while not await self.value(expression):
            assert time.monotonic() < deadline, expression
            await asyncio.sleep(0.05)


class Firefox(Browser):
    """By WebDriver BiDi."""

    @staticmethod
    def require() -> None:
        """Skips the test where Firefox or a display without a screen is absent."""
        if None in (FIREFOX, XVFB):
            pytest.skip("needs Firefox, and Xvfb, as it has no WebGL without a display")

    async def _start(self, environment: dict[str, str]) -> None:
        self._numbers = itertools.count(1)
        # Without a GPU, Firefox draws in 3D only if it is told to.
        (self._folder / "user.js").write_text('user_pref("webgl.force-enabled", true);')
        options = ["--remote-debugging-port", "0", "--profile", self._folder, "about:blank"]
        process = await self._run(FIREFOX, *options, stderr=asyncio.subprocess.PIPE, env=environment)
        while not (found := re.search(r"ws://\S+", (await process.stderr.readline()).decode())):
            assert process.returncode is None
        self._socket = await self._session.ws_connect(f"{found[0]}/session", max_msg_size=0)
        await self._call("session.new", capabilities={})
        contexts = await self._call("browsingContext.getTree")
        self._page = contexts["contexts"][0]["context"]
        size = {"width": 1280, "height": 720}
        await self._call("browsingContext.setViewport", context=self._page, viewport=size)

    async def open(self, url: str) -> None:
        """Opens an address."""
        await self._call("browsingContext.navigate", context=self._page, url=url, wait="complete")

    async def value(self, expression: str) -> Any:
        """The value of an expression in the page, a text or a number; promises are awaited."""
        answer = await self._call(
            "script.evaluate", expression=expression, target={"context": self._page}, awaitPromise=True
        )
        assert answer["type"] == "success", answer
        return answer["result"].get("value")

    async def press(self, key: str) -> None:
        """Presses and releases a key."""
        await self._call("input.performActions", context=self._page, actions=[_stroke(key)])

    async def _call(self, method: str, **parameters: Any) -> dict:
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        async with asyncio.timeout(PATIENCE_S):
            while (answer := await self._socket.receive_json()).get("id") != number:
                pass
        assert answer["type"] == "success", answer
        return answer["result"]


class WebKit(Browser):
    """WebKitGTK's MiniBrowser by WebDriver."""

    @staticmethod
    def require() -> None:
        """Skips the test where WebKitGTK, its driver or a display without a screen is absent."""
        if None in (WEBKIT_DRIVER, MINI_BROWSER, XVFB):
            pytest.skip("needs WebKitGTK's WebKitWebDriver and MiniBrowser, and Xvfb")

    async def _start(self, environment: dict[str, str]) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        environment["HOME"] = str(self._folder)
        await self._run(WEBKIT_DRIVER, f"--port={port}", env=environment)
        self._base = f"http://127.0.0.1:{port}/session"
        options = {"binary": str(MINI_BROWSER), "args": ["--automation"]}
        browser = {"alwaysMatch": {"webkitgtk:browserOptions": options}}
        async with asyncio.timeout(PATIENCE_S):
            while True:
                try:
                    session = await self._call("", capabilities=browser)
                    break
                except aiohttp.ClientConnectorError:
                    await asyncio.sleep(0.05)
        self._base += f"/{session['sessionId']}"
        await self._call("/window/rect", width=1280, height=720)

    async def open(self, url: str) -> None:
        """Opens an address."""
        await self._call("/url", url=url)

    async def value(self, expression: str) -> Any:
        """The value of an expression in the page; promises are awaited."""
        script = f"const done = arguments[0]; Promise.resolve({expression}).then(done)"
        return await self._call("/execute/async", script=script, args=[])

    async def press(self, key: str) -> None:
        """Presses and releases a key."""
        await self._call("/actions", actions=[_stroke(key)])

    async def _call(self, path: str, **parameters: Any) -> Any:
        timeout = aiohttp.ClientTimeout(PATIENCE_S)
        async with self._session.post(self._base + path, json=parameters, timeout=timeout) as response:
            answer = await response.json(content_type=None)
        assert response.status == 200, answer
        return answer["value"]


def _stroke(key: str) -> dict:
    strokes = [{"type": kind, "value": key} for kind in ("keyDown", "keyUp")]
    return {"type": "key", "id": "keyboard", "actions": strokes}


@pytest.mark.parametrize("browser", [Firefox, WebKit])
def test_the_page_tracks_the_hand_and_engages(browser, tmp_path):
    """MediaPipe finds the hand, and the server gets and understands it; a headset is excused in words."""
    browser.require()
    require_built_page()
    require_package("@webxr-input-profiles/assets")
    about = RobotInfo("right", "allegro_right", "simulation", {"grasp": ["cylinder"]}, "a map")
    station = OperatorStation(about)
    server = WebServer(station, "127.0.0.1", 0, "key", PAGE)
    try:
        asyncio.run(_track(browser(tmp_path / "profile"), server, station))
    finally:
        server.close()


async def _track(browser: Browser, server: WebServer, station: OperatorStation) -> None:
    server.show(json.dumps(SCENE).encode(), [])
    async with browser as page, asyncio.timeout(3 * PATIENCE_S):
        with serve(WEB) as address:
            await page.open(f"{address}/test/hand.html")
            await page.until("Boolean(window.ready)")
            pictures = []
            for number, posture in enumerate((FLAT, PINCH)):
                await page.value(f"void pose({json.dumps(posture)})")
                pictures.append(await page.value(f"draw({number})"))
        await page.open(f"http://127.0.0.1:{server.port}/#key")
        camera = (WEB / "test/picture_camera.js").read_text()
        await page.value(f"void ({camera})({json.dumps(pictures)})")
        await page.until("document.body.dataset.state === 'waiting'")
        assert "right hand" in await page.value("document.querySelector('#headline').innerText")
        if isinstance(browser, WebKit):
            assert "no headset" in await page.value("document.querySelector('#no-headset').innerText")
        server.publish(json.dumps(STATE))
        await page.value("document.querySelector('#camera').click()")
        await page.until("document.body.dataset.state === 'tracking'")
        while station.received < 3:
            await asyncio.sleep(0.05)
        await page.press(" ")
        while not any(isinstance(command, Engage) for command in station.commands):
            await asyncio.sleep(0.05)
    assert station.refused == 0

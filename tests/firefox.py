"""Firefox by WebDriver BiDi, which it speaks itself."""

import asyncio
import itertools
import os
import re
import shutil
import time
from pathlib import Path
from typing import Any

import aiohttp
import pytest

FIREFOX = shutil.which("firefox") or shutil.which("firefox-esr")
XVFB = shutil.which("Xvfb")
PATIENCE_S = 120.0


def require_firefox(with_3d: bool) -> None:
    """Skips the test where Firefox is absent, or for 3D a display without a screen."""
    if FIREFOX is None:
        pytest.skip("needs Firefox")
    if with_3d and XVFB is None:
        pytest.skip("needs Xvfb, as Firefox has no WebGL without a display")


class Firefox:
    """A browser with one page; an asynchronous context manager.

    Args:
        folder: of its profile.
        with_3d: whether it gets a display, and so WebGL.
    """

    def __init__(self, folder: Path, with_3d: bool):
        self._folder, self._with_3d, self._numbers = folder, with_3d, itertools.count(1)

    async def __aenter__(self) -> "Firefox":
        self._folder.mkdir()
        # Without a GPU, Firefox draws in 3D only if it is told to.
        (self._folder / "user.js").write_text('user_pref("webgl.force-enabled", true);')
        options, environment, self._display = ["--headless"], dict(os.environ), None
        if self._with_3d:
            self._display = await asyncio.create_subprocess_exec(
                XVFB, "-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp",
                stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
            )  # fmt: skip
            number = (await self._display.stdout.readline()).decode().strip()
            options, environment["DISPLAY"] = [], f":{number}"
        self._process = await asyncio.create_subprocess_exec(
            FIREFOX, *options, "--remote-debugging-port", "0", "--profile", self._folder, "about:blank",
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE, env=environment,
        )  # fmt: skip
        while not (found := re.search(r"ws://\S+", (await self._process.stderr.readline()).decode())):
            assert self._process.returncode is None
        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(f"{found[0]}/session", max_msg_size=0)
        await self._call("session.new", capabilities={})
        contexts = await self._call("browsingContext.getTree")
        self._page = contexts["contexts"][0]["context"]
        size = {"width": 1280, "height": 720}
        await self._call("browsingContext.setViewport", context=self._page, viewport=size)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._socket.close()
        await self._session.close()
        for process in filter(None, (self._process, self._display)):
            process.kill()
            await process.wait()

    async def open(self, url: str, script: str = "() => {}") -> None:
        """Opens an address; the script, a function, runs before the page's own."""
        await self._call("script.addPreloadScript", functionDeclaration=script)
        await self._call("browsingContext.navigate", context=self._page, url=url, wait="complete")

    async def value(self, expression: str) -> Any:
        """The value of an expression in the page, a text or a number; promises are awaited."""
        answer = await self._call(
            "script.evaluate", expression=expression, target={"context": self._page}, awaitPromise=True
        )
        assert answer["type"] == "success", answer
        return answer["result"].get("value")

    async def until(self, expression: str) -> None:
        """Waits until an expression holds."""
        deadline = time.monotonic() + PATIENCE_S
        while not await self.value(expression):
            assert time.monotonic() < deadline, expression
            await asyncio.sleep(0.05)

    async def press(self, key: str) -> None:
        """Presses and releases a key."""
        strokes = [{"type": kind, "value": key} for kind in ("keyDown", "keyUp")]
        keyboard = {"type": "key", "id": "keyboard", "actions": strokes}
        await self._call("input.performActions", context=self._page, actions=[keyboard])

    async def _call(self, method: str, **parameters: Any) -> dict:
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        async with asyncio.timeout(PATIENCE_S):
            while (answer := await self._socket.receive_json()).get("id") != number:
                pass
        assert answer["type"] == "success", answer
        return answer["result"]

"""Serves the page, the scene and the WebSocket of docs/reference/web-protocol.md in a separate thread."""

import asyncio
import concurrent.futures
import hmac
import itertools
import ssl
import threading
import time
from pathlib import Path
from typing import Any

import msgspec
from aiohttp import WSMsgType, web

from geort_drake.errors import GeortError, LiveError
from geort_drake.live.web.messages import MAX_BYTES
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo

_MAX_CONNECTIONS = 8
_RATE_HZ = 200.0  # most messages a second of one connection, with bursts of a second
_MAX_EXCESS = 1000  # messages beyond that rate, after which the connection is closed
_REFUSAL_S = 1.0  # least time between two `refused` messages
# A busy page answers late; a robot holds without fresh hands in any case, however long the connection lasts.
_HEARTBEAT_S = 10.0
# The page loads nothing from other servers. Hand tracking needs WebAssembly and workers.
_HEADERS = {
    "Content-Security-Policy": "default-src 'self' blob: data:; script-src 'self' blob: 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}


class _Connection:
    """Data queued for one page: answers in order, and only the newest state and frame."""

    def __init__(self, number: int, socket: web.WebSocketResponse):
        self.number, self.socket = number, socket
        self._texts: list[str] = []
        self._state: str | None = None
        self._frame: bytes | None = None
        self._wake = asyncio.Event()
        self._refused_at = -_REFUSAL_S
        self._tokens, self._counted_at, self._excess = _RATE_HZ, time.monotonic(), 0

    def answer(self, message: dict[str, Any]) -> None:
        self._texts.append(msgspec.json.encode(message).decode())
        self._wake.set()

    def refuse(self, text: str) -> None:
        now = time.monotonic()
        if now - self._refused_at >= _REFUSAL_S:
            self._refused_at = now
            self.answer({"type": "refused", "text": text})

    def publish(self, state: str | None, frame: bytes | None) -> None:
        self._state, self._frame = state or self._state, frame or self._frame
        self._wake.set()

    def exceeds_rate(self) -> bool:
        """Counts a message and returns whether it exceeds the allowed rate.

        Raises:
            LiveError: too many messages exceeded the rate; the connection must end.
        """
        now = time.monotonic()
        self._tokens = min(self._tokens + _RATE_HZ * (now - self._counted_at), _RATE_HZ)
        self._counted_at = now
        if self._tokens >= 1.0:
            self._tokens -= 1.0
            return False
        self._excess += 1
        if self._excess > _MAX_EXCESS:
            raise LiveError(f"more than {_RATE_HZ:g} messages a second")
        return True

    async def send(self) -> None:
        """Sends queued data until it is cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            texts, self._texts = self._texts, []
            state, self._state = self._state, None
            frame, self._frame = self._frame, None
            for text in [*texts, *([state] if state else [])]:
                await self.socket.send_str(text)
            if frame:
                await self.socket.send_bytes(frame)


class WebServer:
    """A web server in its own thread; its methods may be called from any thread.

    Attributes:
        port: port on which it listens.
        dropped: number of messages beyond the allowed rate.

    Args:
        station: handles the messages.
        host, port: address to listen on; for port 0 the system chooses a port.
        key: secret that a WebSocket must present.
        page: folder of the built page.
        tls: settings with a certificate; None for plain HTTP.

    Raises:
        LiveError: the server cannot listen there.
    """

    def __init__(
        self,
        station: OperatorStation,
        host: str,
        port: int,
        key: str,
        page: Path,
        tls: ssl.SSLContext | None = None,
    ):
        self._station, self._key, self._tls, self._page = station, key, tls, page
        self.dropped = 0
        self._scene, self._meshes = b"{}", list[bytes]()
        self._connections: dict[int, _Connection] = {}
        self._numbers, self._open_count = itertools.count(1), 0
        port_future: concurrent.futures.Future[int] = concurrent.futures.Future()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(host, port, port_future)), name="web", daemon=True
        )
        self._thread.start()
        self.port = port_future.result()

    def show(self, scene: bytes, meshes: list[bytes]) -> None:
        """Replaces the scene and its meshes."""
        self._scene, self._meshes = scene, meshes

    def introduce(self, about: RobotInfo) -> None:
        """Tells all pages of another robot."""

        def send() -> None:
            self._station.change(about)
            for connection in self._connections.values():
                connection.answer(self._station.welcome(connection.number))

        self._loop.call_soon_threadsafe(send)

    def publish(self, state: str | None = None, frame: bytes | None = None) -> None:
        """Sends a state or a frame of poses to all pages; a slow one gets only the newest."""

        def send() -> None:
            for connection in self._connections.values():
                connection.publish(state, frame)

        self._loop.call_soon_threadsafe(send)

    def close(self) -> None:
        """Ends all connections and the thread."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    async def _serve(self, host: str, port: int, port_future: "concurrent.futures.Future[int]") -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        app = web.Application()
        app.on_response_prepare.append(_add_headers)
        app.router.add_get("/", self._index)
        app.router.add_get("/scene", self._send_scene)
        app.router.add_get(r"/mesh/{number:\d{1,6}}", self._send_mesh)
        app.router.add_get("/ws", self._talk)
        app.router.add_static("/", self._page)
        runner = web.AppRunner(app, access_log=None, handle_signals=False, shutdown_timeout=0.5)
        await runner.setup()
        try:
            await web.TCPSite(runner, host, port, ssl_context=self._tls).start()
        except OSError as error:
            await runner.cleanup()
            port_future.set_exception(LiveError(f"cannot listen on {host}:{port}: {error.strerror}"))
            return
        port_future.set_result(runner.addresses[0][1])
        await self._stop.wait()
        for connection in list(self._connections.values()):
            await connection.socket.close(code=1001, message=b"the session has ended")
        await runner.cleanup()

    async def _index(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(self._page / "index.html")

    async def _send_scene(self, request: web.Request) -> web.Response:
        return web.Response(body=self._scene, content_type="application/json")

    async def _send_mesh(self, request: web.Request) -> web.Response:
        number = int(request.match_info["number"])
        if number >= len(self._meshes):
            raise web.HTTPNotFound
        return web.Response(body=self._meshes[number], content_type="application/octet-stream")

    async def _talk(self, request: web.Request) -> web.StreamResponse:
        """Serves a WebSocket until it ends."""
        self._require_access(request)
        self._open_count += 1
        try:
            return await self._talk_with(request)
        finally:
            self._open_count -= 1

    async def _talk_with(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(heartbeat=_HEARTBEAT_S, max_msg_size=MAX_BYTES, compress=False)
        await socket.prepare(request)
        connection = _Connection(next(self._numbers), socket)
        self._connections[connection.number] = connection
        connection.answer(self._station.join(connection.number))
        sender = asyncio.create_task(connection.send())
        try:
            async for message in socket:
                if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                    self._handle(connection, message.data)
        except LiveError as error:
            await socket.close(code=1008, message=str(error).encode())
        finally:
            sender.cancel()
            del self._connections[connection.number]
            self._station.leave(connection.number)
        return socket

    def _require_access(self, request: web.Request) -> None:
        key = request.query.get("key", "").encode(errors="replace")
        if not hmac.compare_digest(key, self._key.encode()):
            raise web.HTTPForbidden(text="wrong key: open the address that `geort-drake live` printed")
        # Browsers send the page's origin; other clients, which no page controls, need not.
        origin = request.headers.get("Origin")
        if origin is not None and origin != f"{'https' if self._tls else 'http'}://{request.host}":
            raise web.HTTPForbidden(text="this page comes from elsewhere")
        if self._open_count >= _MAX_CONNECTIONS:
            raise web.HTTPServiceUnavailable(text=f"there are {_MAX_CONNECTIONS} connections already")

    def _handle(self, connection: _Connection, data: str | bytes) -> None:
        if connection.exceeds_rate():
            self.dropped += 1
            return
        try:
            answer = self._station.take(connection.number, data)
        except GeortError as error:
            connection.refuse(str(error))
            return
        if answer is not None:
            connection.answer(answer)


async def _add_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)

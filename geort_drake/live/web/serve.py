"""Opens the page's server, and the page in the browser."""

import ipaddress
import os
import secrets
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from geort_drake.console import say, warn
from geort_drake.errors import LiveError
from geort_drake.live.web.certificate import own_addresses, self_signed_context
from geort_drake.live.web.operator_station import OperatorStation

if TYPE_CHECKING:
    from geort_drake.live.web.server import WebServer


@contextmanager
def open_server(station: OperatorStation, host: str, port: int, browser: bool) -> "Iterator[WebServer]":
    """Yields a server and prints its address, which contains its key; closes it at the end.

    Args:
        station: handles the page's messages.
        host, port: address to listen on. TLS is used unless it is a loopback address.
        browser: whether to open the browser, if there is a display.

    Raises:
        LiveError: the server cannot listen there, or aiohttp or cryptography is not installed.
    """
    try:
        from geort_drake.live.web.server import PAGES, WebServer
    except ImportError:
        raise LiveError("the page needs aiohttp: pip install 'geort-drake[live]'") from None
    hosts = own_addresses(host)
    tls = None if is_loopback(host) else self_signed_context(hosts)
    key = secrets.token_urlsafe(16)
    server = WebServer(station, host, port, key, tls)
    try:
        shown = f"[{hosts[0]}]" if ":" in hosts[0] else hosts[0]
        address = f"{'https' if tls else 'http'}://{shown}:{server.port}/#{key}"
        if not PAGES.is_dir():
            warn("the page has not been built; in a clone: make live")
        if tls:
            warn(
                "the page is open to the network: whoever has this address moves the robot. The browser will "
                "not know the certificate; accept it on your own devices only"
            )
        say(f"Hold up your hand: {address}")
        if browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(address)
        yield server
    finally:
        server.close()


def is_loopback(host: str) -> bool:
    """Returns whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

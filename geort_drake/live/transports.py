"""Receivers and senders of byte messages over ZeroMQ, and addresses of ZeroMQ and LCM:

    sub+tcp://HOST:PORT     ZeroMQ, subscribes to a publisher, whose address is pub+tcp://…
    pull+tcp://HOST:PORT    ZeroMQ, pulls from a pusher, as most MANUS bridges are: push+tcp://…
    zmq+tcp://HOST:PORT     joint targets for a robot, whose states come at PORT + 1
    lcm                     LCM on `LOCAL_LCM`, whose messages do not leave this machine
    lcm+URL                 LCM on that URL, udpm://GROUP:PORT?ttl=N

ZeroMQ's ipc:// works in place of tcp://. Receivers connect and senders bind, so only senders listen.

This module needs no Drake, so that it also runs on a robot's computer.
"""

import importlib
import ipaddress
import re
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from geort_drake.errors import LiveError

# Largest message. Those of the package take 2 kB; those of MANUS bridges, with joint angles, up to 10 kB.
MAX_BYTES = 65_536
# LCM's default group and port; ttl=0 keeps sent messages on this machine.
LOCAL_LCM = "udpm://239.255.76.67:7667?ttl=0"

_RECEIVERS, _SENDERS = ("sub", "pull"), ("pub", "push")
_FORMS = {"lcm": "lcm, lcm+udpm://GROUP:PORT?ttl=N", "zmq": "simulation, zmq+tcp://HOST:PORT"}
_ROUTES = Path("/proc/net/route")
_ROUTE_IS_UP = 1  # flag in that table

_MAX_AT_ONCE = 100  # most messages read in one call, so that a flood cannot block a loop


class Receiver(Protocol):
    """Receives messages.

    Attributes:
        refusing: why the receiver itself refused the newest message, or "".
    """

    refusing: str

    def drain(self) -> list[bytes]:
        """Returns the messages since the last call, oldest first; does not wait."""


def open_receiver(address: str) -> "ZmqReceiver":
    """Connects to a glove's address.

    Raises:
        LiveError: the address is malformed, or pyzmq is not installed.
    """
    return ZmqReceiver(*split_address(address, _RECEIVERS))


def open_sender(address: str) -> "ZmqSender":
    """Binds to an address to which receivers of a glove connect.

    Raises:
        LiveError: the address is malformed or in use, or pyzmq is not installed.
    """
    return ZmqSender(*split_address(address, _SENDERS))


def is_address(text: str) -> bool:
    """Returns whether the name of a glove's source looks like an address rather than a file."""
    return "://" in text or text.partition("+")[0] in _RECEIVERS


def split_address(address: str, patterns: Sequence[str]) -> tuple[str, str]:
    """Splits an address into pattern and endpoint; LCM's endpoint is a URL, by default `LOCAL_LCM`.

    Args:
        patterns: patterns that are allowed, such as "sub" or "lcm".

    Raises:
        LiveError: the address is malformed, or has another pattern.
    """
    pattern, _, endpoint = address.partition("+")
    if pattern == "lcm" and pattern in patterns:
        check_lcm_url(endpoint or LOCAL_LCM)
        return pattern, endpoint or LOCAL_LCM
    port = re.fullmatch(r"tcp://[^\s:/]+:(\d{1,5})|ipc://\S+", endpoint)
    # A robot's states arrive at the next port.
    if pattern not in patterns or port is None or int(port[1] or 0) > 65535 - (pattern == "zmq"):
        forms = [_FORMS.get(name, f"{name}+tcp://HOST:PORT") for name in patterns]
        raise LiveError(f"address '{address:.80}': give one of {', '.join(forms)}")
    return pattern, endpoint


def check_lcm_url(url: str) -> None:
    """Raises LiveError unless LCM can use the URL. LCM itself accepts any, but loses all messages."""
    match = re.fullmatch(r"udpm://([\d.]+):(\d{1,5})\?ttl=\d{1,3}", url)
    try:
        good = match is not None and ipaddress.IPv4Address(match[1]).is_multicast and int(match[2]) < 65536
    except ValueError:
        good = False
    if not good:
        raise LiveError(
            f"LCM URL '{url:.80}': expected udpm://GROUP:PORT?ttl=N, GROUP from 224.0.0.0 to 239.255.255.255"
        )


def is_local(address: str) -> bool:
    """Returns whether a valid address or LCM URL reaches only this machine."""
    if "udpm://" in address or address == "lcm":
        return address == "lcm" or address.endswith("?ttl=0")
    return "ipc://" in address or re.search(r"//(127\.[\d.]+|localhost):", address) is not None


def is_routed_to_network(url: str, routes: Path = _ROUTES) -> bool:
    """Returns whether an LCM URL's group is routed to a network, so that messages of other machines arrive.

    `ttl=0` limits only what this machine sends. The result is True if the routes are unknown.

    Args:
        url: LCM URL.
        routes: file with Linux's table of IPv4 routes.
    """
    match = re.match(r"udpm://([\d.]+):", url)
    if match is None or not routes.exists():
        return True
    group = int(ipaddress.IPv4Address(match[1]))
    candidates = []
    for line in routes.read_text().splitlines()[1:]:
        interface, destination, _, flags, _, _, metric, mask, *_ = line.split()
        # Addresses are in the machine's byte order.
        network, bits = (socket.ntohl(int(word, 16)) for word in (destination, mask))
        if int(flags, 16) & _ROUTE_IS_UP and group & bits == network:
            candidates.append((-bits, int(metric), interface))
    return bool(candidates) and min(candidates)[2] != "lo"


class _ZmqSocket:
    """A ZeroMQ socket with short queues and a size limit that closes without waiting."""

    def __init__(self, pattern: str):
        try:
            self._zmq: Any = importlib.import_module("zmq")
        except ImportError:
            raise LiveError("ZeroMQ needs pyzmq: pip install 'geort-drake[live]'") from None
        # One context for the process: a context of its own waits for ever if it is freed before its socket.
        self._socket = self._zmq.Context.instance().socket(getattr(self._zmq, pattern.upper()))
        self._socket.setsockopt(self._zmq.LINGER, 0)
        self._socket.setsockopt(self._zmq.RCVHWM, _MAX_AT_ONCE)
        self._socket.setsockopt(self._zmq.SNDHWM, 2)
        self._socket.setsockopt(self._zmq.MAXMSGSIZE, MAX_BYTES)  # disconnects a peer that sends more

    def _open(self, endpoint: str, binds: bool) -> None:
        try:
            (self._socket.bind if binds else self._socket.connect)(endpoint)
        except self._zmq.ZMQError as error:
            self.close()
            what = "listen" if binds else "connect"
            raise LiveError(f"{endpoint}: cannot {what} there: {error}") from None

    def close(self) -> None:
        self._socket.close()


class ZmqReceiver(_ZmqSocket):
    """A SUB or PULL socket that connects to a sender, at once or when the sender starts, or binds."""

    refusing = ""  # it refuses nothing

    def __init__(self, pattern: str, endpoint: str, binds: bool = False):
        super().__init__(pattern)
        if pattern == "sub":
            self._socket.subscribe(b"")
        self._open(endpoint, binds)

    def drain(self) -> list[bytes]:
        messages: list[bytes] = []
        try:
            while len(messages) < _MAX_AT_ONCE:
                # The last part of a multipart message is the payload; earlier parts are topics.
                messages.append(self._socket.recv_multipart(self._zmq.NOBLOCK)[-1])
        except self._zmq.Again:
            pass
        return messages


class ZmqSender(_ZmqSocket):
    """A PUB or PUSH socket that binds or connects; messages without a receiver are dropped."""

    def __init__(self, pattern: str, endpoint: str, binds: bool = True):
        super().__init__(pattern)
        # Without it, a queue keeps the oldest messages for a receiver that starts much later.
        self._socket.setsockopt(self._zmq.IMMEDIATE, 1)
        self._open(endpoint, binds)

    @property
    def endpoint(self) -> str:
        """The endpoint; for port 0, with the port that the system chose."""
        return self._socket.last_endpoint.decode()

    def send(self, message: bytes) -> None:
        try:
            self._socket.send(message, self._zmq.NOBLOCK)
        except self._zmq.Again:
            pass  # a late glove frame is useless


def wait_for(poll: Callable[[], Any], timeout_s: float, message: Callable[[], str]) -> Any:
    """Returns the first result of `poll` that is not None.

    Raises:
        LiveError: there is none within `timeout_s`; its text is `message()`.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        result = poll()
        if result is not None:
            return result
        if time.monotonic() > deadline:
            raise LiveError(message())
        time.sleep(0.002)

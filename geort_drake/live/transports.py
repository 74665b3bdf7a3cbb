"""Byte messages over ZeroMQ and LCM: addresses, what receives and what sends.

    sub+tcp://HOST:PORT     ZeroMQ, subscribed to a publisher; pub+tcp://… is the publisher
    pull+tcp://HOST:PORT    ZeroMQ, pulled from a pusher, as most MANUS bridges are; push+tcp://… is that
    lcm                     LCM on `LOCAL_LCM`, whose messages do not leave this machine
    lcm+URL                 LCM on that URL, udpm://GROUP:PORT?ttl=N
ZeroMQ's ipc:// serves in place of tcp://. Receivers connect and senders bind, so only what sends listens.
"""

import importlib
import ipaddress
import re
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from pydrake.lcm import DrakeLcm

from geort_drake.errors import LiveError
from geort_drake.live.glove_frame import MAX_BYTES

# LCM's usual group and port; ttl=0 keeps what is sent on this machine.
LOCAL_LCM = "udpm://239.255.76.67:7667?ttl=0"
GLOVE_CHANNEL = "GEORT_GLOVE"

_ROUTES, _ROUTE_UP = Path("/proc/net/route"), 1

_MOST_AT_ONCE = 100  # messages taken up in one go, so that a flood cannot keep a loop from going on


class Receiver(Protocol):
    """Where messages come from."""

    def drain(self) -> list[bytes]:
        """What has arrived since the last call, oldest first; does not wait."""

    def close(self) -> None: ...


class Sender(Protocol):
    """Where messages go."""

    def send(self, message: bytes) -> None: ...

    def close(self) -> None: ...


def open_receiver(address: str) -> Receiver:
    """Connects to a glove's address.

    Raises:
        LiveError: the address is malformed, or pyzmq is not installed.
    """
    pattern, endpoint = split_address(address, ("sub", "pull"))
    return LcmReceiver(endpoint) if pattern == "lcm" else ZmqReceiver(pattern, endpoint)


def open_sender(address: str) -> Sender:
    """Binds to an address where a glove can be heard.

    Raises:
        LiveError: the address is malformed or taken, or pyzmq is not installed.
    """
    pattern, endpoint = split_address(address, ("pub", "push"))
    return LcmSender(endpoint) if pattern == "lcm" else ZmqSender(pattern, endpoint)


def is_address(text: str) -> bool:
    """Whether a glove's source is meant for an address, and not for a file."""
    return text.partition("+")[0] in ("sub", "pull", "lcm")


def split_address(address: str, patterns: tuple[str, ...]) -> tuple[str, str]:
    """The pattern, lcm or one of `patterns`, and the endpoint of an address.

    Raises:
        LiveError: it has no such form.
    """
    pattern, _, endpoint = address.partition("+")
    if pattern == "lcm":
        endpoint = endpoint or LOCAL_LCM
        check_lcm_url(endpoint)
        return pattern, endpoint
    if pattern not in patterns or not re.fullmatch(r"tcp://[^\s:/]+:\d{1,5}|ipc://\S+", endpoint):
        forms = [*(f"{name}+tcp://HOST:PORT" for name in patterns), "lcm", "lcm+udpm://GROUP:PORT?ttl=N"]
        raise LiveError(f"address '{address:.80}': give one of {', '.join(forms)}")
    return pattern, endpoint


def check_lcm_url(url: str) -> None:
    """LCM itself takes any URL, and says nothing to messages that go nowhere.

    Raises:
        LiveError: it is no udpm URL of a multicast group with a ttl.
    """
    match = re.fullmatch(r"udpm://([\d.]+):(\d{1,5})\?ttl=\d{1,3}", url)
    try:
        good = match is not None and ipaddress.IPv4Address(match[1]).is_multicast and int(match[2]) < 65536
    except ValueError:
        good = False
    if not good:
        raise LiveError(
            f"LCM URL '{url:.80}': wants udpm://GROUP:PORT?ttl=N, GROUP from 224.0.0.0 to 239.255.255.255"
        )


def is_local(address: str) -> bool:
    """Whether nothing but this machine is meant by an address or an LCM URL."""
    if "udpm://" in address or address == "lcm":
        return "?ttl=" not in address or address.endswith("?ttl=0")
    return "ipc://" in address or re.search(r"//(127\.[\d.]+|localhost):", address) is not None


def heard_from_outside(url: str, routes: Path = _ROUTES) -> bool:
    """Whether an LCM URL's multicast group is routed to a network, so that others' messages are heard, too.

    `ttl=0` says nothing of that: it keeps what this machine sends. True where it cannot be told.

    Args:
        routes: Linux' table of IPv4 routes.
    """
    match = re.match(r"udpm://([\d.]+):", url)
    if match is None or not routes.exists():
        return True
    group = int(ipaddress.IPv4Address(match[1]))
    found = []
    for line in routes.read_text().splitlines()[1:]:
        interface, destination, _, flags, _, _, metric, mask, *_ = line.split()
        # Addresses are in the machine's byte order.
        network, bits = (socket.ntohl(int(word, 16)) for word in (destination, mask))
        if int(flags, 16) & _ROUTE_UP and group & bits == network:
            found.append((-bits, int(metric), interface))
    return bool(found) and min(found)[2] != "lo"


def open_lcm(url: str) -> DrakeLcm:
    """An LCM bus of this program's own.

    Raises:
        LiveError: the URL is malformed.
    """
    check_lcm_url(url)
    return DrakeLcm(url)


class LcmReceiver:
    """Messages of the glove's channel. LCM keeps one until it is fetched, so fetch often."""

    def __init__(self, url: str):
        self._lcm = open_lcm(url)
        self._messages: list[bytes] = []
        self._lcm.Subscribe(GLOVE_CHANNEL, self._messages.append)

    def drain(self) -> list[bytes]:
        self._lcm.HandleSubscriptions(0)
        messages = self._messages[-_MOST_AT_ONCE:]
        self._messages.clear()
        return messages

    def close(self) -> None:
        pass


class LcmSender:
    """Puts messages on the glove's channel."""

    def __init__(self, url: str):
        self._lcm = open_lcm(url)

    def send(self, message: bytes) -> None:
        self._lcm.Publish(GLOVE_CHANNEL, message)

    def close(self) -> None:
        pass


class ZmqReceiver:
    """A SUB or PULL socket that connects; a sender that is not there yet is waited for."""

    def __init__(self, pattern: str, endpoint: str):
        self._zmq = _zmq()
        self._context, self._socket = _socket(pattern)
        if pattern == "sub":
            self._socket.subscribe(b"")
        try:
            self._socket.connect(endpoint)
        except self._zmq.ZMQError as error:
            self.close()
            raise LiveError(f"{endpoint}: cannot connect there: {error}") from None

    def drain(self) -> list[bytes]:
        messages: list[bytes] = []
        try:
            while len(messages) < _MOST_AT_ONCE:
                # Of several parts, the last is the payload; those before it are topics.
                messages.append(self._socket.recv_multipart(self._zmq.NOBLOCK)[-1])
        except self._zmq.Again:
            pass
        return messages

    def close(self) -> None:
        self._socket.close()
        self._context.term()


class ZmqSender:
    """A PUB or PUSH socket that binds; what nobody takes is dropped."""

    def __init__(self, pattern: str, endpoint: str):
        self._zmq = _zmq()
        self._context, self._socket = _socket(pattern)
        try:
            self._socket.bind(endpoint)
        except self._zmq.ZMQError as error:
            self.close()
            raise LiveError(f"{endpoint}: cannot listen there: {error}") from None

    @property
    def endpoint(self) -> str:
        """Where it listens, with the port that the system chose for port 0."""
        return self._socket.last_endpoint.decode()

    def send(self, message: bytes) -> None:
        try:
            self._socket.send(message, self._zmq.NOBLOCK)
        except self._zmq.Again:
            pass  # a late glove frame is worth nothing

    def close(self) -> None:
        self._socket.close()
        self._context.term()


def _socket(pattern: str) -> tuple[Any, Any]:
    """A context and a socket that keeps little, takes no large messages and never waits to close."""
    zmq = _zmq()
    context = zmq.Context()
    socket = context.socket(getattr(zmq, pattern.upper()))
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.RCVHWM, _MOST_AT_ONCE)
    socket.setsockopt(zmq.SNDHWM, 2)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)  # who sends more is disconnected
    return context, socket


def _zmq() -> Any:
    try:
        return importlib.import_module("zmq")
    except ImportError:
        raise LiveError("ZeroMQ needs pyzmq: pip install 'geort-drake[live]'") from None


def wait_for(poll: Callable[[], Any], timeout_s: float, message: Callable[[], str]) -> Any:
    """The first result of `poll` that is not None.

    Raises:
        LiveError: with `message()`, when there is none in time.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        result = poll()
        if result is not None:
            return result
        if time.monotonic() > deadline:
            raise LiveError(message())
        time.sleep(0.002)

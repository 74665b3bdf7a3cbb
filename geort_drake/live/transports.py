"""Sockets of ZeroMQ, messages of JSON, and addresses of ZeroMQ and LCM:

    sub+tcp://HOST:PORT     ZeroMQ, subscribes to a publisher, whose address is pub+tcp://…
    pull+tcp://HOST:PORT    ZeroMQ, pulls from a pusher, as most MANUS bridges are: push+tcp://…
    zmq+tcp://HOST:PORT     joint targets for a robot, whose states come at PORT + 1
    lcm                     LCM on `LOCAL_LCM`, whose messages do not leave this machine
    lcm+URL                 LCM on that URL, udpm://GROUP:PORT?ttl=N

ZeroMQ's ipc:// works in place of tcp://. Receivers connect and senders bind, so only senders listen.

This module needs no Drake, so that it also runs on a robot's computer.
"""

import ipaddress
import re
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import msgspec
import zmq

from geort_drake.errors import LiveError

# Largest message. Those of the package take 2 kB; those of MANUS bridges, with joint angles, up to 10 kB.
MAX_BYTES = 65_536
# LCM's default group and port; ttl=0 keeps sent messages on this machine.
LOCAL_LCM = "udpm://239.255.76.67:7667?ttl=0"

RECEIVERS, SENDERS = ("sub", "pull"), ("pub", "push")  # patterns of ZeroMQ at a glove's address
_FORMS = {
    "lcm": "lcm, lcm+udpm://GROUP:PORT?ttl=N, GROUP from 224.0.0.0 to 239.255.255.255",
    "zmq": "simulation, zmq+tcp://HOST:PORT",
}

_MAX_AT_ONCE = 100  # most messages read in one call, so that a flood cannot block a loop


def is_address(text: str) -> bool:
    """Returns whether the name of a glove's source looks like an address rather than a file."""
    return "://" in text or text.partition("+")[0] in RECEIVERS


def split_address(address: str, patterns: Sequence[str]) -> tuple[str, str]:
    """Splits an address into pattern and endpoint; LCM's endpoint is a URL, by default `LOCAL_LCM`.

    Args:
        patterns: patterns that are allowed, such as "sub" or "lcm".

    Raises:
        LiveError: the address is malformed, or has another pattern.
    """
    pattern, _, endpoint = address.partition("+")
    if pattern == "lcm":
        endpoint = endpoint or LOCAL_LCM
        good = _is_lcm_url(endpoint)
    else:
        port = re.fullmatch(r"tcp://[^\s:/]+:(\d{1,5})|ipc://\S+", endpoint)
        # A robot's states arrive at the next port.
        good = port is not None and int(port[1] or 0) <= 65535 - (pattern == "zmq")
    if pattern not in patterns or not good:
        forms = [_FORMS.get(name, f"{name}+tcp://HOST:PORT") for name in patterns]
        raise LiveError(f"address '{address:.80}': give one of {', '.join(forms)}")
    return pattern, endpoint


def _is_lcm_url(url: str) -> bool:
    """Returns whether LCM can use the URL. LCM itself accepts any, but loses all messages."""
    match = re.fullmatch(r"udpm://([\d.]+):(\d{1,5})\?ttl=\d{1,3}", url)
    try:
        return match is not None and ipaddress.IPv4Address(match[1]).is_multicast and int(match[2]) < 65536
    except ValueError:
        return False


def is_local(address: str) -> bool:
    """Returns whether what is sent to a valid address reaches only this machine."""
    if address.startswith("lcm"):
        return address == "lcm" or address.endswith("?ttl=0")
    return "ipc://" in address or re.search(r"//(127\.[\d.]+|localhost):", address) is not None


Message = TypeVar("Message")


def decode_json(decoder: msgspec.json.Decoder[Message], message: bytes | str, name: str) -> Message:
    """Decodes a message of JSON, which errors call `name`.

    Raises:
        LiveError: the message is too long or malformed; the error names the field.
    """
    if len(message) > MAX_BYTES:
        raise LiveError(f"{name}: {len(message)} bytes; at most {MAX_BYTES} are read")
    try:
        return decoder.decode(message)
    # Invalid UTF-8 raises a ValueError, and deep nesting a RecursionError.
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise LiveError(f"{name}: {error!s:.120}") from None


class ZmqSocket:
    """A ZeroMQ socket with short queues and a size limit that closes without waiting.

    It connects, at once or when the other end starts, or it binds. It drops what it sends to nobody.
    """

    def __init__(self, pattern: str, endpoint: str, binds: bool):
        # One context for the process: a context of its own waits for ever if it is freed before its socket.
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(getattr(zmq, pattern.upper()))
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVHWM, _MAX_AT_ONCE)
        self._socket.setsockopt(zmq.SNDHWM, 2)
        # Without it, a queue keeps the oldest messages for a receiver that starts much later.
        self._socket.setsockopt(zmq.IMMEDIATE, 1)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)  # disconnects a peer that sends more
        if pattern == "sub":
            self._socket.subscribe(b"")
        try:
            (self._socket.bind if binds else self._socket.connect)(endpoint)
        except zmq.ZMQError as error:
            self.close()
            what = "listen" if binds else "connect"
            raise LiveError(f"{endpoint}: cannot {what} there: {error}") from None

    @property
    def endpoint(self) -> str:
        """The endpoint; for port 0, with the port that the system chose."""
        return self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def send(self, message: bytes) -> None:
        try:
            self._socket.send(message, zmq.NOBLOCK)
        except zmq.Again:
            pass  # a late message is useless

    def drain(self) -> list[bytes]:
        """Returns the messages since the last call, oldest first; does not wait."""
        messages: list[bytes] = []
        try:
            while len(messages) < _MAX_AT_ONCE:
                # The last part of a multipart message is the payload; earlier parts are topics.
                messages.append(self._socket.recv_multipart(zmq.NOBLOCK)[-1])
        except zmq.Again:
            pass
        return messages

    def close(self) -> None:
        self._socket.close()


def wait_for(poll: Callable[[], Any], timeout_s: float, message: Callable[[], str]) -> Any:
    """Returns the first result of `poll` that is true.

    Raises:
        LiveError: there is none within `timeout_s`; its text is `message()`.
    """
    deadline = time.monotonic() + timeout_s
    while not (result := poll()):
        if time.monotonic() > deadline:
            raise LiveError(message())
        time.sleep(0.002)
    return result

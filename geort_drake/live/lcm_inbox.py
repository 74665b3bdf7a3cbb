"""The newest good message of each of several LCM channels."""

import dataclasses as dc
import time
from collections.abc import Callable, Mapping
from typing import Any

from pydrake.lcm import DrakeLcm

from geort_drake.errors import LiveError


@dc.dataclass(frozen=True)
class Received:
    """A decoded message, and when it arrived, s."""

    contents: Any
    arrived: float


class LcmInbox:
    """Fetches, checks and keeps messages; what cannot be used is counted and dropped.

    Attributes:
        newest: channel → the newest good message.
        refused: messages that could not be used, and `last_refusal` why the last one could not.

    Args:
        lcm: the bus.
        decoders: channel → what makes contents of bytes, or raises LiveError.
        clock: monotonic, s.
    """

    def __init__(
        self,
        lcm: DrakeLcm,
        decoders: Mapping[str, Callable[[bytes], Any]],
        clock: Callable[[], float] = time.monotonic,
    ):
        self._lcm, self._clock = lcm, clock
        self.newest: dict[str, Received] = {}
        self.refused = 0
        self.last_refusal = ""
        for channel, decode in decoders.items():
            lcm.Subscribe(channel, lambda message, c=channel, d=decode: self._keep(c, d, message))

    def fetch(self) -> None:
        """Takes up what has arrived. LCM keeps one message a channel until then, so fetch often."""
        self._lcm.HandleSubscriptions(0)

    def _keep(self, channel: str, decode: Callable[[bytes], Any], message: bytes) -> None:
        try:
            self.newest[channel] = Received(decode(message), self._clock())
        except LiveError as error:
            self.refused += 1
            self.last_refusal = str(error)

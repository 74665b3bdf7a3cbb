"""Tells late frames from frames whose sender's clock runs slow."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

# Clocks drift by up to 100 ppm each, s/s.
_ORDINARY_DRIFT = 2e-4
# Slewing slows a clock by at most this; a larger growth of the delay is none of the clock, s/s.
_MAX_DRIFT = 0.15
# A drift is measured between the fastest frames of this many successive blocks, s each.
_BLOCK_S, _BLOCKS = 0.5, 6


class _Block(NamedTuple):
    """Half a second of frames: the delay of the fastest, the number of frames, and the offset at the end."""

    fastest: float
    frames: int
    offset: float


class SenderClock:
    """Estimates the offset of a sender's clock, and thus how late its frames are.

    The offset is the delay (arrival minus stamp) of the fastest frame, which grows where the sender's clock
    runs slow: while it is slewed, or if stamps come from a frame counter and a wrong rate. Delay grows, too,
    where frames queue up on their way; but then fewer arrive in each second. So growth counts as the clock's
    while frames arrive at their usual rate. It is measured by the median difference between the fastest
    frames of successive blocks, which a sudden delay does not change. A delay that grows steadily from the
    first frame on cannot be told from a slow clock.

    Attributes:
        offset: this machine's clock minus the sender's, plus the delay of the fastest frame, s; infinite
            before the first frame.
        drift: by how much the sender's clock runs slow, s/s; 0 if it runs right or that is unknown.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forgets all frames, as for another sender or a clock that was set."""
        self.offset, self.drift = math.inf, 0.0
        self._arrived, self._stamp = math.nan, -math.inf
        self._blocks: deque[_Block] = deque(maxlen=_BLOCKS)
        self._usual = 0
        self._fastest, self._frames = math.inf, 0
        self._begin_block(math.nan)

    def lateness(self, arrived: float, stamp: float, frames: int = 1) -> float:
        """Returns how much longer a frame took than the fastest one, s.

        Args:
            arrived: when it arrived, s, on this machine's clock.
            stamp: when it was measured, s, on the sender's clock.
            frames: number of frames that arrived since the last call, this one included.
        """
        if stamp < self._stamp:
            self.restart()
        if math.isnan(self._began):
            self._begin_block(arrived)
        elif arrived - self._began >= _BLOCK_S:
            self._end_block(arrived)
        if math.isfinite(self.offset):
            self.offset += max(self.drift, _ORDINARY_DRIFT) * (arrived - self._arrived)
        delay = arrived - stamp
        self.offset = min(self.offset, delay)
        self._arrived, self._stamp = arrived, stamp
        self._fastest, self._frames = min(self._fastest, delay), self._frames + frames
        return delay - self.offset

    def _begin_block(self, time: float) -> None:
        self._began, self._fastest, self._frames = time, math.inf, 0

    def _end_block(self, time: float) -> None:
        pause = time - self._began > 1.5 * _BLOCK_S
        if pause:  # frames are missing, so that neither rate nor growth is known
            self._blocks.clear()
        else:
            self._blocks.append(_Block(self._fastest, self._frames, self.offset))
        self._begin_block(time if pause else self._began + _BLOCK_S)
        self.drift = 0.0
        if len(self._blocks) < _BLOCKS:
            return
        frames = sum(block.frames for block in self._blocks)
        self._usual = max(self._usual, frames)
        growth = float(np.median(np.diff([block.fastest for block in self._blocks])))
        drift = growth / _BLOCK_S
        # A queue that grows by `drift` lets that share fewer frames arrive. The blocks' limits cut off one.
        if 0.0 < drift <= _MAX_DRIFT and frames >= self._usual * (1.0 - 0.25 * drift) - 1.0:
            self.drift = drift
            self.offset = max(self.offset, self._blocks[0].offset + (_BLOCKS - 1) * growth)

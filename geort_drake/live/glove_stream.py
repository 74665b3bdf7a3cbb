"""Receives a glove's messages in a diagram."""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, EventStatus

from geort_drake.errors import LiveError, MismatchError
from geort_drake.live.messages import GloveFrame, decode
from geort_drake.live.transports import RECEIVERS, ZmqSocket, split_address, wait_for
from geort_drake.people.checks import require_wrist_frame_hand
from geort_drake.systems.port_values import vector_to_pose
from geort_drake.systems.python_system import PythonSystem

# Messages are read every POLL_PERIOD, s, slightly before the loop's updates, which thus use the newest ones.
POLL_PERIOD, _AHEAD = 0.002, 1e-4
# A sender's clock that differs by less is assumed to be this machine's monotonic clock, s.
_SAME_CLOCK_S = 1.0
# A frame that took this much longer than the fastest one is late, s.
MAX_LATENESS_S = 0.2
# A sender's clock that runs slow by more than this is reported, s/s.
_NOTABLE_DRIFT = 0.005
HANDSHAKE_FRAMES = 5
# Of messages that arrive at once, these newest ones are decoded: all of a flood would block the loop.
_MOST_DECODED = 5

# Fields of the state, which are named like their ports.
_FIELDS = np.dtype(
    [
        ("keypoints", float, 63),
        ("wrist_pose", float, 7),
        ("valid", float),
        ("stamp", float),
        ("sent", float),
        ("lateness", float),
    ]
)


class GloveSource(Protocol):
    """Where the frames of a glove come from.

    Attributes:
        received, refused: number of frames, and of messages that could not be used.
        last_refusal: why the last of them could not be used.
        refusing: why the newest message was refused, or "".
    """

    received: int
    refused: int
    last_refusal: str
    refusing: str

    def drain(self) -> list[GloveFrame]:
        """Returns the frames since the last call, oldest first; does not wait."""


class GloveReceiver:
    """A `GloveSource` that decodes messages, and drops and counts those that cannot be used.

    Args:
        socket: source of the messages.
        side: "right" or "left", of the robot's hand.
        glove_id: serial number of the MANUS glove to read, if there are several.
    """

    def __init__(self, socket: ZmqSocket, side: str, glove_id: str | None = None):
        self._socket, self._side, self._glove_id = socket, side, glove_id
        self.received = self.refused = 0
        self.last_refusal = self.refusing = ""

    def drain(self, tolerant: bool = True) -> list[GloveFrame]:
        """Returns the frames since the last call, oldest first; does not wait.

        Raises:
            MismatchError: another version, unit or hand, unless `tolerant`.
        """
        frames = []
        for message in self._socket.drain()[-_MOST_DECODED:]:
            try:
                frame = decode(message, self._side, self._glove_id)
            except LiveError as error:
                if isinstance(error, MismatchError) and not tolerant:
                    raise
                self.refused += 1
                self.last_refusal = self.refusing = str(error)
                continue
            if frame is not None:
                frames.append(frame)
                self.refusing = ""
        self.received += len(frames)
        return frames

    def handshake(self, timeout_s: float) -> None:
        """Waits for the first frames and checks that they show a hand of the robot's side.

        Raises:
            MismatchError: another version, unit or hand.
            RecordingError: the keypoints are no hand, or not in the expected frame, order or unit.
            LiveError: no usable frame came in time; the message says what was refused.
        """
        hands: list[np.ndarray] = []

        def poll() -> bool:
            hands.extend(frame.p_HK for frame in self.drain(tolerant=False) if frame.p_HK is not None)
            return len(hands) >= HANDSHAKE_FRAMES

        wait_for(poll, timeout_s, lambda: self._silence(timeout_s))
        require_wrist_frame_hand(np.stack(hands), "the glove")

    def close(self) -> None:
        self._socket.close()

    def _silence(self, timeout_s: float) -> str:
        refused = f"; {self.refused} messages were refused, the last: {self.last_refusal}"
        return f"no hand came from the glove within {timeout_s:g} s" + (refused if self.refused else "")


def open_glove(address: str, side: str, glove_id: str | None = None) -> GloveReceiver:
    """Connects to a glove's address, see `transports` and `GloveReceiver`.

    Raises:
        LiveError: the address is malformed.
    """
    return GloveReceiver(ZmqSocket(*split_address(address, RECEIVERS), binds=False), side, glove_id)


class GloveStream(PythonSystem):
    """Outputs the newest frame received from a glove until the next one arrives.

    Frames are read in a discrete update every `POLL_PERIOD`.

    Output ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH in the tracker's world W; identity without a tracker.
        valid (1): 1 while the hand is tracked; 0 before the first frame, while the glove has lost the hand,
            and after a frame that came over `MAX_LATENESS_S` late.
        stamp (1): when the keypoints were measured, s, on the sender's clock; if the message has no time,
            when it arrived, on this machine's clock.
        sent (1): when the keypoints were measured, s, on this machine's clock: the stamp if the clocks agree,
            otherwise the arrival. NaN before the first frame.
        lateness (1): how much longer the newest frame took than the fastest one, s; see `SenderClock`. A
            delay common to all frames cannot be told from a difference between the clocks.

    State: the values of the ports.

    Attributes:
        source: where the frames come from.
        late: number of frames that came late.
        sender_clock: estimate of the sender's clock.

    Args:
        source: where the frames come from.
        clock: this machine's monotonic clock, s.
    """

    def __init__(self, source: GloveSource, clock: Callable[[], float] = time.monotonic):
        super().__init__()
        self.source, self._now = source, clock
        self.late = 0
        self.sender_clock = SenderClock()
        start = np.zeros(1, _FIELDS)
        start["wrist_pose"][0, 0], start["sent"] = 1.0, math.nan
        self._state = self.DeclareDiscreteState(start.view(float))
        ticket = {self.discrete_state_ticket(self._state)}
        for name in ("keypoints", "valid", "stamp", "sent", "lateness"):
            self.DeclareVectorOutputPort(
                name,
                start[name].size,
                lambda context, output, name=name: output.SetFromVector(np.ravel(self._value(context)[name])),
                ticket,
            )
        self.DeclareAbstractOutputPort(
            "wrist_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            lambda context, output: output.set_value(vector_to_pose(self._value(context)["wrist_pose"])),
            ticket,
        )
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, POLL_PERIOD - _AHEAD, self._update)

    @property
    def notice(self) -> str:
        """What the person should know of the sender's clock, or ""."""
        drift, growth = self.sender_clock.drift, self.sender_clock.growth
        if drift >= _NOTABLE_DRIFT:
            return f"the glove's clock runs {100 * drift:.0f} % slow; its time stamps are corrected"
        if growth >= _NOTABLE_GROWTH:
            return (
                "the glove's frames come later and later: they queue up on their way, or its time stamps "
                f"count {1.0 - growth:.1f} s in a second"
            )
        return ""

    def _value(self, context: Context) -> np.void:
        return context.get_discrete_state(self._state).value().view(_FIELDS)[0]

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        frames = self.source.drain()
        if not frames:
            return EventStatus.DidNothing()
        frame = frames[-1]
        arrival = self._now()
        stamp = arrival if frame.time is None else frame.time
        sent = stamp if abs(arrival - stamp) < _SAME_CLOCK_S else arrival
        lateness = self.sender_clock.lateness(arrival, stamp, len(frames))
        self.late += lateness > MAX_LATENESS_S
        value = discrete_state.get_mutable_value(self._state).view(_FIELDS)[0]  # starts as the present one
        if frame.p_HK is not None:
            value["keypoints"] = frame.p_HK.ravel()
        if frame.X_WH is not None:
            value["wrist_pose"] = frame.X_WH
        value["valid"] = frame.p_HK is not None and lateness <= MAX_LATENESS_S
        value["stamp"], value["sent"], value["lateness"] = stamp, sent, lateness
        return EventStatus.Succeeded()


# Clocks drift by up to 100 ppm each, s/s.
_ORDINARY_DRIFT = 2e-4
# Slewing slows a clock by at most this; a larger growth of the delay is none of the clock, s/s.
_MAX_DRIFT = 0.15
# From this growth of the delay on, people are told, s/s.
_NOTABLE_GROWTH = 0.05
# A drift is measured between the fastest frames of this many successive blocks, s each.
_BLOCK_S, _BLOCKS = 0.5, 6
# Radios and buses gather frames for up to this time, s.
_BURST_S = 0.04


def _sent(steps: list[float]) -> int:
    """Returns how many frames were sent, with those that are missing between stamps, from their steps, s."""
    usual_step = np.median(steps) if steps else 0.0
    if usual_step <= 0.0:  # the stamps are coarser than the steps
        return len(steps)
    # A step over missing frames is more than 1.7 usual ones; shorter ones are uneven.
    return sum(max(1, int(step / usual_step + 0.3)) for step in steps)


class SenderClock:
    """Estimates the offset of a sender's clock, and thus how late its frames are.

    The offset is the delay (arrival minus stamp) of the fastest frame, which grows where the sender's clock
    runs slow: while it is slewed, or if stamps come from a frame counter and a wrong rate. Delay grows, too,
    where frames queue up on their way; but then fewer arrive in each second. So growth counts as the clock's
    while frames arrive at their usual rate, those included that are lost, as steps of the stamps tell. It is
    measured by the median difference between the fastest frames of successive blocks, which a sudden delay
    does not change. A delay that grows steadily from the first frame on cannot be told from a slow clock.

    Attributes:
        offset: this machine's clock minus the sender's, plus the delay of the fastest frame, s; infinite
            before the first frame.
        drift: by how much the sender's clock runs slow, s/s; 0 if it runs right or that is unknown.
        growth: by how much the delay grows, whatever the reason, s/s.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forgets all frames, as for another sender or a clock that was set."""
        self.offset, self.drift, self.growth = math.inf, 0.0, 0.0
        self._arrival, self._stamp = math.nan, -math.inf
        # Of each: delay of the fastest frame, s; number of frames that were sent; offset at the end, s.
        self._blocks: deque[tuple[float, int, float]] = deque(maxlen=_BLOCKS)
        self._most_frames = 0
        self._fastest = math.inf
        self._begin_block(math.nan)

    def lateness(self, arrival: float, stamp: float, frames: int = 1) -> float:
        """Returns how much longer a frame took than the fastest one, s.

        Args:
            arrival: when it arrived, s, on this machine's clock.
            stamp: when it was measured, s, on the sender's clock.
            frames: number of frames that arrived since the last call, this one included.
        """
        if stamp < self._stamp:
            self.restart()
        if math.isnan(self._began):
            self._begin_block(arrival)
        elif arrival - self._began >= _BLOCK_S:
            self._end_block(arrival)
        if math.isfinite(self.offset):
            self.offset += max(self.drift, _ORDINARY_DRIFT) * (arrival - self._arrival)
            self._steps += frames * [(stamp - self._stamp) / frames]
        delay = arrival - stamp
        self.offset, self._fastest = min(self.offset, delay), min(self._fastest, delay)
        self._arrival, self._stamp = arrival, stamp
        return delay - self.offset

    def _begin_block(self, time: float) -> None:
        self._began, self._steps = time, list[float]()  # of the stamps, s, one for each frame
        self._fastest = math.inf

    def _end_block(self, time: float) -> None:
        pause = time - self._began > 1.5 * _BLOCK_S
        if pause:  # frames are missing, so that neither rate nor growth is known
            self._blocks.clear()
        else:
            self._blocks.append((self._fastest, _sent(self._steps), self.offset))
        self._begin_block(time if pause else self._began + _BLOCK_S)
        self.drift = self.growth = 0.0
        if len(self._blocks) < _BLOCKS:
            return
        frames = sum(sent for _, sent, _ in self._blocks)
        self._most_frames = max(self._most_frames, frames)
        growth = float(np.median(np.diff([fastest for fastest, _, _ in self._blocks])))
        self.growth = drift = growth / _BLOCK_S
        # While a queue grows by `drift`, that share of the frames is still under way. One frame may fall
        # outside of the blocks, or as many as come in a burst.
        tolerance = 1.0 + _BURST_S * frames / (_BLOCKS * _BLOCK_S)
        if 0.0 < drift <= _MAX_DRIFT and frames >= self._most_frames * (1.0 - 0.25 * drift) - tolerance:
            self.drift = drift
            self.offset = max(self.offset, self._blocks[0][2] + (_BLOCKS - 1) * growth)

"""A glove that sends messages, as a system."""

import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.errors import LiveError, MismatchError
from geort_drake.live.decoding import decode
from geort_drake.live.glove_frame import GloveFrame
from geort_drake.live.transports import Receiver, wait_for
from geort_drake.people.checks import anatomy, refuse
from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.people.recording import SIDES, Recording
from geort_drake.systems.port_values import vector_to_pose

# How often messages are fetched, s; and how long before the loop's ticks, so that these see the newest.
POLL_PERIOD, _AHEAD = 0.002, 1e-4
# A sender whose clock differs by less has this machine's, s.
_SAME_CLOCK_S = 1.0
# A frame that took so much longer than the quickest one is late, s.
LATEST_S = 0.2
# What is taken for the quickest grows by so much a second, because clocks drift apart by up to 100 ppm each.
_DRIFT = 2e-4
_HANDSHAKE_FRAMES = 5
_CHECKS = (
    anatomy.check_depth,
    anatomy.check_order,
    anatomy.check_unit,
    anatomy.check_frame,
    anatomy.check_bones,
)
# A thumb's MCP farther behind the palm is another side's, m: two people's never is, mirrored it mostly is.
_BEHIND_M = 0.005
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
# Before the first frame: valid, stamp, sent, lateness; the clocks' offset, and when the last frame arrived.
_BEFORE = (0.0, 0.0, math.nan, 0.0, math.inf, math.nan)


class GloveStream(LeafSystem):
    """The newest frame that a glove sent. It holds until the next one, and says nothing before the first.

    Output ports:
        keypoints (63): p_HK, the 21 keypoints one after the other, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker; the identity where there is none.
        valid (1): 1 while the hand is tracked, 0 where it was lost or the frame is over `LATEST_S` late.
        stamp (1): when the keypoints were measured, s on the sender's clock; where the sender says no time,
            when they arrived.
        sent (1): the same on this machine's clock as far as is known: the stamp if the sender's clock is
            this machine's monotonic one, else when they arrived. NaN before the first.
        lateness (1): how much longer than the quickest frame the newest one took, s. That is told by arrival
            minus stamp, and so from the beginning of the sender's clock: who was late from the first frame
            on, by the same time, cannot be told from a clock that is set otherwise.

    Attributes:
        received: frames that were taken, and `late` those among them that came late.
        clock_offset: the quickest frame's arrival on this machine's clock minus its stamp, s; NaN before
            the first.
        refused: messages that could not be used, and `last_refusal` why the last one could not.

    State: what the ports give; messages are fetched in a discrete update every `POLL_PERIOD`.

    Args:
        receiver: where messages come from.
        side: of the hand that is wanted.
        glove_id: serial number of the wanted MANUS glove, where there are several.
        clock: this machine's monotonic clock, s.
    """

    def __init__(
        self,
        receiver: Receiver,
        side: str,
        glove_id: str | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):
        super().__init__()
        self._receiver, self._side, self._glove_id, self._clock = receiver, side, glove_id, clock
        self.received = self.refused = self.late = 0
        self.clock_offset = math.nan
        self.last_refusal = ""
        self._state = self.DeclareDiscreteState(np.array([*np.zeros(63), *_IDENTITY, *_BEFORE]))
        ticket = {self.discrete_state_ticket(self._state)}
        for name, part in (
            ("keypoints", slice(0, 63)),
            ("valid", slice(70, 71)),
            ("stamp", slice(71, 72)),
            ("sent", slice(72, 73)),
            ("lateness", slice(73, 74)),
        ):
            self.DeclareVectorOutputPort(
                name,
                part.stop - part.start,
                lambda context, output, part=part: output.SetFromVector(self._value(context)[part]),
                ticket,
            )
        self.DeclareAbstractOutputPort(
            "wrist_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            lambda context, output: output.set_value(vector_to_pose(self._value(context)[63:70])),
            ticket,
        )
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, POLL_PERIOD - _AHEAD, self._update)

    def handshake(self, timeout_s: float) -> None:
        """Waits for the first frames and looks whether they are a hand of the wanted side.

        Raises:
            MismatchError: another version, unit or hand.
            RecordingError: the keypoints are no hand, or not in the wanted frame, order or unit.
            LiveError: nothing usable came in time; says what was refused.
        """
        frames: list[GloveFrame] = []

        def poll() -> bool | None:
            frame = self._newest(at_handshake=True)
            if frame is not None and frame.p_HK is not None:
                frames.append(frame)
            return True if len(frames) >= _HANDSHAKE_FRAMES else None

        wait_for(poll, timeout_s, lambda: self._silence(timeout_s))
        points = np.stack([frame.p_HK for frame in frames if frame.p_HK is not None])
        t = np.arange(len(points), dtype=float)
        hand = Recording(t, points, np.ones(len(t), bool), metadata={"side": self._side})
        for check in _CHECKS:
            refuse("the glove", check(hand))
        _require_palm_side(points, self._side)

    def _silence(self, timeout_s: float) -> str:
        refused = f"; {self.refused} messages were refused, the last: {self.last_refusal}"
        return f"no hand came from the glove within {timeout_s:g} s" + (refused if self.refused else "")

    def _newest(self, at_handshake: bool = False) -> GloveFrame | None:
        """The newest usable frame that has arrived; older ones are not looked at."""
        for message in reversed(self._receiver.drain()):
            try:
                frame = decode(message, self._side, self._glove_id)
            except LiveError as error:
                if at_handshake and isinstance(error, MismatchError):
                    raise
                self.refused += 1
                self.last_refusal = str(error)
                continue
            if frame is not None:
                self.received += 1
                return frame
        return None

    def _value(self, context: Context) -> np.ndarray:
        return context.get_discrete_state(self._state).value()

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        frame = self._newest()
        if frame is None:
            return EventStatus.DidNothing()
        arrived = self._clock()
        stamp = arrived if frame.time is None else frame.time
        value = self._value(context).copy()
        sent = stamp if abs(arrived - stamp) < _SAME_CLOCK_S else arrived
        offset, arrived_before = value[74:76].tolist()
        if stamp < value[71]:  # the sender's clock was set back, or it is another sender's
            offset = math.inf
        if not math.isnan(arrived_before):
            offset += _DRIFT * (arrived - arrived_before)
        offset = self.clock_offset = min(offset, arrived - stamp)
        lateness = arrived - stamp - offset
        self.late += lateness > LATEST_S
        tracked = frame.p_HK is not None and lateness <= LATEST_S
        value[70:] = tracked, stamp, sent, lateness, offset, arrived
        if frame.p_HK is not None:
            value[:63] = frame.p_HK.ravel()
        if frame.X_WH is not None:
            value[63:70] = frame.X_WH
        discrete_state.get_mutable_vector(self._state).SetFromVector(value)
        return EventStatus.Succeeded()


def _require_palm_side(points: np.ndarray, side: str) -> None:
    """Looks whether the thumb of hands p_HK (T, 21, 3) is on the palm's side.

    Recordings are judged by which way the fingers bend, but straight ones bend backwards for seconds.

    Raises:
        MismatchError: it is behind the palm.
    """
    x = float(np.median(points[:, FINGER_KEYPOINTS["thumb"][1], 0]))
    if x < -_BEHIND_M:
        other = SIDES[1 - SIDES.index(side)]
        raise MismatchError(
            f"the glove: the thumb is {-1e3 * x:.0f} mm behind the palm, so this is a {other} hand or a "
            f"{side} one in mirrored axes"
        )

"""Decides which page operates the robot, and passes on its hands and commands."""

import dataclasses as dc
import itertools
import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from geort_drake.errors import GeortError, LiveError, MismatchError
from geort_drake.live.glove_stream import HANDSHAKE_FRAMES
from geort_drake.live.messages import GloveFrame
from geort_drake.live.web.hands import HandReader, PointerHand, RecordedHand
from geort_drake.live.web.messages import (
    VERSION,
    Command,
    Disengage,
    Engage,
    Fist,
    Hand,
    Hello,
    Lost,
    Pointer,
    Reset,
    decode,
)
from geort_drake.people.checks import require_wrist_frame_hand
from geort_drake.people.keypoints import FINGER_KEYPOINTS

# Time for which a fist must be held to be a command, s.
FIST_S = 1.0
# Time within which a second `engage` must confirm the first one of a real robot, s.
_CONFIRM_S = 5.0
_MAX_HANDS = 100  # most hands that wait for the loop
_PLAY_S = 1.0 / 60.0  # between two hands of a recording
# In a fist, but not around a cup, a fingertip is nearer to its knuckle than this fraction of its finger.
_FIST = 0.5


@dc.dataclass(frozen=True)
class RobotInfo:
    """Facts about the robot for the pages: see `welcome` in docs/reference/web-protocol.md."""

    side: str
    hand: str
    robot: str
    tasks: dict[str, list[str]]
    map: str
    instructions: dict[str, str] = dc.field(default_factory=dict)
    mount: str = "arm"
    hands: list[str] = dc.field(default_factory=list)
    mounts: list[str] = dc.field(default_factory=list)


@dc.dataclass
class Operator:
    """The page that operates the robot.

    Attributes:
        number: number of its connection.
        device: device of its `Hello`.
        pointer: the hand that its mouse moves.
        reader: reads its hands.
        time: time of its last hand, s on the page's clock.
        first_hands: its first hands (21, 3), m, until they are checked; None afterwards.
        fist_since: since when a fist has been held, s; None without one, infinite after its command.
        asked_at: when a confirmation was asked for, s.
    """

    number: int
    device: str
    reader: HandReader
    pointer: PointerHand = dc.field(default_factory=PointerHand)
    time: float = 0.0
    first_hands: list[np.ndarray] | None = dc.field(default_factory=list)
    fist_since: float | None = None
    asked_at: float = -math.inf


class OperatorStation:
    """Lets one page operate the robot while others watch; the `GloveSource` of the loop.

    The server's thread calls `join`, `take` and `leave`; the loop's calls `drain` and reads `commands`.

    Attributes:
        about: facts about the robot.
        commands: the operator's commands, oldest first.
        operator: the page that operates the robot; None if there is none.
        simulated_person: whether the operator, or the last one, watches a simulated person instead of moving
            the robot. A busy page that loses its connection finds the same trial when it is back.
        received, refused: number of hands passed on, and of messages that could not be used.
        last_refusal: why the last of them could not be used.
        refusing: why the operator's newest hand was refused, or "".
        fist: fraction of `FIST_S` for which a fist has been held.
        p_HK: the operator's last hand (21, 3), m; None while it is lost.

    Args:
        about: facts about the robot.
        clock: monotonic clock, s.
        play: returns the recorded hand of the device `recording`; None if there is none.
    """

    def __init__(
        self,
        about: RobotInfo,
        clock: Callable[[], float] = time.monotonic,
        play: Callable[[], RecordedHand] | None = None,
    ):
        self.about, self._clock, self._play = about, clock, play
        self._recorded_play: RecordedHand | None = None
        self.commands: deque[Command] = deque(maxlen=_MAX_HANDS)
        self.operator: Operator | None = None
        self.received = self.refused = 0
        self.last_refusal = self.refusing = ""
        self.fist = 0.0
        self.p_HK: np.ndarray | None = None
        self.simulated_person = False
        self._hands: deque[GloveFrame] = deque(maxlen=_MAX_HANDS)
        self._people: set[int] = set()

    @property
    def spectators(self) -> int:
        """Number of pages that only watch."""
        return len(self._people) - (self.operator is not None)

    def drain(self) -> list[GloveFrame]:
        """Returns the hands since the last call, oldest first."""
        operator, play = self.operator, self._recorded_play
        if operator is not None and operator.device == "recording" and play is not None:
            now = self._clock()
            if now - operator.time >= _PLAY_S:
                self._follow(operator, play.frame(now))
                operator.time = now
        hands = []
        while self._hands:
            hands.append(self._hands.popleft())
        return hands

    def change(self, about: RobotInfo) -> None:
        """Replaces the robot. The operator must introduce the hand anew; it may be of the other side."""
        if self.operator is not None and not self.simulated_person:
            self._leave_controls()
        self.about, self._recorded_play = about, None

    def join(self, person: int) -> dict[str, Any]:
        """Adds a connection, a spectator until its `hello`, and returns the first message to it."""
        self._people.add(person)
        return self.welcome(person)

    def leave(self, person: int) -> None:
        """Removes a connection. If it was the operator, the hand is lost and disengaged at once."""
        self._people.discard(person)
        if self._is_operator(person):
            self._leave_controls()

    def take(self, person: int, text: str | bytes) -> dict[str, Any] | None:
        """Handles a message.

        Returns:
            The answer, if there is one.

        Raises:
            GeortError: the message cannot be used; it is counted and otherwise ignored.
        """
        message = None
        try:
            message = decode(text)
            if isinstance(message, Hello):
                return self._greet(person, message)
            if self.operator is None or not self._is_operator(person):
                raise LiveError("only the operator moves the robot")
            if isinstance(message, Hand):
                self._pass_on(self.operator, message)
            else:
                self._ask(self.operator, message)
        except GeortError as error:
            self.refused += 1
            self.last_refusal = str(error)
            if self._is_operator(person) and isinstance(message, Hand | None):
                self.refusing = str(error)
            raise
        return None

    def _is_operator(self, person: int) -> bool:
        return self.operator is not None and self.operator.number == person

    def _greet(self, person: int, hello: Hello) -> dict[str, Any]:
        wants_controls = hello.role == "operator"
        if self._is_operator(person):
            self._leave_controls()
        if wants_controls and hello.device != "simulated" and hello.side != self.about.side:
            raise MismatchError(
                f"this is a {hello.side} hand, but the robot's is a {self.about.side} one: use the other hand"
            )
        if wants_controls and self.operator is None:
            if hello.device == "recording" and self._play is not None:
                self._recorded_play = self._recorded_play or self._play()
            self.simulated_person = hello.device == "simulated"
            self.operator = Operator(person, hello.device, HandReader(hello.side, hello.hand_length))
        return self.welcome(person)

    def welcome(self, person: int) -> dict[str, Any]:
        """Returns the message that tells a connection its role and the robot's facts."""
        role = "operator" if self._is_operator(person) else "spectator"
        return {"type": "welcome", "version": VERSION, "role": role, **dc.asdict(self.about)}

    def _leave_controls(self) -> None:
        assert self.operator is not None
        self._pass_on(self.operator, Lost(self.operator.time))
        self.commands.append(Disengage())
        self.operator, self.refusing = None, ""

    def _pass_on(self, operator: Operator, message: Hand) -> None:
        operator.time = message.t
        if isinstance(message, Lost):
            frame = operator.reader.lost(message.t)
        elif isinstance(message, Pointer):
            frame = operator.pointer.frame(message, self.about.side)
        else:
            frame = operator.reader.read(message)
            if operator.first_hands is not None:
                self._check_first_hands(operator, operator.first_hands, frame.p_HK)
                return
        self._follow(operator, frame)

    def _follow(self, operator: Operator, frame: GloveFrame) -> None:
        """Passes a frame on to the loop."""
        self.p_HK, self.refusing = frame.p_HK, ""
        # A fist counts as a command only of a person who is seen.
        if operator.device in ("camera", "headset", "scripted"):
            self._watch_fist(operator)
        self._hands.append(frame)
        self.received += frame.p_HK is not None

    def _check_first_hands(
        self, operator: Operator, hands: list[np.ndarray], p_HK: np.ndarray | None
    ) -> None:
        """Adds a hand to a person's first ones, and checks these as a glove's handshake does."""
        if p_HK is not None:
            hands.append(p_HK)
        if len(hands) == HANDSHAKE_FRAMES:
            operator.first_hands = []  # others must pass if these do not
            require_wrist_frame_hand(np.stack(hands), "the page's hand")
            operator.first_hands = None

    def _watch_fist(self, operator: Operator) -> None:
        if self.p_HK is None or not is_fist(self.p_HK):
            operator.fist_since, self.fist = None, 0.0
            return
        now = self._clock()
        if operator.fist_since is None:
            operator.fist_since = now
        self.fist = min(max((now - operator.fist_since) / FIST_S, 0.0), 1.0)
        if self.fist >= 1.0:
            operator.fist_since = math.inf  # a fist counts only once
            # A fist does not confirm that a real robot may move.
            if self.about.robot == "simulation":
                self.commands.append(Fist())

    def _ask(self, operator: Operator, command: Command) -> None:
        if isinstance(command, Reset):
            tasks = self.about.tasks
            for kind, name, names in (
                ("hand", command.hand, self.about.hands),
                ("mount", command.mount, self.about.mounts),
            ):
                if name not in (None, *names):
                    raise LiveError(f"no {kind} '{name}'; there are {', '.join(names) or 'none to choose'}")
            if command.task not in (None, *tasks):
                raise LiveError(f"no task '{command.task}'; there are {', '.join(tasks)}")
            objects = tasks[command.task] if command.task else [*itertools.chain(*tasks.values())]
            if command.object not in (None, *objects):
                raise LiveError(f"no object '{command.object}'; there are {', '.join(objects)}")
        if self.about.robot != "simulation":
            if isinstance(command, Reset):
                raise LiveError("a real robot moves here; only a simulation can be reset")
            now = self._clock()
            if isinstance(command, Engage) and now - operator.asked_at > _CONFIRM_S:
                operator.asked_at = now
                raise LiveError(f"this moves a real robot: engage once more within {_CONFIRM_S:g} s")
        self.commands.append(command)


def is_fist(p_HK: np.ndarray) -> bool:
    """Whether all fingers but the thumb of a hand (21, 3) are closed."""
    for name, chain in FINGER_KEYPOINTS.items():
        points = p_HK[chain,]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        if name != "thumb" and np.linalg.norm(points[-1] - points[0]) > _FIST * length:
            return False
    return True

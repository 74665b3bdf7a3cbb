"""Half a minute of guided play, from which the map is fitted to a person."""

import numpy as np

from geort_drake.people.coverage import coverage
from geort_drake.people.protocol import STEPS
from geort_drake.people.recording import Recording

# Steps of the capture protocol → s. The rest takes longer than half a minute.
_SECONDS = {
    "flat hand": 3.0,
    "fists": 5.0,
    "spread": 4.0,
    "thumb alone": 6.0,
    "thumb to index": 3.0,
    "thumb to middle": 3.0,
    "thumb to ring": 3.0,
    "thumb to little": 3.0,
}
DURATION_S = sum(_SECONDS.values())
_ENOUGH_HANDS = 100  # to judge what is missing


class GuidedPlay:
    """Tells a person what to do, and keeps the hands.

    Args:
        start: s.
        side: of the hand.
    """

    def __init__(self, start: float, side: str):
        self._start, self._side = start, side
        self._time = start
        self._t: list[float] = []
        self._p_HK: list[np.ndarray] = []

    @property
    def seconds_left(self) -> float:
        """Until the end, s."""
        return max(self._start + DURATION_S - self._time, 0.0)

    @property
    def instruction(self) -> str:
        """What the person should do now; empty at the end."""
        left = DURATION_S - self.seconds_left
        instructions = {step.name: step.instruction for step in STEPS}
        for name, seconds in _SECONDS.items():
            left -= seconds
            if left < 0.0:
                return instructions[name]
        return ""

    def see(self, time: float, p_HK: np.ndarray | None) -> None:
        """Keeps a hand (21, 3), m, at a time, s, unless it is lost or not newer than the last one."""
        if self.seconds_left > 0.0 and p_HK is not None and not (self._p_HK and p_HK is self._p_HK[-1]):
            self._t.append(time - self._start)
            self._p_HK.append(p_HK)
        self._time = time

    def missing(self) -> list[str]:
        """The motions that training still needs."""
        if len(self._t) < _ENOUGH_HANDS:
            return []
        return [
            f"{motion.name}: {motion.advice}"
            for motion in coverage(self.recording())
            # Half a minute holds no five pinches.
            if not (motion.enough or (motion.unit == "times" and motion.seen))
        ]

    def recording(self) -> Recording:
        """The hands so far, of which there is at least one."""
        t = np.array(self._t)
        metadata = {"side": self._side, "source": "guided play"}
        return Recording(t - t[0], np.array(self._p_HK), np.ones(len(t), bool), None, metadata)

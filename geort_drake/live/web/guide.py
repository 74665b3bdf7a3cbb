"""Guides a person through half a minute of play, to which the map is then fitted."""

import numpy as np

from geort_drake.people.coverage import coverage
from geort_drake.people.protocol import STEPS
from geort_drake.people.recording import Recording

# Step of the capture protocol → its duration, s. All steps would take longer than half a minute.
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
_ENOUGH_HANDS = 100  # number of hands needed to judge what is missing


class GuidedPlay:
    """Tells a person what to do, and collects their hands.

    Args:
        start: time of the start, s.
        side: "right" or "left", of the person's hand.
    """

    def __init__(self, start: float, side: str):
        self._start, self._side = start, side
        self._time = start
        self._t: list[float] = []
        self._p_HK: list[np.ndarray] = []

    @property
    def seconds_left(self) -> float:
        """Time until the end, s."""
        return max(self._start + DURATION_S - self._time, 0.0)

    @property
    def instruction(self) -> str:
        """Instruction for the person; empty after the end."""
        left = DURATION_S - self.seconds_left
        instructions = {step.name: step.instruction for step in STEPS}
        for name, seconds in _SECONDS.items():
            left -= seconds
            if left < 0.0:
                return instructions[name]
        return ""

    def see(self, time: float, p_HK: np.ndarray | None) -> None:
        """Adds a hand (21, 3), m, at `time`, s, unless it is lost or the same as the last one."""
        if self.seconds_left > 0.0 and p_HK is not None and not (self._p_HK and p_HK is self._p_HK[-1]):
            self._t.append(time - self._start)
            self._p_HK.append(p_HK)
        self._time = time

    def missing(self) -> list[str]:
        """Returns the motions that training still needs, with advice."""
        if len(self._t) < _ENOUGH_HANDS:
            return []
        return [
            f"{motion.name}: {motion.advice}"
            for motion in coverage(self.recording())
            # Half a minute is too short for enough pinches of each finger.
            if not (motion.enough or (motion.unit == "times" and motion.seen))
        ]

    def recording(self) -> Recording:
        """Returns the hands so far as a recording; there must be at least one."""
        t = np.array(self._t)
        metadata = {"side": self._side, "source": "guided play"}
        return Recording(t - t[0], np.array(self._p_HK), np.ones(len(t), bool), None, metadata)

"""Measures a person's hand for a map that serves many people, and notices another person's hand."""

from collections.abc import Callable

import numpy as np

from geort_drake.errors import GeortError
from geort_drake.people.keypoints import BONES, bone_lengths
from geort_drake.retargeting.universal import MEASURED_FRAMES

# Bone lengths are compared at this period, as averages over about this time, s.
_PERIOD, _AVERAGING_TIME = 0.1, 1.0
# It is another person's hand if bone lengths differ by more than this fraction plus this multiple of their
# spread. Of sixty people of `people.synthetic.population`, as devices measure them, none is taken for another
# one within half a minute, and 58 that follow another one are noticed within 2 s.
_CHANGE, _SPREADS = 0.03, 2.0

# Fields of a person's memory.
PERSON_FIELDS = [
    ("frames", float, (MEASURED_FRAMES, 21, 3)),  # measured keypoints p_HK, m
    ("count", float),  # number of measured frames
    ("difference", float, len(BONES)),  # mean logarithm of present over measured bone lengths
    ("spread", float),  # mean deviation from this
    ("compared", float),  # when they were last compared, s
]


class PersonMap:
    """The map of one person, which depends on the measured frames alone.

    Args:
        for_person: returns the map of the person in keypoints (N, 21, 3), m; raises GeortError for points
            that are no hand.
    """

    def __init__(self, for_person: Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]):
        self._for_person = for_person
        # The last result of `_map_of`, which takes 1 ms, and its frames. These are compared, not hashed,
        # because every update does so.
        self._frames = b""
        self._last: tuple[Callable[[np.ndarray], np.ndarray], np.ndarray] | None = None

    def measure(self, memory: np.void, p_HK: np.ndarray) -> bool:
        """Adds a frame (21, 3), m, to a memory with `PERSON_FIELDS`, unless the hand has been measured.

        Frames that are no hand are forgotten.

        Returns:
            Whether the hand has been measured.
        """
        count = int(memory["count"])
        if count == MEASURED_FRAMES:
            return True
        if count == 0 or not np.array_equal(memory["frames"][count - 1], p_HK):
            memory["frames"][count] = p_HK
            memory["count"] = count + 1
        if memory["count"] < MEASURED_FRAMES:
            return False
        try:
            self._map_of(memory)
        except GeortError:
            memory["count"] = 0
            return False
        memory["difference"], memory["spread"] = 0.0, 0.0
        return True

    def is_other_person(self, memory: np.void, p_HK: np.ndarray, time: float) -> bool:
        """Returns whether the latest frames, up to p_HK (21, 3), m, at `time`, s, show other bones."""
        if time - memory["compared"] >= _PERIOD - 1e-9:
            memory["compared"] = time
            change = _log_bones(p_HK) - self._map_of(memory)[1]
            share = _PERIOD / _AVERAGING_TIME
            memory["difference"] += share * (change - memory["difference"])
            deviation = np.abs(change - memory["difference"]).mean()
            memory["spread"] += share * (deviation - memory["spread"])
        return bool(np.abs(memory["difference"]).mean() > _CHANGE + _SPREADS * memory["spread"])

    def __call__(self, memory: np.void, p_HK: np.ndarray) -> np.ndarray:
        """Returns joint positions (n,), rad, for keypoints (21, 3), m, of the measured person."""
        return self._map_of(memory)[0](p_HK)

    def _map_of(self, memory: np.void) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]:
        """Returns the map, and the logarithms of the measured bone lengths (20,)."""
        frames = memory["frames"].tobytes()
        if self._last is None or frames != self._frames:
            p_HK = memory["frames"].copy()
            self._last = self._for_person(p_HK), np.median(_log_bones(p_HK), axis=0)
            self._frames = frames
        return self._last


def _log_bones(p_HK: np.ndarray) -> np.ndarray:
    """Returns the logarithms (..., 20) of the bone lengths, m, in keypoints (..., 21, 3), m."""
    return np.log(np.maximum(bone_lengths(p_HK), 1e-4))

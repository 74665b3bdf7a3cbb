"""How much of what training needs a recording shows already, and what is still to be recorded."""

import dataclasses

import numpy as np

from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.range_of_motion import ranges_deg, wanted_motions
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.people.summary import pinch_distances

# How often each finger should pinch. People who were asked for pinches make more than ten in five minutes.
PINCHES = 5
_RELEASE_M = 1.5 * PINCH_M  # a pinch ends when the tips are this far apart: jitter is no second pinch


@dataclasses.dataclass(frozen=True)
class Motion:
    """One motion that a recording should hold.

    Attributes:
        name: such as "ring moves sideways" or "thumb pinches ring".
        seen: how much of it there is, in `unit`.
        wanted: how much is enough.
        unit: "°" of range, or "times".
        frames: of pinches: in how many frames; None for other motions.
        advice: how a person makes it.
    """

    name: str
    seen: float
    wanted: float
    unit: str
    frames: int | None
    advice: str

    @property
    def enough(self) -> bool:
        """Whether training needs no more of it."""
        return self.seen >= self.wanted

    def __str__(self) -> str:
        if self.frames is not None:
            return f"{self.name}: {self.frames} frames, {self.seen:.0f} of {self.wanted:.0f} times"
        if self.seen < 0.2 * self.wanted:
            return f"{self.name}: none seen"
        return f"{self.name}: {self.seen:.0f}° of {self.wanted:.0f}°"


def coverage(recording: Recording) -> list[Motion]:
    """Every motion that training needs: the ranges of the fingers, then the pinches.

    Args:
        recording: with at least one valid frame.
    """
    p_HK = recording.p_HK[recording.valid]
    motions = []
    for finger in FINGER_NAMES:
        wanted = wanted_motions(finger)
        for name, degrees in ranges_deg(p_HK, finger).items():
            least, advice = wanted[name]
            motions.append(Motion(f"{finger} {name}", degrees, least, "°", None, advice))
    for finger, distance in pinch_distances(recording).items():
        frames = int((distance < PINCH_M).sum())
        advice = f"pinch thumb and {finger} at different places"
        motions.append(Motion(f"thumb pinches {finger}", pinches(distance), PINCHES, "times", frames, advice))
    return motions


def pinches(distance: np.ndarray) -> int:
    """How often tips at `distance` (N,), m, come together and part again."""
    # +1 where they touch, −1 where they are apart, 0 between: what was last of the two is what holds.
    state = np.where(distance < PINCH_M, 1, np.where(distance > _RELEASE_M, -1, 0))
    state = np.append(-1, state[state != 0])
    return int((np.diff(state) > 0).sum())

"""Observes a person frame by frame; `observe` does the same with all frames at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.retargeting.clouds import voxel_index
from geort_drake.retargeting.person_code import PLACE, Observation

WINDOW = 1000  # frames over which the shape of the hand is a median
RECENT = 40  # frames that are compared with earlier ones to detect another person
# Another person: log bone lengths change on average by more than CHANGE plus DEVIATIONS median deviations.
CHANGE, DEVIATIONS = 0.03, 1.5
MIN_BONE = 0.002  # m; a frame with a shorter bone shows no hand
_VOXELS = 4096  # along an axis, which covers 10 m around the wrist


@dataclass(frozen=True)
class PersonObserver:
    """The state of observing a person; each new frame gives a new observer.

    Attributes:
        finger_names: names of the F fingers.
        shapes: (T, F, 6) base point and three bone lengths of each finger in the last T ≤ `WINDOW` frames,
            m.
        visited: sorted numbers of the voxels that the fingertips visited.
        places: (F,) number of voxels that each fingertip visited.
        sums, squares: (F, 3), (F, 3, 3) sums of the first fingertip in each voxel and of its outer product.
    """

    finger_names: tuple[str, ...]
    shapes: np.ndarray
    visited: np.ndarray
    places: np.ndarray
    sums: np.ndarray
    squares: np.ndarray

    @classmethod
    def empty(cls, finger_names: Sequence[str]) -> "PersonObserver":
        """Makes an observer that has seen no frame."""
        F = len(finger_names)
        shapes, visited = np.zeros((0, F, 6)), np.zeros(0, dtype=np.int64)
        return cls(tuple(finger_names), shapes, visited, np.zeros(F), np.zeros((F, 3)), np.zeros((F, 3, 3)))

    def seeing(self, p_HK: np.ndarray) -> "PersonObserver":
        """Returns the observer after one more frame of finite keypoints p_HK (21, 3), m; a frame with a bone
        shorter than `MIN_BONE` is ignored."""
        chains = p_HK[[FINGER_KEYPOINTS[name] for name in self.finger_names]]
        bones = np.diff(chains, axis=1)
        lengths = np.sqrt(np.square(bones).sum(axis=2))
        if lengths.min() < MIN_BONE:
            return self
        shape = np.concatenate([chains[:, 0], lengths], axis=1)
        tips, F = chains[:, 3], len(self.finger_names)
        cells = voxel_index(tips, PLACE) + _VOXELS // 2
        numbers = ((np.arange(F) * _VOXELS + cells[:, 0]) * _VOXELS + cells[:, 1]) * _VOXELS + cells[:, 2]
        where = np.searchsorted(self.visited, numbers)
        known = where < len(self.visited)
        known[known] = self.visited[where[known]] == numbers[known]
        x = np.where(known[:, None], 0.0, tips)
        return replace(
            self,
            shapes=np.concatenate([self.shapes[-(WINDOW - 1) :], shape[None]]),
            visited=np.insert(self.visited, where[~known], numbers[~known]),
            places=self.places + ~known,
            sums=self.sums + x,
            squares=self.squares + x[:, :, None] * x[:, None, :],
        )

    def observation(self) -> Observation:
        """Returns the observation from all frames so far, at least one."""
        shape = np.median(self.shapes, axis=0)
        knuckles, lengths = shape[:, :3], shape[:, 3:].sum(axis=1)
        n = self.places[:, None]
        centre = self.sums / n
        scatter = self.squares - n[:, :, None] * centre[:, :, None] * centre[:, None, :]
        mean = (centre - knuckles) / lengths[:, None]
        return Observation(knuckles, lengths, self.places, mean, scatter / np.square(lengths)[:, None, None])

    def has_changed(self) -> bool:
        """Returns whether the last `RECENT` frames show other bones than those before, as of another person.

        A camera's errors count as deviations. With fewer than 2 `RECENT` frames, the result is False.
        """
        if len(self.shapes) < 2 * RECENT:
            return False
        bones = np.log(self.shapes[:, :, 3:])
        before, now = np.median(bones[:-RECENT], axis=0), np.median(bones[-RECENT:], axis=0)
        deviation = np.median(np.abs(bones[:-RECENT] - before), axis=0).mean()
        return bool(np.abs(now - before).mean() > CHANGE + DEVIATIONS * deviation)

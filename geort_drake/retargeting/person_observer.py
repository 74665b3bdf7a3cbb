"""Observes a person frame by frame, as `observe` does with all frames at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.retargeting.clouds import voxel_index
from geort_drake.retargeting.person_code import PLACE, Observation

WINDOW = 1000  # frames, whose medians are the shape of the hand
RECENT = 40  # frames that show another person
# They do if the logarithms of the bones' lengths change by more than this and these deviations, in the mean.
CHANGE, DEVIATIONS = 0.03, 1.5
MIN_BONE = 0.002  # m; frames with shorter ones are of no hand
_VOXELS = 4096  # along an axis, so places within 10 m of the wrist


@dataclass(frozen=True)
class PersonObserver:
    """What has been seen of a person; each new frame gives a new observer.

    Attributes:
        finger_names: F fingers.
        shapes: (T, F, 6) base point and the lengths of the three bones of each finger in the last frames, m;
            T is at most `WINDOW`.
        visited: sorted numbers of the voxels that the fingertips visited.
        places: (F,) how many.
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
        """An observer that has seen no frame."""
        F = len(finger_names)
        shapes, visited = np.zeros((0, F, 6)), np.zeros(0, dtype=np.int64)
        return cls(tuple(finger_names), shapes, visited, np.zeros(F), np.zeros((F, 3)), np.zeros((F, 3, 3)))

    def seeing(self, p_HK: np.ndarray) -> "PersonObserver":
        """The observer after one more frame of finite keypoints p_HK (21, 3), m; one with a bone shorter than
        `MIN_BONE` does not count."""
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
        """What the frames show; at least one has been seen."""
        shape = np.median(self.shapes, axis=0)
        knuckles, lengths = shape[:, :3], shape[:, 3:].sum(axis=1)
        n = self.places[:, None]
        centre = self.sums / n
        scatter = self.squares - n[:, :, None] * centre[:, :, None] * centre[:, None, :]
        mean = (centre - knuckles) / lengths[:, None]
        return Observation(knuckles, lengths, self.places, mean, scatter / np.square(lengths)[:, None, None])

    def has_changed(self) -> bool:
        """Whether the last `RECENT` frames show other bones than those before, as of another person.

        A camera's errors count as deviations. At least as many frames must have been seen before.
        """
        if len(self.shapes) < 2 * RECENT:
            return False
        bones = np.log(self.shapes[:, :, 3:])
        before, now = np.median(bones[:-RECENT], axis=0), np.median(bones[-RECENT:], axis=0)
        deviation = np.median(np.abs(bones[:-RECENT] - before), axis=0).mean()
        return bool(np.abs(now - before).mean() > CHANGE + DEVIATIONS * deviation)

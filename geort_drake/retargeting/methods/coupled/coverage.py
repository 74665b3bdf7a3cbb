"""Coverage targets of `geort_coupled`: robot voxels, each with the recorded hand that should reach it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.training.human_data import HUMAN_VOXEL
from geort_drake.retargeting.training.kinematics import HandKinematics

CONTEXTS = 12  # recorded hands with nearly the same fingertip; their other fingers differ
AVERAGED = 3  # of them at a time
MEMORY = 0.4  # weight of the latest trial in the mean over contexts
ANCHORS = 2000  # places of a fingertip that are searched at most
FRAMES = 4000  # a longer recording is thinned


class CoverageTargets:
    """Robot voxels, each with the recorded hand that comes nearest to it.

    A k-d tree searches the whole recording for many steps at once. A long recording is thinned, because its
    frames lie closer together than the map can tell apart.
    """

    def __init__(
        self,
        frames: torch.Tensor,
        kinematics: HandKinematics,
        voxels: Sequence[np.ndarray],
        seed: int,
    ):
        """Takes real frames (T, F, 3), m, and each finger's voxel centres (M, 3) in B, m."""
        self._frames, self._voxels = frames, voxels
        self._generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self._kinematics = kinematics
        self._fingers = [replace(kinematics, fingers=(finger,)) for finger in kinematics.fingers]
        tips = frames.numpy()
        rows = [at_most(ANCHORS, tips[:, i], HUMAN_VOXEL) for i in range(len(voxels))]
        kept = np.unique(np.concatenate(rows)) if len(tips) > FRAMES else np.arange(len(tips))
        self._rows = torch.tensor(kept)
        self._anchors = [torch.tensor(first) for first in rows]
        self._contexts = []
        for i, first in enumerate(rows):
            _, similar = cKDTree(tips[:, i]).query(tips[first, i], k=min(CONTEXTS, len(tips)))
            self._contexts.append(torch.tensor(similar.reshape(len(first), -1)))
        self._means: list[torch.Tensor] = []

    def nearest(self, network: CoupledNetwork, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Voxels (F, count, 3) in B, m, and the real frames (F, count, F, 3) that come nearest to them."""
        with torch.no_grad():
            p_BF = self._kinematics.fingertips(network(self._frames[self._rows]))
        targets, rows = self._search(p_BF.unbind(1), count)
        return targets, self._frames[self._rows[rows]]

    def nearest_in_context(self, network: CoupledNetwork, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """The same, nearest on average over poses of the other fingers.

        Returns:
            Voxels (F, count, 3) and hands (F, count, AVERAGED, F, 3): the finger's own tip is the same
            in each, the others are from recorded hands whose own tip is nearby.
        """
        for i, anchors in enumerate(self._anchors):
            hands = self._in_contexts(i, torch.arange(len(anchors)))
            with torch.no_grad():
                own = hands.flatten(0, 1)[None]
                angles = network.angles_by_finger(own[0, :0], own, slice(i, i + 1))
                tips = self._fingers[i].fingertips_by_finger(angles)
            mean = tips.reshape(len(anchors), AVERAGED, 3).mean(1)
            # Few contexts make a noisy mean, so it is averaged with that of earlier searches.
            if len(self._means) == i:
                self._means.append(mean)
            self._means[i] = torch.lerp(self._means[i], mean, MEMORY)
        targets, rows = self._search(self._means, count)
        # Fresh contexts, otherwise the map would reach the target only in those of the search.
        return targets, torch.stack([self._in_contexts(i, row) for i, row in enumerate(rows)])

    def _search(self, points: Sequence[torch.Tensor], count: int) -> tuple[torch.Tensor, torch.Tensor]:
        targets, rows = [], []
        for voxels, reached in zip(self._voxels, points, strict=True):
            chosen = voxels[self._rng.integers(len(voxels), size=count)]
            targets.append(chosen)
            rows.append(cKDTree(reached.numpy()).query(chosen)[1])
        places = torch.tensor(np.stack(targets), dtype=torch.float32)
        return places, torch.tensor(np.stack(rows))

    def _in_contexts(self, finger: int, rows: torch.Tensor) -> torch.Tensor:
        """Hands (M, AVERAGED, F, 3): a finger's tip at its anchors `rows`, the others from similar hands."""
        contexts = self._contexts[finger][rows]
        some = torch.randint(contexts.shape[1], (len(rows), AVERAGED), generator=self._generator)
        hands = self._frames[contexts.gather(1, some)]
        hands[:, :, finger] = self._frames[self._anchors[finger][rows], finger][:, None]
        return hands


def at_most(count: int, points: np.ndarray, size: float) -> np.ndarray:
    """Rows of the first point (N, 3) in each voxel, which grows from `size` until at most `count` remain."""
    while len(first := first_in_voxels(points, size)) > count:
        size *= 1.1
    return first

"""Which recorded hand should reach which place of the robot's space: `geort_coupled`'s coverage."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import nn

from geort_drake.retargeting.clouds import voxel_index
from geort_drake.retargeting.kinematics import HandKinematics

CONTEXTS = 12  # recorded hands with nearly the same fingertip; their other fingers differ
AVERAGED = 3  # how many of them are tried at a time
MEMORY = 0.4  # weight of the latest trial in the mean over contexts


class CoverageTargets:
    """Robot voxels, each with the recorded hand that comes nearest to it.

    Nearest is meant over the whole recording, so it is found for many steps at once with a k-d tree.

    Attributes:
        anchors: per finger, the rows of the frames that were the first in a voxel of its tip.
    """

    anchors: list[torch.Tensor]

    def __init__(
        self,
        frames: torch.Tensor,
        kinematics: HandKinematics,
        voxels: Sequence[np.ndarray],
        human_voxel: float,
        generator: torch.Generator,
        rng: np.random.Generator,
    ):
        """Takes real frames (T, F, 3), m, and each finger's voxel centres (M, 3) in B, m."""
        self._frames, self._voxels, self._generator, self._rng = frames, voxels, generator, rng
        self._fingers = [replace(kinematics, fingers=(finger,)) for finger in kinematics.fingers]
        self.anchors, self._contexts = [], []
        tips = frames.cpu().numpy()
        for i in range(len(voxels)):
            _, first = np.unique(voxel_index(tips[:, i], human_voxel), axis=0, return_index=True)
            self.anchors.append(torch.tensor(first))
            _, alike = cKDTree(tips[:, i]).query(tips[first, i], k=min(CONTEXTS, len(tips)))
            self._contexts.append(torch.tensor(alike.reshape(len(first), -1)))
        self._means: list[torch.Tensor] = []

    def nearest(self, p_BF: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Voxels (F, count, 3) in B, m, and the frames (F, count) whose tips p_BF (T, F, 3) are nearest."""
        return self._search([p_BF[:, i] for i in range(p_BF.shape[1])], count)

    def nearest_in_context(self, network: nn.Module, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """The same, nearest on average over what the other fingers may be doing.

        Returns:
            Voxels (F, count, 3) and hands (F, count, AVERAGED, F, 3): the finger's own tip is the same
            in each, the others are from recorded hands whose own tip is nearly there.
        """
        for i, anchors in enumerate(self.anchors):
            hands = self._in_contexts(i, torch.arange(len(anchors)))
            with torch.no_grad():
                tips = self._fingers[i].fingertips(network(hands.flatten(0, 1)))
            mean = tips.reshape(len(anchors), AVERAGED, 3).mean(1)
            # Few contexts at a time make a noisy mean, so that of earlier searches is remembered.
            if len(self._means) == i:
                self._means.append(mean)
            self._means[i] = torch.lerp(self._means[i], mean, MEMORY)
        targets, rows = self._search(self._means, count)
        # In other contexts than those of the search, or the map would learn to get there in these alone.
        return targets, torch.stack([self._in_contexts(i, row) for i, row in enumerate(rows)])

    def _search(self, points: Sequence[torch.Tensor], count: int) -> tuple[torch.Tensor, torch.Tensor]:
        targets, rows = [], []
        for voxels, reached in zip(self._voxels, points, strict=True):
            chosen = voxels[self._rng.integers(len(voxels), size=count)]
            targets.append(chosen)
            rows.append(cKDTree(reached.cpu().numpy()).query(chosen)[1])
        places = torch.tensor(np.stack(targets), dtype=torch.float32, device=self._frames.device)
        return places, torch.tensor(np.stack(rows))

    def _in_contexts(self, finger: int, rows: torch.Tensor) -> torch.Tensor:
        """Hands (M, AVERAGED, F, 3): a finger's tip at its anchors `rows`, the others from alike hands."""
        contexts = self._contexts[finger][rows]
        some = torch.randint(contexts.shape[1], (len(rows), AVERAGED), generator=self._generator)
        hands = self._frames[contexts.gather(1, some)]
        hands[:, :, finger] = self._frames[self.anchors[finger][rows], finger][:, None]
        return hands

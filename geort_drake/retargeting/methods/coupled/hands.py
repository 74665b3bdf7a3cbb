"""Hands that `geort_coupled` is asked about while it trains: recorded ones, displaced, or put together.

A recording holds a few minutes of what a person does. A map that was asked about recorded hands alone
follows them closely and strays from the next ones, so a share of the hands is moved off the recording.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.spatial import cKDTree

from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.methods.coupled.losses import pair_distances
from geort_drake.retargeting.training.criteria import pinch_weights
from geort_drake.retargeting.training.human_data import HumanData

if TYPE_CHECKING:
    from geort_drake.retargeting.methods.coupled.training import CoupledConfig

STEP_LAGS = (1, 2, 3, 4)  # frames
STEP_RANGE = (0.001, 0.03)  # m; shorter real steps are noise, longer ones gaps in the recording
COUNTED = 5000  # hands, among which others like a hand are counted


class TrainingHands:
    """Draws batches of human fingertips (N, F, 3) in H, m; all draws come from one generator.

    Attributes:
        frames: (T, F, 3) real instants.
        pairs: pairs of finger numbers that pinch.
        mean, scale: (F, 3) of each fingertip's cloud, m.
        points: number of places per finger name.
        pinch_frames: how many frames hold a pinch.
    """

    def __init__(
        self,
        p_HF: np.ndarray,
        finger_names: Sequence[str],
        config: "CoupledConfig",
        generator: torch.Generator,
    ):
        """Takes the successive fingertips (T, F, 3) of a recording, m.

        Raises:
            TrainingError: on unusable input, see `HumanData`.
        """
        self._config, self._generator = config, generator
        human = HumanData(p_HF, finger_names, config.human_voxel)
        if config.pinch_weight > 0:
            human.check_pinches(config.pinch_threshold)
        self.points, self.pairs = human.points, human.pairs
        self.mean, self.scale = torch.tensor(human.mean), torch.tensor(human.scale)
        self.frames = self._tensor(human.frames)
        # Where a finger is moved: real frames, uniform over the places that its tip visited.
        self._anchors = [
            torch.tensor(first_in_voxels(human.frames[:, i], config.human_voxel))
            for i in range(len(self.mean))
        ]
        # How likely a frame is drawn; None for all alike.
        self._odds = None
        if config.even_share > 0:
            odds = rarity(human.frames.reshape(len(human.frames), -1), config.posture_radius)
            odds = config.even_share * odds / odds.mean() + 1.0 - config.even_share
            self._odds = torch.tensor(odds)
        # Real steps of the recording, as numbers of frames in the order they were recorded.
        p_HF = np.asarray(p_HF, dtype=float)
        self._track = self._tensor(p_HF)
        steps = []
        for lag in STEP_LAGS:
            length = np.linalg.norm(p_HF[lag:] - p_HF[:-lag], axis=-1).max(axis=1)
            start = np.flatnonzero((length > STEP_RANGE[0]) & (length < STEP_RANGE[1]))
            steps.append(np.stack([start, start + lag], axis=1))
        self._steps = torch.tensor(np.concatenate(steps))
        self._weights = pinch_weights(self.frames, self.pairs, config.pinch_threshold, config.other_pinches)
        self._pinching = torch.nonzero(self._weights.sum(1) > 0)[:, 0]
        self.pinch_frames = len(self._pinching)
        distance = pair_distances(self.frames, self.pairs)
        self._near, self._near_pair = torch.nonzero(distance < config.pinch_reach, as_tuple=True)

    def recorded(self, count: int) -> torch.Tensor:
        """(count, F, 3) real instants."""
        return self.frames[self._some_of(None, count)]

    def recombined(self, count: int) -> torch.Tensor:
        """(count, F, 3) hands, each fingertip from an instant of its own."""
        fingers = self.frames.shape[1]
        rows = self.draw(len(self.frames), count * fingers).reshape(count, fingers)
        return self.frames[rows, torch.arange(fingers)]

    def one_moved(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Hands (F, count, F, 3) and displacements d (F, count, 3) of the finger of the first axis, m.

        Shares of the hands are recorded ones, made-up pinches, and such whose other fingers are from instants
        of their own. In the rest, recorded too, all places of the moved finger are alike.
        """
        config, fingers = self._config, self.frames.shape[1]
        rows = torch.stack([anchors[self.draw(len(anchors), count)] for anchors in self._anchors])
        hands = self._displaced(self.frames[rows].flatten(0, 1)).reshape(fingers, count, fingers, 3)
        shares = config.strange_hand_share, config.recorded_hand_share, config.pinching_hand_share
        strange, recorded, pinching = (int(share * count) for share in shares)
        others = self.recombined(fingers * strange).reshape(fingers, strange, fingers, 3)
        own = torch.eye(fingers, dtype=torch.bool)[:, None, :, None]
        hands[:, :strange] = torch.where(own, hands[:, :strange], others)
        if recorded:
            some = self._displaced(self.recorded(fingers * recorded))
            hands[:, strange : strange + recorded] = some.reshape(fingers, recorded, fingers, 3)
        if pinching and len(self._near):
            some, _ = self.made_up_pinches(fingers * pinching)
            # Those with strange fingers come first, and every finger should have its part of them.
            hands[:, count - pinching :] = some.reshape(pinching, fingers, fingers, 3).transpose(0, 1)
        d = self.normal((fingers, count, 3))
        length = torch.rand((fingers, count, 1), generator=self._generator)
        return hands, d / d.norm(dim=-1, keepdim=True) * (0.001 + 0.01 * length)

    def steps(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Hands (count, F, 3) and the same a few frames later; none where nothing moved."""
        pair = self._steps[self.draw(len(self._steps), count)]
        before, after = self._track[pair[:, 0]], self._track[pair[:, 1]]
        displaced = self._displaced(before)
        return displaced, after + (displaced - before)

    def pinches(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Up to 2 · count hands that pinch, real and made up, and the weights (N, P) of their pairs."""
        real = self._some_of(self._pinching, count)
        hands, weights = self.made_up_pinches(count)
        return torch.cat([self.frames[real], hands]), torch.cat([self._weights[real], weights])

    def made_up_pinches(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Hands (N, F, 3) of which a pair of fingertips was drawn together, and weights (N, P).

        They are left as far apart as in any pinch, in a recorded direction or near one, and the other fingers
        are displaced, or from another instant: the pair should meet whatever they do.
        """
        config = self._config
        some = self.draw(len(self._near), count)
        row, pair = torch.arange(len(some)), self._near_pair[some]
        near = self.frames[self._near[some]]
        hands = self._displaced(near)
        strange = int(config.strange_pinch_share * len(some))
        hands[:strange] = self.recorded(strange)
        weights = near.new_zeros((len(some), len(self.pairs)))
        if len(some):
            first, second = torch.tensor(self.pairs)[pair].T
            middle = 0.5 * (near[row, first] + near[row, second])
            middle = middle + config.pinch_spread * self.normal(middle.shape)
            half = 0.5 * (near[row, second] - near[row, first])
            if config.pinch_offset_spread > 0:  # no draw where it is off
                half = half + 0.5 * config.pinch_offset_spread * self.normal(half.shape)
            kept = torch.rand((len(some), 1), generator=self._generator)
            kept = 0.5 * config.pinch_threshold * kept / (half.norm(dim=-1, keepdim=True) + 1e-9)
            half = half * kept.clamp(max=1.0)
            hands[row, first], hands[row, second] = middle - half, middle + half
            weights[row, pair] = 1.0
        return hands, weights

    def normal(self, shape: Sequence[int]) -> torch.Tensor:
        """Standard normal numbers."""
        return torch.randn(shape, generator=self._generator)

    def _displaced(self, hands: torch.Tensor) -> torch.Tensor:
        """A copy in which every fingertip of a share of the hands (N, F, 3) is displaced."""
        config = self._config
        which = torch.rand((len(hands), 1, 1), generator=self._generator)
        offset = config.spread * self.normal(hands.shape)
        return hands + torch.where(which < config.spread_share, offset, 0.0)

    def _some_of(self, rows: torch.Tensor | None, count: int) -> torch.Tensor:
        """`count` of these frames' numbers, or of all; none where there are none."""
        there = len(self.frames if rows is None else rows)
        if self._odds is None or not there or not count:
            drawn = self.draw(there, count)
        else:
            odds = self._odds if rows is None else self._odds[rows]
            drawn = odds.multinomial(count, replacement=True, generator=self._generator)
        return drawn if rows is None else rows[drawn]

    def draw(self, length: int, count: int) -> torch.Tensor:
        """`count` numbers below `length`; none where there is nothing to draw from."""
        return torch.randint(max(length, 1), (count if length else 0,), generator=self._generator)

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32)


def rarity(points: np.ndarray, radius: float) -> np.ndarray:
    """For each point (N, D), distinct ones, one over the share of all that is within `radius` of it.

    Drawn with these odds, what was visited for long is no likelier than what was passed through. Of more than
    COUNTED points some are counted, evenly.
    """
    some = points[:: len(points) // COUNTED + 1]
    near = cKDTree(some).query_ball_point(points, radius, return_length=True)
    return len(some) / np.maximum(near, 1)

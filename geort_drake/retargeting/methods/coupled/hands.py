"""Training hands of `geort_coupled`: recorded, displaced, or combined from several frames.

A recording holds a few minutes of motion. A map trained on recorded hands alone follows them closely and
fails beside them, so a fraction of the hands is moved off the recording.
"""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.methods.coupled.config import MIXED_HAND_FRACTION, CoupledConfig
from geort_drake.retargeting.methods.coupled.losses import pair_distances
from geort_drake.retargeting.training.criteria import pinch_weights
from geort_drake.retargeting.training.human_data import HUMAN_VOXEL, HumanData

STEP_LAGS = (1, 2, 3, 4)  # frames
STEP_RANGE = (0.001, 0.03)  # m; shorter recorded steps are noise, longer ones gaps in the recording
PINCH_REACH = 0.030  # m; fingertips nearer than this are moved together to make up pinches
OTHER_PINCHES = 0.2  # weight of a pinching pair that is not the frame's nearest
SPREAD = 0.006  # m; standard deviation by which the fingertips of some hands are displaced
SPREAD_FRACTION = 0.3  # of the moved hands and of the steps that are displaced
POSTURE_RADIUS = 0.040  # m, over all fingertips; hands nearer than this are the same posture
COUNTED = 5000  # hands, among which those of the same posture are counted


class TrainingHands:
    """Draws batches of human fingertips (N, F, 3) in H, m; all draws come from one generator.

    Attributes:
        frames: (T, F, 3) recorded frames.
        pairs: pairs of finger numbers that pinch.
        mean, scale: (F, 3) of each fingertip's cloud, m.
        points: number of places per finger name.
        pinch_frames: how many frames hold a pinch.
    """

    def __init__(
        self,
        p_HF: np.ndarray,
        finger_names: Sequence[str],
        config: CoupledConfig,
        generator: torch.Generator,
    ):
        """Takes the successive fingertips (T, F, 3) of a recording, m.

        Raises:
            TrainingError: on unusable input, see `HumanData`.
        """
        self._config, self._generator = config, generator
        human = HumanData(p_HF, finger_names)
        if config.pinch_weight > 0:
            human.check_pinches()
        self.points, self.pairs = human.points, human.pairs
        self.mean, self.scale = torch.tensor(human.mean), torch.tensor(human.scale)
        self.frames = self._tensor(human.frames)
        # Frames in which a finger is moved, uniform over the places that its tip visited.
        self._anchors = [
            torch.tensor(first_in_voxels(human.frames[:, i], HUMAN_VOXEL)) for i in range(len(self.mean))
        ]
        # Odds of drawing a frame; None if all are equally likely.
        self._odds = None
        if config.even_fraction > 0:
            odds = rarity(human.frames.reshape(len(human.frames), -1), POSTURE_RADIUS)
            odds = config.even_fraction * odds / odds.mean() + 1.0 - config.even_fraction
            self._odds = torch.tensor(odds)
        # Recorded steps, as pairs of row numbers of the track.
        p_HF = np.asarray(p_HF, dtype=float)
        self._track = self._tensor(p_HF)
        steps = []
        for lag in STEP_LAGS:
            length = np.linalg.norm(p_HF[lag:] - p_HF[:-lag], axis=-1).max(axis=1)
            start = np.flatnonzero((length > STEP_RANGE[0]) & (length < STEP_RANGE[1]))
            steps.append(np.stack([start, start + lag], axis=1))
        self._steps = torch.tensor(np.concatenate(steps))
        self._weights = pinch_weights(self.frames, self.pairs, PINCH_M, OTHER_PINCHES)
        self._pinching = torch.nonzero(self._weights.sum(1) > 0)[:, 0]
        self.pinch_frames = len(self._pinching)
        distance = pair_distances(self.frames, self.pairs)
        self._near, self._near_pair = torch.nonzero(distance < PINCH_REACH, as_tuple=True)

    def recorded(self, count: int) -> torch.Tensor:
        """(count, F, 3) recorded frames."""
        return self.frames[self._some_of(None, count)]

    def recombined(self, count: int) -> torch.Tensor:
        """(count, F, 3) hands, each fingertip from another frame."""
        fingers = self.frames.shape[1]
        rows = self.draw(len(self.frames), count * fingers).reshape(count, fingers)
        return self.frames[rows, torch.arange(fingers)]

    def one_moved(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Hands (F, count, F, 3) and displacements d (F, count, 3) of the finger of the first axis, m.

        A fraction of the hands takes the other fingers from other frames, and a fraction are recorded frames.
        In the rest, also recorded, every place of the moved finger is equally likely.
        """
        config, fingers = self._config, self.frames.shape[1]
        rows = torch.stack([anchors[self.draw(len(anchors), count)] for anchors in self._anchors])
        hands = self._displaced(self.frames[rows].flatten(0, 1)).reshape(fingers, count, fingers, 3)
        mixed, recorded = int(MIXED_HAND_FRACTION * count), int(config.recorded_hand_fraction * count)
        others = self.recombined(fingers * mixed).reshape(fingers, mixed, fingers, 3)
        own = torch.eye(fingers, dtype=torch.bool)[:, None, :, None]
        hands[:, :mixed] = torch.where(own, hands[:, :mixed], others)
        if recorded:
            some = self._displaced(self.recorded(fingers * recorded))
            hands[:, mixed : mixed + recorded] = some.reshape(fingers, recorded, fingers, 3)
        d = self.normal((fingers, count, 3))
        length = torch.rand((fingers, count, 1), generator=self._generator)
        return hands, d / d.norm(dim=-1, keepdim=True) * (0.001 + 0.01 * length)

    def steps(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Hands (count, F, 3) and the same a few frames later; empty where nothing moved."""
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
        """Hands (N, F, 3) in which a pair of fingertips was moved together, and weights (N, P).

        The distance of the tips is that of some pinch, in a recorded direction or near one. The other fingers
        are displaced, or from another frame: the pair should meet whatever they do.
        """
        config = self._config
        some = self.draw(len(self._near), count)
        row, pair = torch.arange(len(some)), self._near_pair[some]
        near = self.frames[self._near[some]]
        hands = self._displaced(near)
        mixed = int(config.mixed_pinch_fraction * len(some))
        hands[:mixed] = self.recorded(mixed)
        weights = near.new_zeros((len(some), len(self.pairs)))
        if len(some):
            first, second = torch.tensor(self.pairs)[pair].T
            middle = 0.5 * (near[row, first] + near[row, second])
            middle = middle + config.pinch_spread * self.normal(middle.shape)
            half = 0.5 * (near[row, second] - near[row, first])
            if config.pinch_offset_spread > 0:  # no draw where it is off
                half = half + 0.5 * config.pinch_offset_spread * self.normal(half.shape)
            kept = torch.rand((len(some), 1), generator=self._generator)
            kept = 0.5 * PINCH_M * kept / (half.norm(dim=-1, keepdim=True) + 1e-9)
            half = half * kept.clamp(max=1.0)
            hands[row, first], hands[row, second] = middle - half, middle + half
            weights[row, pair] = 1.0
        return hands, weights

    def normal(self, shape: Sequence[int]) -> torch.Tensor:
        """Standard normal numbers."""
        return torch.randn(shape, generator=self._generator)

    def _displaced(self, hands: torch.Tensor) -> torch.Tensor:
        """A copy in which all fingertips of a fraction of the hands (N, F, 3) are displaced."""
        which = torch.rand((len(hands), 1, 1), generator=self._generator)
        offset = SPREAD * self.normal(hands.shape)
        return hands + torch.where(which < SPREAD_FRACTION, offset, 0.0)

    def _some_of(self, rows: torch.Tensor | None, count: int) -> torch.Tensor:
        """`count` of these row numbers of frames, or of all; empty where there are none."""
        available = len(self.frames if rows is None else rows)
        if self._odds is None or not available or not count:
            drawn = self.draw(available, count)
        else:
            odds = self._odds if rows is None else self._odds[rows]
            drawn = odds.multinomial(count, replacement=True, generator=self._generator)
        return drawn if rows is None else rows[drawn]

    def draw(self, length: int, count: int) -> torch.Tensor:
        """`count` numbers below `length`; empty where `length` is 0."""
        return torch.randint(max(length, 1), (count if length else 0,), generator=self._generator)

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32)


def rarity(points: np.ndarray, radius: float) -> np.ndarray:
    """For each of the distinct points (N, D), one over the fraction of all points within `radius` of it.

    With these odds, the time spent at a place does not matter. Of more than COUNTED points, only evenly
    chosen ones are counted.
    """
    some = points[:: len(points) // COUNTED + 1]
    near = cKDTree(some).query_ball_point(points, radius, return_length=True)
    return len(some) / np.maximum(near, 1)

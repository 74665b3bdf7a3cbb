"""Draws hands of one person or many: recorded, displaced, combined from several frames, or made to pinch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import first_in_voxels

ANCHORS = 400  # frames per person and finger, drawn uniformly over the finger's visited voxels
ANCHOR_VOXEL = 0.002  # m
PINCH_REACH = 0.035  # m; fingertips closer than this are moved together in synthetic pinches
APART = 0.030  # m; fingertips farther apart than this must not touch
NEARLY_APART = 0.027  # m; the loss of false pinches begins here
SPREAD, SPREAD_FRACTION = 0.006, 0.3  # m; deviation of fingertips, and the fraction of hands that have it
MIXED_FRACTION = 0.35  # fraction of moved hands whose other fingers are from other frames
STEP_LAGS = (1, 2, 3)  # frames
MOVED, STEPS, PINCHES = 20, 16, 14  # hands per person and batch; as many pinches again are synthetic

# Maps hands (G, N, F, 3), m, of G people with codes (G, C) to joint angles (G, N, n), rad.
Network = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class Hands:
    """A batch of hands of G people: fingertips (G, ·, F, 3) in H, m.

    Attributes:
        codes: (G, C) codes of the people.
        moved: hands whose finger `finger` (G, ·) moves by d (G, ·, 3), m, and −d.
        before, after: hands at the beginning and the end of recorded steps.
        pinching: hands whose pair `pinch_pair` (G, ·) meets where `pinched` (G, ·) is true.
    """

    codes: torch.Tensor
    moved: torch.Tensor
    finger: torch.Tensor
    d: torch.Tensor
    before: torch.Tensor
    after: torch.Tensor
    pinching: torch.Tensor
    pinch_pair: torch.Tensor
    pinched: torch.Tensor


class TrainingPeople:
    """People whose hands are drawn in batches with one generator; tensors are on one device.

    Attributes:
        p_HF: (N, T, F, 3) fingertips, m.
        pairs: pairs of finger numbers that pinch.
        codes: (N, K, C) K codes of each person; C is 0 for a map that needs none.
        reach: (N, F) number of places that a fingertip visits, over the average person's; at most 1.
        anchors: (N, F, ANCHORS) frames, drawn uniformly over the finger's visited voxels.
        closable: (P,) whether the robot's tips of each pair can touch; it is not asked for other pinches.
        pinch_frames: number of frames with a pinch.
    """

    def __init__(
        self,
        p_HF: np.ndarray,
        pairs: Sequence[tuple[int, int]],
        generator: torch.Generator,
        rng: np.random.Generator,
        codes: torch.Tensor,
        reach: torch.Tensor,
        pinch_spread: float,
        weights: Sequence[int],
        device: torch.device,
    ):
        """Takes the attributes above.

        Args:
            p_HF, pairs, codes, reach: see the attributes.
            generator, rng: draw the batches, on the CPU, and the anchors.
            pinch_spread: standard deviation of synthetic pinches from recorded ones, m.
            weights: relative frequency of each person in batches.
            device: device of the tensors.
        """
        people, _, fingers, _ = p_HF.shape
        anchors = np.zeros((people, fingers, ANCHORS), dtype=int)
        for i, finger in np.ndindex(people, fingers):
            rows = first_in_voxels(p_HF[i, :, finger], ANCHOR_VOXEL)
            anchors[i, finger] = rng.choice(rows, ANCHORS)
        self._generator, self.device, self.pairs = generator, device, tuple(pairs)
        self._pinch_spread = pinch_spread
        self._weighted = torch.arange(people).repeat_interleave(torch.tensor(weights)).to(device)
        self._first, self._second = torch.tensor(self.pairs, device=device).reshape(-1, 2).long().T
        self.p_HF, self.anchors = torch.tensor(p_HF, device=device), torch.tensor(anchors, device=device)
        self.codes, self.reach = codes.to(device), reach.to(device)
        self.closable = torch.ones(len(self.pairs), dtype=torch.bool, device=device)
        self._distances = self.pair_distances(self.p_HF)
        nearest = self._distances.min(-1).values
        self._pinching = [torch.nonzero(row < PINCH_M)[:, 0] for row in nearest]
        self._near = [torch.nonzero(row < PINCH_REACH)[:, 0] for row in nearest]
        self.pinch_frames = sum(map(len, self._pinching))

    def pair_distances(self, points: torch.Tensor) -> torch.Tensor:
        """Returns distances (..., P) of `pairs` of fingertips (..., F, 3); gradients are always finite."""
        d = points[..., self._first, :] - points[..., self._second, :]
        return torch.sqrt(d.square().sum(-1) + 1e-10)

    def draw(self, count: int) -> Hands:
        """Draws a batch of hands of `count` people."""
        people = self.draw_people(count)
        codes = self.codes[people, self.below(self.codes.shape[1], count)]
        rows = people[:, None]
        finger = self.below(self.p_HF.shape[2], count, MOVED)
        hands = self.p_HF[rows, self.anchors[rows, finger, self.below(ANCHORS, count, MOVED)]]
        mixed = (self._uniform(count, MOVED, 1) < MIXED_FRACTION) & ~self._one_hot(finger)
        hands = torch.where(mixed[..., None], self._recombined(people, MOVED), hands)
        d = self._normal(count, MOVED, 3)
        d = d / d.norm(dim=-1, keepdim=True) * (0.001 + 0.01 * self._uniform(count, MOVED, 1))
        start = self.below(self.p_HF.shape[1] - max(STEP_LAGS), count, STEPS)
        lag = torch.tensor(STEP_LAGS, device=self.device)[self.below(len(STEP_LAGS), count, STEPS)]
        offset = self._offset(count, STEPS)
        recorded, recorded_pair, recorded_pinched = self._recorded_pinches(people)
        synthetic, synthetic_pair, synthetic_pinched = self._synthetic_pinches(people)
        pinch_pair = torch.cat([recorded_pair, synthetic_pair], 1)
        return Hands(
            codes,
            moved=hands + self._offset(count, MOVED),
            finger=finger,
            d=d,
            before=self.p_HF[rows, start] + offset,
            after=self.p_HF[rows, start + lag] + offset,
            pinching=torch.cat([recorded, synthetic], 1),
            pinch_pair=pinch_pair,
            pinched=torch.cat([recorded_pinched, synthetic_pinched], 1) & self.closable[pinch_pair],
        )

    def draw_people(self, count: int) -> torch.Tensor:
        """Draws the numbers (count,) of people by their weights."""
        return self._weighted[self.below(len(self._weighted), count)]

    def below(self, limit: int, *shape: int) -> torch.Tensor:
        """Draws uniform integers from 0 to below `limit`."""
        return torch.randint(limit, shape, generator=self._generator).to(self.device)

    def displaced(self, hands: torch.Tensor, distance: float) -> torch.Tensor:
        """Displaces every fingertip by normal noise with standard deviation `distance`, m."""
        return hands + distance * self._normal(*hands.shape)

    def _recorded_pinches(self, people: torch.Tensor) -> tuple[torch.Tensor, ...]:
        chosen = torch.stack([self._draw_pinches(self._pinching[i]) for i in people.tolist()])
        distance, pair = self._distances[people[:, None], chosen].min(-1)
        return self.p_HF[people[:, None], chosen], pair, distance < PINCH_M

    def _synthetic_pinches(self, people: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Moves the nearest pair of hands together; the other fingers may be from other frames."""
        rows, shape = people[:, None], (len(people), PINCHES)
        chosen = torch.stack([self._draw_pinches(self._near[i]) for i in people.tolist()])
        hands = self.p_HF[rows, chosen]
        distance, pair = self._distances[rows, chosen].min(-1)
        first, second = self._first[pair], self._second[pair]
        a, b = (of_finger(hands, finger) for finger in (first, second))
        middle = 0.5 * (b + a) + self._pinch_spread * self._normal(*shape, 3)
        half = 0.5 * (b - a) + 0.002 * self._normal(*shape, 3)
        length = half.norm(dim=-1, keepdim=True) + 1e-9
        half = half * (0.5 * PINCH_M * self._uniform(*shape, 1) / length).clamp(max=1)
        elsewhere = self.p_HF[rows, self.below(self.p_HF.shape[1], *shape)]
        hands = torch.where(self._uniform(*shape, 1, 1) < 0.5, elsewhere, hands) + self._offset(*shape)
        hands = torch.where(self._one_hot(second)[..., None], (middle + half)[:, :, None], hands)
        hands = torch.where(self._one_hot(first)[..., None], (middle - half)[:, :, None], hands)
        return hands, pair, distance < PINCH_REACH

    def _recombined(self, people: torch.Tensor, count: int) -> torch.Tensor:
        fingers = self.p_HF.shape[2]
        rows = self.below(self.p_HF.shape[1], len(people), count, fingers)
        return self.p_HF[people[:, None, None], rows, torch.arange(fingers, device=self.device)]

    def _draw_pinches(self, rows: torch.Tensor) -> torch.Tensor:
        """Draws PINCHES of the rows, or of all frames if there are no rows."""
        return rows[self.below(len(rows), PINCHES)] if len(rows) else self.below(self.p_HF.shape[1], PINCHES)

    def _offset(self, *shape: int) -> torch.Tensor:
        chosen = self._uniform(*shape, 1, 1) < SPREAD_FRACTION
        return torch.where(chosen, SPREAD, 0.0) * self._normal(*shape, self.p_HF.shape[2], 3)

    def _one_hot(self, finger: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.one_hot(finger, self.p_HF.shape[2]).bool()

    def _uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=self._generator).to(self.device)

    def _normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=self._generator).to(self.device)


def of_finger(x: torch.Tensor, finger: torch.Tensor) -> torch.Tensor:
    """Selects from x (G, N, F, 3) the finger (G, N) of each hand: (G, N, 3)."""
    return x.gather(2, finger[..., None, None].expand(-1, -1, 1, 3))[:, :, 0]

"""Batches of people's hands for the training of the universal map, drawn from their play."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from geort_drake.people.keypoints import FINGER_KEYPOINTS, TIP_KEYPOINT
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.universal.person import hand_shape
from geort_drake.retargeting.universal.settings import UniversalSettings


@dataclass(frozen=True)
class Hands:
    """A batch of hands of G people: fingertips (G, ·, F, 3) in H, m.

    Attributes:
        shapes: (G, 4F) shapes of the people's hands, m.
        moved: hands whose finger `finger` (G, ·) moves by d (G, ·, 3), m.
        before, after: hands at the beginning and the end of recorded steps.
        pinching: hands whose pair `pinch_pair` (G, ·) meets where `pinched` (G, ·) is true.
        directions: directions (G, ·, F, 3) of the distal bones in `seen`.
    """

    shapes: torch.Tensor
    moved: torch.Tensor
    finger: torch.Tensor
    d: torch.Tensor
    before: torch.Tensor
    after: torch.Tensor
    pinching: torch.Tensor
    pinch_pair: torch.Tensor
    pinched: torch.Tensor
    directions: torch.Tensor

    @property
    def seen(self) -> torch.Tensor:
        """(G, ·, F, 3) the hands whose pinches, collisions and posture count."""
        return torch.cat([self.moved, self.after, self.pinching], 1)


class TrainingPeople:
    """People whose hands are drawn in batches with one generator.

    Attributes:
        shapes: (N, K, 4F) shapes of each person's hand, m, measured on different parts of their play.
        p_HF: (N, T, F, 3) fingertips, m.
        closable: (P,) whether the robot's tips of each pair can touch; it is not asked for other pinches.
    """

    def __init__(
        self,
        p_HK: np.ndarray,
        finger_names: Sequence[str],
        settings: UniversalSettings,
        generator: torch.Generator,
        rng: np.random.Generator,
        device: torch.device,
    ):
        """Takes keypoints p_HK (N, T, 21, 3), m; `rng` draws anchors and shapes, `generator` the batches."""
        people, self._settings, self._generator, self._device = len(p_HK), settings, generator, device
        thumb = list(finger_names).index("thumb")
        self.pairs = tuple((thumb, i) for i in range(len(finger_names)) if i != thumb)
        p_HF, directions = tips_and_directions(p_HK, finger_names)
        anchors = np.zeros((people, len(finger_names), settings.anchors), dtype=int)
        for i, finger in np.ndindex(*anchors.shape[:2]):
            rows = first_in_voxels(p_HF[i, :, finger], settings.anchor_voxel_m)
            anchors[i, finger] = rng.choice(rows, settings.anchors)
        shapes = [[hand_shape(part, finger_names) for part in self._parts(each, rng)] for each in p_HK]
        self._anchors = torch.tensor(anchors, device=device)
        self.shapes = torch.tensor(np.array(shapes), device=device)
        self._hands = torch.tensor(np.concatenate([p_HF, directions], -1), dtype=torch.float32, device=device)
        self.p_HF = self._hands[..., :3]
        self.closable = torch.ones(len(self.pairs), dtype=torch.bool, device=device)
        self._first, self._second = torch.tensor(self.pairs, device=device).reshape(-1, 2).T
        d = self.p_HF[:, :, self._first] - self.p_HF[:, :, self._second]
        self._distance, self._pair = d.norm(dim=-1).min(-1)
        self._pinching = [torch.nonzero(row < PINCH_M)[:, 0] for row in self._distance]
        self._near = [torch.nonzero(row < settings.pinch_reach_m)[:, 0] for row in self._distance]

    def _parts(self, p_HK: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
        """Draws parts of a play (T, 21, 3): the whole, a frame, and windows of log-uniform lengths."""
        total, count = len(p_HK), self._settings.shapes_per_person
        lengths = [total, 1, *np.exp(rng.uniform(0.0, np.log(total), max(count - 2, 0))).astype(int)][:count]
        starts = [rng.integers(total - length + 1) for length in lengths]
        return [p_HK[start : start + length] for start, length in zip(starts, lengths, strict=True)]

    def draw(self) -> Hands:
        """Draws a batch."""
        s, (_, frames, fingers, _) = self._settings, self._hands.shape
        people = self._below(len(self._hands), s.people_per_batch)
        G, rows = len(people), people[:, None]
        finger = self._below(fingers, G, s.moved)
        moved = self._hands[rows, self._anchors[rows, finger, self._below(s.anchors, G, s.moved)]]
        other = self._below(frames, G, s.moved, fingers)
        other = self._hands[rows[..., None], other, torch.arange(fingers, device=self._device)]
        mixed = (self._uniform(G, s.moved, 1) < s.mixed) & ~self._one_hot(finger)
        moved = torch.where(mixed[..., None], other, moved)
        least, most = s.step_m
        d = torch.nn.functional.normalize(self._normal(G, s.moved, 3), dim=-1)
        d = d * (least + (most - least) * self._uniform(G, s.moved, 1))
        start = self._below(frames - max(s.step_lags), G, s.steps_per_person)
        lags = torch.tensor(s.step_lags, device=self._device)
        lag = lags[self._below(len(lags), G, s.steps_per_person)]
        before, after = self._hands[rows, start], self._hands[rows, start + lag]
        recorded = self._chosen(self._pinching, people)
        synthetic, synthetic_rows = self._synthetic_pinches(people)
        pinching = torch.cat([self._hands[rows, recorded], synthetic], 1)
        chosen = torch.cat([recorded, synthetic_rows], 1)
        pair, distance = self._pair[rows, chosen], self._distance[rows, chosen]
        reach = torch.full_like(distance, s.pinch_reach_m)
        reach[:, : s.pinches] = PINCH_M
        seen = [moved, after, pinching]
        offset = self._offset(G, sum(part.shape[1] for part in seen))
        offset[:, -2 * s.pinches : -s.pinches] = 0.0  # recorded pinches stay as they are
        moved_offset, step_offset, pinch_offset = offset.split([part.shape[1] for part in seen], dim=1)
        # Synthetic pinches are displaced before their fingertips are brought together.
        pinch_offset = torch.where(self._in_pair(pair)[..., None], 0.0, pinch_offset)
        return Hands(
            self.shapes[people, self._below(self.shapes.shape[1], G)],
            moved=moved[..., :3] + moved_offset,
            finger=finger,
            d=d,
            before=before[..., :3] + step_offset,
            after=after[..., :3] + step_offset,
            pinching=pinching[..., :3] + pinch_offset,
            pinch_pair=pair,
            pinched=(distance < reach) & self.closable[pair],
            directions=torch.cat(seen, 1)[..., 3:],
        )

    def _synthetic_pinches(self, people: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Moves the nearest pair of hands together; the other fingers may be from other frames.

        Returns the hands, and the frames (G, ·) of the pairs.
        """
        s, rows, shape = self._settings, people[:, None], (len(people), self._settings.pinches)
        chosen = self._chosen(self._near, people)
        hands, pair = self._hands[rows, chosen], self._pair[rows, chosen]
        first, second = self._first[pair], self._second[pair]
        a, b = (of_finger(hands, finger) for finger in (first, second))
        half = 0.5 * (b - a)[..., :3] + 0.002 * self._normal(*shape, 3)
        length = half.norm(dim=-1, keepdim=True) + 1e-9
        half = half * (0.5 * PINCH_M * self._uniform(*shape, 1) / length).clamp(max=1)
        middle = 0.5 * (a + b)[..., :3] + s.pinch_spread_m * self._normal(*shape, 3)
        elsewhere = self._hands[rows, self._below(self._hands.shape[1], *shape)]
        hands = torch.where(self._uniform(*shape, 1, 1) < 0.5, elsewhere, hands)
        for finger, point, direction in ((second, middle + half, b), (first, middle - half, a)):
            new = torch.cat([point, direction[..., 3:]], -1)[:, :, None]
            hands = torch.where(self._one_hot(finger)[..., None], new, hands)
        return hands, chosen

    def _chosen(self, candidates: Sequence[torch.Tensor], people: torch.Tensor) -> torch.Tensor:
        """Draws frames (G, pinches) of each person's candidates, or of all if there are none."""
        count = self._settings.pinches
        rows = [
            candidates[i][self._below(len(candidates[i]), count)]
            if len(candidates[i])
            else self._below(self._hands.shape[1], count)
            for i in people.tolist()
        ]
        return torch.stack(rows)

    def _in_pair(self, pair: torch.Tensor) -> torch.Tensor:
        return self._one_hot(self._first[pair]) | self._one_hot(self._second[pair])

    def _offset(self, *shape: int) -> torch.Tensor:
        chosen = (self._uniform(*shape, 1, 1) < self._settings.spread).float()
        return chosen * self._settings.spread_m * self._normal(*shape, self._hands.shape[2], 3)

    def _one_hot(self, finger: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.one_hot(finger, self._hands.shape[2]).bool()

    def _below(self, limit: int, *shape: int) -> torch.Tensor:
        return torch.randint(limit, shape, generator=self._generator).to(self._device)

    def _uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=self._generator).to(self._device)

    def _normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=self._generator).to(self._device)


def tips_and_directions(p_HK: np.ndarray, finger_names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Returns fingertips, m, and unit vectors along the distal bones, (..., F, 3), of p_HK (..., 21, 3)."""
    tips = p_HK[..., [TIP_KEYPOINT[name] for name in finger_names], :]
    u = tips - p_HK[..., [FINGER_KEYPOINTS[name][-2] for name in finger_names], :]
    return tips, u / np.maximum(np.linalg.norm(u, axis=-1, keepdims=True), 1e-9)


def of_finger(x: torch.Tensor, finger: torch.Tensor) -> torch.Tensor:
    """Selects from x (G, N, F, ·) the finger (G, N) of each hand: (G, N, ·)."""
    return x.gather(2, finger[..., None, None].expand(-1, -1, 1, x.shape[-1]))[:, :, 0]

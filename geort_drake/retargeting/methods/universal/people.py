"""Draws hands of many people: recorded, displaced, combined from several frames, or made to pinch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.person_code import AveragePerson, Observation, average_person, observe

CODES = 8  # per person: of a frame, of the whole play and of windows of random lengths
ANCHORS = 400  # per person and finger: frames such that every place of the finger is equally likely
ANCHOR_VOXEL = 0.002  # m
PINCH_REACH = 0.035  # m; fingertips nearer than this are moved together to make up pinches
APART = 0.030  # m; fingertips farther apart than this must not touch
NEARLY_APART = 0.027  # m; the loss of false pinches begins here
SPREAD, SPREAD_FRACTION = 0.006, 0.3  # m; displacement of the fingertips of a fraction of the hands
MIXED_FRACTION = 0.35  # of moved hands: the other fingers are from other frames
STEP_LAGS = (1, 2, 3)  # frames
MOVED, STEPS, PINCHES = 20, 16, 14  # hands per person and batch; as many pinches again are made up


@dataclass(frozen=True)
class Hands:
    """A batch of hands of G people, fingertips (G, ·, F, 3) in H, m.

    Attributes:
        codes: (G, C).
        moved: of which the finger `finger` (G, ·) moves by d (G, ·, 3) and −d.
        before, after: the beginning and the end of steps.
        pinching: the pair `pinch_pair` (G, ·) meets, where `pinched` (G, ·) is true.
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
    """People at play, of whom batches are drawn with one generator.

    Attributes:
        pairs: pairs of finger numbers that pinch: the thumb and each other finger.
        p_HF: (N, T, F, 3) fingertips, m.
        codes: (N, CODES, C) of each person; the first is of a single frame, the second of the whole play.
        average: the average person, with whom codes are made.
        reach: (N, F) places that a fingertip visits, over those of the average person; at most 1.
    """

    def __init__(self, p_HK: np.ndarray, finger_names: Sequence[str], generator: torch.Generator, seed: int):
        """Takes keypoints (N, T, 21, 3), m, of N people."""
        rng = np.random.default_rng(seed)
        tips = [TIP_KEYPOINT[name] for name in finger_names]
        thumb = list(finger_names).index("thumb")
        others = [i for i in range(len(finger_names)) if i != thumb]
        self.pairs = [(thumb, other) for other in others]
        self._thumb, self._others = thumb, torch.tensor(others)
        self._generator = generator
        observations = [[observe(part, finger_names) for part in _parts(each, rng)] for each in p_HK]
        whole = [row[1] for row in observations]
        self.average: AveragePerson = average_person(whole, observations)
        self.codes = torch.tensor(np.array([[self.average.code(one) for one in row] for row in observations]))
        self.p_HF = torch.tensor(p_HK[:, :, tips])
        self.reach = _relative_reach(whole)
        self.anchors = torch.zeros(len(p_HK), len(tips), ANCHORS, dtype=torch.long)
        for i, person in enumerate(p_HK):
            for finger, tip in enumerate(tips):
                rows = first_in_voxels(person[:, tip], ANCHOR_VOXEL)
                self.anchors[i, finger] = torch.tensor(rng.choice(rows, ANCHORS))
        self._distances = self.pair_distances(self.p_HF)
        nearest = self._distances.min(-1).values
        self._pinching = [torch.nonzero(row < PINCH_M)[:, 0] for row in nearest]
        self._near = [torch.nonzero(row < PINCH_REACH)[:, 0] for row in nearest]

    def pair_distances(self, points: torch.Tensor) -> torch.Tensor:
        """(..., P) distances of the `pairs` of fingertips (..., F, 3); with a finite gradient everywhere."""
        d = points[..., self._thumb, None, :] - points[..., self._others, :]
        return torch.sqrt(d.square().sum(-1) + 1e-10)

    def draw(self, count: int) -> Hands:
        """Hands of `count` people."""
        people = self.below(len(self.p_HF), count)
        codes = self.codes[people, self.below(CODES, count)]
        rows = people[:, None]
        finger = self.below(self.p_HF.shape[2], count, MOVED)
        hands = self.p_HF[rows, self.anchors[rows, finger, self.below(ANCHORS, count, MOVED)]]
        mixed = (self._uniform(count, MOVED, 1) < MIXED_FRACTION) & ~self._one_hot(finger)
        hands = torch.where(mixed[..., None], self._recombined(people, MOVED), hands)
        d = self._normal(count, MOVED, 3)
        d = d / d.norm(dim=-1, keepdim=True) * (0.001 + 0.01 * self._uniform(count, MOVED, 1))
        start = self.below(self.p_HF.shape[1] - max(STEP_LAGS), count, STEPS)
        lag = torch.tensor(STEP_LAGS)[self.below(len(STEP_LAGS), count, STEPS)]
        offset = self._offset(count, STEPS)
        real, real_pair, really = self._recorded_pinches(people)
        made, made_pair, possible = self._made_up_pinches(people)
        return Hands(
            codes,
            moved=hands + self._offset(count, MOVED),
            finger=finger,
            d=d,
            before=self.p_HF[rows, start] + offset,
            after=self.p_HF[rows, start + lag] + offset,
            pinching=torch.cat([real, made], 1),
            pinch_pair=torch.cat([real_pair, made_pair], 1),
            pinched=torch.cat([really, possible], 1),
        )

    def below(self, limit: int, *shape: int) -> torch.Tensor:
        """Whole numbers below `limit`."""
        return torch.randint(limit, shape, generator=self._generator)

    def displaced(self, hands: torch.Tensor, distance: float) -> torch.Tensor:
        """The hands with every fingertip displaced by normal numbers of this deviation, m."""
        return hands + distance * self._normal(*hands.shape)

    def _recorded_pinches(self, people: torch.Tensor) -> tuple[torch.Tensor, ...]:
        chosen = torch.stack([self._some(self._pinching[i]) for i in people.tolist()])
        distance, pair = self._distances[people[:, None], chosen].min(-1)
        return self.p_HF[people[:, None], chosen], pair, distance < PINCH_M

    def _made_up_pinches(self, people: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Hands in which the nearest pair was moved together; the other fingers may be from other frames."""
        rows, shape = people[:, None], (len(people), PINCHES)
        chosen = torch.stack([self._some(self._near[i]) for i in people.tolist()])
        hands = self.p_HF[rows, chosen]
        distance, pair = self._distances[rows, chosen].min(-1)
        other = self._others[pair]
        tip = hands.gather(2, other[..., None, None].expand(-1, -1, 1, 3))[:, :, 0]
        thumb = hands[:, :, self._thumb]
        middle = 0.5 * (tip + thumb) + 0.005 * self._normal(*shape, 3)
        half = 0.5 * (tip - thumb) + 0.002 * self._normal(*shape, 3)
        length = half.norm(dim=-1, keepdim=True) + 1e-9
        half = half * (0.5 * PINCH_M * self._uniform(*shape, 1) / length).clamp(max=1)
        elsewhere = self.p_HF[rows, self.below(self.p_HF.shape[1], *shape)]
        hands = torch.where(self._uniform(*shape, 1, 1) < 0.5, elsewhere, hands) + self._offset(*shape)
        hands = torch.where(self._one_hot(other)[..., None], (middle + half)[:, :, None], hands)
        is_thumb = self._one_hot(torch.full_like(other, self._thumb))
        hands = torch.where(is_thumb[..., None], (middle - half)[:, :, None], hands)
        return hands, pair, distance < PINCH_REACH

    def _recombined(self, people: torch.Tensor, count: int) -> torch.Tensor:
        fingers = self.p_HF.shape[2]
        rows = self.below(self.p_HF.shape[1], len(people), count, fingers)
        return self.p_HF[people[:, None, None], rows, torch.arange(fingers)]

    def _some(self, rows: torch.Tensor) -> torch.Tensor:
        """PINCHES of the rows, or of all frames where there is none."""
        return rows[self.below(len(rows), PINCHES)] if len(rows) else self.below(self.p_HF.shape[1], PINCHES)

    def _offset(self, *shape: int) -> torch.Tensor:
        chosen = self._uniform(*shape, 1, 1) < SPREAD_FRACTION
        return torch.where(chosen, SPREAD, 0.0) * self._normal(*shape, self.p_HF.shape[2], 3)

    def _one_hot(self, finger: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.one_hot(finger, self.p_HF.shape[2]).bool()

    def _uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=self._generator)

    def _normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=self._generator)


def _parts(p_HK: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """CODES parts of a play (T, 21, 3): a frame, all of it, and windows of log-uniform lengths."""
    total = len(p_HK)
    lengths = [1, total, *np.exp(rng.uniform(0.0, np.log(total), CODES - 2)).astype(int)]
    starts = [rng.integers(total - length + 1) for length in lengths]
    return [p_HK[start : start + length] for start, length in zip(starts, lengths, strict=True)]


def _relative_reach(whole: Sequence[Observation]) -> torch.Tensor:
    places = torch.tensor(np.array([each.places for each in whole]), dtype=torch.float32)
    return (places / places.mean(0)).clamp(max=1.0)

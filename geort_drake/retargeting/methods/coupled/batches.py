"""What each step of `geort_coupled`'s descent is asked: drawn and searched for beside the descent.

Nearest frames and near collisions change slowly, so they are looked for once for several steps, with a
copy of the map and beside the descent. What is found is some steps old when it is used.
"""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from geort_drake.retargeting.methods.coupled.coverage import CoverageTargets
from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.training.background import result_of
from geort_drake.retargeting.training.collision_geometry import CollisionGaps

if TYPE_CHECKING:
    from geort_drake.retargeting.methods.coupled.training import CoupledConfig

CROWDED_FROM = 0.1  # of the descent; nothing is known of collisions before the map has a shape
CROWDED = 600  # how many hands are looked through for near collisions at a time
REMEMBERED = 2000  # how many of those that nearly collided are kept
NEARLY = 0.001  # m beyond the margin, within which a hand nearly collides
COLLIDE_EVERY = 2  # steps; collisions cost a third of a step, and need not be in each


@dataclass(frozen=True)
class Crowd:
    """Hands (N, F, 3), m, most of which nearly collide: numbers of hand and pair (M,) of what is near."""

    hands: torch.Tensor
    row: torch.Tensor
    pair: torch.Tensor


@dataclass(frozen=True)
class Batch:
    """What one step is asked about; all in m, hands in H and targets in B.

    Attributes:
        moved, d: hands (F, N, F, 3) and the displacement (F, N, 3) of the first axis' finger.
        targets, covering: voxels (F, N, 3), and the hands (F, N, F, 3) that come nearest to them.
        context_targets, contexts: the same (F, N, 3), and hands (F, N, AVERAGED, F, 3).
        before, after: (M, F, 3) hands of recorded steps.
        pinching, weights: hands (N, F, 3), and how much each pair (N, P) should meet.
        crowd: what nearly collides; None in steps that do not look at it.
    """

    moved: torch.Tensor
    d: torch.Tensor
    targets: torch.Tensor
    covering: torch.Tensor
    context_targets: torch.Tensor
    contexts: torch.Tensor
    before: torch.Tensor
    after: torch.Tensor
    pinching: torch.Tensor
    weights: torch.Tensor
    crowd: Crowd | None


@dataclass(frozen=True)
class Prepared:
    """Several batches: what is of each finger by itself, what is of whole hands, and each one's crowd."""

    apart: tuple[torch.Tensor, ...]
    whole: tuple[torch.Tensor, ...]
    crowds: list[Crowd | None]

    def to(self, device: torch.device) -> "Prepared":
        """The same on another device."""
        crowds = [
            crowd and Crowd(crowd.hands.to(device), crowd.row.to(device), crowd.pair.to(device))
            for crowd in self.crowds
        ]
        apart, whole = ([tensor.to(device) for tensor in part] for part in (self.apart, self.whole))
        return Prepared(tuple(apart), tuple(whole), crowds)

    def batches(self) -> list[Batch]:
        """One for each crowd."""
        steps = len(self.crowds)
        # Every steps-th, as hands that were treated alike follow each other.
        apart = ([stack[:, step::steps] for stack in self.apart] for step in range(steps))
        whole = ([stack[step::steps] for stack in self.whole] for step in range(steps))
        return [
            Batch(*some, *others, crowd)  # type: ignore[arg-type, call-arg]  # lists of any length
            for some, others, crowd in zip(apart, whole, self.crowds, strict=True)
        ]


class Batches:
    """Hands out batches, `assign_every` prepared at a time."""

    def __init__(self, prepare: Callable[[CoupledNetwork, float], Future], device: torch.device):
        """`prepare` begins to call a `BatchMaker`; `device` is where the batches are wanted."""
        self._prepare, self._device = prepare, device
        self._ready: list[Batch] = []
        self._coming: Future | None = None

    def next(self, network: CoupledNetwork, progress: float) -> Batch | None:
        """The next batch for a map that is `progress` (0 to 1) through; None if it was not finite."""
        if not self._ready:
            found = result_of(self._coming or self._prepare(network, progress))
            self._coming = self._prepare(network, progress)
            if found is None:
                return None
            self._ready = found.to(self._device).batches()[::-1]
        return self._ready.pop()


class BatchMaker:
    """Prepares `assign_every` batches at each call."""

    def __init__(
        self,
        hands: TrainingHands,
        space: CoverageTargets,
        gaps: CollisionGaps | None,
        config: "CoupledConfig",
    ):
        """`gaps` is None where collisions are not avoided."""
        self._hands, self._space, self._gaps, self._config = hands, space, gaps, config
        self._crowded = hands.frames[:0]

    @torch.no_grad()
    def __call__(self, network: CoupledNetwork, progress: float) -> Prepared | None:
        """Of a map that is `progress` (0 to 1) through; None if it is not finite."""
        config, hands, steps = self._config, self._hands, self._config.assign_every
        if not torch.isfinite(network(hands.recorded(CROWDED))).all():
            return None
        moved, d = hands.one_moved(steps * config.points)
        targets, covering = self._space.nearest(network, steps * config.targets)
        context_targets, contexts = targets[:, :0], moved[:, :0, None]
        if config.context_weight > 0:
            count = steps * config.context_targets
            context_targets, contexts = self._space.nearest_in_context(network, count)
        crowds: list[Crowd | None] = [None] * steps
        if self._gaps is not None and progress >= CROWDED_FROM:
            crowds = self._crowds(network, self._gaps)
        before, after = hands.steps(steps * config.frames)
        pinching, weights = hands.pinches(steps * config.pinches)
        apart = (moved, d, targets, covering, context_targets, contexts)
        return Prepared(apart, (before, after, pinching, weights), crowds)

    def _crowds(self, network: CoupledNetwork, gaps: CollisionGaps) -> list[Crowd | None]:
        """For each step jittered hands, three quarters of them such in which something nearly touches."""
        config, hands, steps = self._config, self._hands, self._config.assign_every
        margin = config.collision_margin
        pinches, _ = hands.made_up_pinches(CROWDED // 8)
        candidates = torch.cat([hands.recorded(3 * CROWDED // 4), pinches, hands.recombined(CROWDED // 8)])
        touching = candidates[gaps.least(network(candidates), margin + 2 * NEARLY) < margin + NEARLY]
        self._crowded = torch.cat([touching, self._crowded])[:REMEMBERED]
        asked = range(0, steps, COLLIDE_EVERY)
        active = self._crowded[hands.draw(len(self._crowded), len(asked) * (3 * config.collisions // 4))]
        others = hands.recorded(len(asked) * config.collisions - len(active))
        crowded = torch.cat([active, others])
        crowded = crowded + config.jitter * hands.normal(crowded.shape)
        crowds: list[Crowd | None] = [None] * steps
        for number, step in enumerate(asked):
            some = crowded[number :: len(asked)]
            row, pair, gap = gaps.near(network(some), margin + 2 * NEARLY)
            near = gap < margin + 2 * NEARLY
            crowds[step] = Crowd(some, row[near], pair[near])
        return crowds

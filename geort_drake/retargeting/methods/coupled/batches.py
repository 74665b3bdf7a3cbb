"""Training batches of `geort_coupled`, prepared in the background.

Nearest frames and near collisions change slowly, so one search with a copy of the network serves several
steps. Its results are some steps old when they are used.
"""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import torch

from geort_drake.retargeting.methods.coupled.config import CoupledConfig
from geort_drake.retargeting.methods.coupled.coverage import CoverageTargets
from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.training.background import result_of
from geort_drake.retargeting.training.collision_geometry import CollisionGaps

STEPS_PER_SEARCH = 10
# Sizes of the batch of one step.
MOVED = 40  # hands per finger in which that finger is moved
TARGETS = 48  # robot voxels per finger
CONTEXT_TARGETS = 24  # the same, to be reached whatever the other fingers are doing
PINCHES = 64  # real frames with a pinch, and as many made-up ones
STEPS = 96  # recorded steps
COLLISIONS = 48  # hands whose collisions are computed
COLLIDE_EVERY = 2  # steps; collisions take a third of a step's time and need not be in each
COLLIDE_FROM = 0.1  # of training; collisions mean nothing before the map has a shape
SEARCHED = 600  # hands searched for near collisions at a time
REMEMBERED = 2000  # hands that nearly collided and are kept
NEARLY = 0.001  # m beyond the margin, within which a hand nearly collides


@dataclass(frozen=True)
class NearCollisions:
    """Hands (N, F, 3), m, most of them near self-collision; hand and pair numbers (M,) of near shapes."""

    hands: torch.Tensor
    row: torch.Tensor
    pair: torch.Tensor


@dataclass(frozen=True)
class Batch:
    """The inputs of one step; all in m, hands in H and targets in B.

    Attributes:
        moved, d: hands (F, N, F, 3) and the displacement (F, N, 3) of the first axis' finger.
        targets, covering: voxels (F, N, 3), and the hands (F, N, F, 3) that come nearest to them.
        context_targets, contexts: the same (F, N, 3), and hands (F, N, AVERAGED, F, 3).
        before, after: (M, F, 3) hands of recorded steps.
        pinching, weights: hands (N, F, 3), and how much each pair (N, P) should meet.
        near_collisions: None in steps without the collision loss.
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
    near_collisions: NearCollisions | None


@dataclass(frozen=True)
class Prepared:
    """Several batches: tensors with a first axis of fingers, tensors of whole hands, near collisions."""

    by_finger: tuple[torch.Tensor, ...]
    whole: tuple[torch.Tensor, ...]
    near_collisions: list[NearCollisions | None]

    def to(self, device: torch.device) -> "Prepared":
        """The same on another device."""
        near_collisions = [
            near and NearCollisions(near.hands.to(device), near.row.to(device), near.pair.to(device))
            for near in self.near_collisions
        ]
        by_finger, whole = ([tensor.to(device) for tensor in part] for part in (self.by_finger, self.whole))
        return Prepared(tuple(by_finger), tuple(whole), near_collisions)

    def batches(self) -> list[Batch]:
        """The batches, in order."""
        steps = len(self.near_collisions)
        # A batch takes every steps-th hand, because similar hands follow each other.
        by_finger = ([stack[:, step::steps] for stack in self.by_finger] for step in range(steps))
        whole = ([stack[step::steps] for stack in self.whole] for step in range(steps))
        return [
            Batch(*some, *others, near)  # type: ignore[arg-type, call-arg]  # lists of any length
            for some, others, near in zip(by_finger, whole, self.near_collisions, strict=True)
        ]


class Batches:
    """Returns batches one by one while the next ones are prepared."""

    def __init__(self, prepare: Callable[[CoupledNetwork, float], Future], device: torch.device):
        """`prepare` starts a call of a `BatchMaker`; `device` is where the batches are used."""
        self._prepare, self._device = prepare, device
        self._ready: list[Batch] = []
        self._pending: Future | None = None

    def next(self, network: CoupledNetwork, progress: float) -> Batch | None:
        """The next batch at `progress` (0 to 1) of training; None if the map was not finite."""
        if not self._ready:
            prepared = result_of(self._pending or self._prepare(network, progress))
            self._pending = self._prepare(network, progress)
            if prepared is None:
                return None
            self._ready = prepared.to(self._device).batches()[::-1]
        return self._ready.pop()


class BatchMaker:
    """Prepares `STEPS_PER_SEARCH` batches at each call."""

    def __init__(
        self,
        hands: TrainingHands,
        space: CoverageTargets,
        gaps: CollisionGaps | None,
        config: CoupledConfig,
    ):
        """`gaps` is None where collisions are ignored."""
        self._hands, self._space, self._gaps, self._config = hands, space, gaps, config
        self._remembered = hands.frames[:0]

    @torch.no_grad()
    def __call__(self, network: CoupledNetwork, progress: float) -> Prepared | None:
        """The batches at `progress` (0 to 1) of training; None if the map is not finite."""
        hands, steps = self._hands, STEPS_PER_SEARCH
        if not torch.isfinite(network(hands.recorded(SEARCHED))).all():
            return None
        moved, d = hands.one_moved(steps * MOVED)
        targets, covering = self._space.nearest(network, steps * TARGETS)
        context_targets, contexts = targets[:, :0], moved[:, :0, None]
        if self._config.context_weight > 0:
            context_targets, contexts = self._space.nearest_in_context(network, steps * CONTEXT_TARGETS)
        near_collisions: list[NearCollisions | None] = [None] * steps
        if self._gaps is not None and progress >= COLLIDE_FROM:
            near_collisions = self._near_collisions(network, self._gaps)
        before, after = hands.steps(steps * STEPS)
        pinching, weights = hands.pinches(steps * PINCHES)
        by_finger = (moved, d, targets, covering, context_targets, contexts)
        return Prepared(by_finger, (before, after, pinching, weights), near_collisions)

    def _near_collisions(self, network: CoupledNetwork, gaps: CollisionGaps) -> list[NearCollisions | None]:
        """For each step, jittered hands; three quarters of them nearly collided."""
        config, hands, steps = self._config, self._hands, STEPS_PER_SEARCH
        margin = config.collision_margin
        pinches, _ = hands.made_up_pinches(SEARCHED // 8)
        candidates = torch.cat([hands.recorded(3 * SEARCHED // 4), pinches, hands.recombined(SEARCHED // 8)])
        touching = candidates[gaps.least(network(candidates), margin + 2 * NEARLY) < margin + NEARLY]
        self._remembered = torch.cat([touching, self._remembered])[:REMEMBERED]
        colliding_steps = range(0, steps, COLLIDE_EVERY)
        count = len(colliding_steps) * (3 * COLLISIONS // 4)
        active = self._remembered[hands.draw(len(self._remembered), count)]
        chosen = torch.cat([active, hands.recorded(len(colliding_steps) * COLLISIONS - len(active))])
        chosen = chosen + config.jitter * hands.normal(chosen.shape)
        result: list[NearCollisions | None] = [None] * steps
        for number, step in enumerate(colliding_steps):
            some = chosen[number :: len(colliding_steps)]
            row, pair, gap = gaps.near(network(some), margin + 2 * NEARLY)
            near = gap < margin + 2 * NEARLY
            result[step] = NearCollisions(some, row[near], pair[near])
        return result

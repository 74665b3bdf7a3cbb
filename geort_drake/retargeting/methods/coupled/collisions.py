"""Remembers human hands whose robot postures nearly collide, while a map is trained."""

import torch

from geort_drake.retargeting.methods.coupled.people import STEPS, Hands, Network, TrainingPeople
from geort_drake.retargeting.training.collision_geometry import CollisionGaps

EVERY, SEARCH_EVERY = 2, 10  # steps between losses, and between searches
REMEMBERED, DRAWN = 4000, 96  # number of hands in the memory, and in a batch
NEAR, MARGIN, DEEP = 0.003, 0.001, -0.002  # m; gaps that are examined, wanted, and counted as collisions
SCALE = 0.0025  # m; unit of the depths in the loss
JITTER = 0.004  # m; standard deviation of the displacement of remembered fingertips


class NearCollisions:
    """Finds hands that nearly collide in batches, and computes a loss on the remembered ones."""

    def __init__(self, people: TrainingPeople, gaps: CollisionGaps):
        self._people, self._gaps = people, gaps
        fingers = people.p_HF.shape[2]
        self._hands = people.p_HF.new_zeros(0, fingers, 3)
        self._codes = people.codes.new_zeros(0, people.codes.shape[2])

    @torch.no_grad()
    def search(self, network: Network, hands: Hands) -> torch.Tensor:
        """Remembers the hands of a batch that nearly collide; returns the fraction of `after` colliding."""
        candidates = torch.cat([hands.after, hands.pinching, hands.moved], 1)
        q = network(candidates, hands.codes)
        least = self._gaps.least(q.flatten(0, 1), NEAR)
        found = least < MARGIN - 0.5 * DEEP
        codes = hands.codes[:, None].expand(-1, candidates.shape[1], -1).flatten(0, 1)
        self._hands = torch.cat([candidates.flatten(0, 1)[found], self._hands])[:REMEMBERED]
        self._codes = torch.cat([codes[found], self._codes])[:REMEMBERED]
        return (least.reshape(len(q), -1)[:, :STEPS] < DEEP).float().mean()

    def loss(self, network: Network) -> torch.Tensor:
        """Returns the mean depth beyond the margin over SCALE; zero while few hands are remembered."""
        if len(self._hands) < DRAWN:
            return self._hands.new_zeros(())
        chosen = self._people.below(len(self._hands), DRAWN)
        hands = self._people.displaced(self._hands[chosen], JITTER)
        q = network(hands[:, None], self._codes[chosen])[:, 0]
        row, pair, gap = self._gaps.near(q.detach(), NEAR)
        near = gap < NEAR
        return self._gaps.loss(q, row[near], pair[near], MARGIN, SCALE)

"""Coverage targets: robot fingertip positions, each with a person's hand that comes nearest."""

from collections.abc import Sequence

import torch

from geort_drake.retargeting.methods.coupled.people import Network, TrainingPeople
from geort_drake.retargeting.training.kinematics import HandKinematics

RADIUS = 0.010  # m; a target at this distance counts half
POOL = 8  # people whose targets are kept; one is replaced at each step
SEARCHED = 700  # hands of a person among which the nearest to a target is searched
TARGETS = 128  # per finger and person in the pool
PEOPLE, DRAWN = 6, 32  # people in a batch, and targets per finger of each


class CoverageTargets:
    """A pool of people, each with a code, targets per finger, and the hands whose fingertips come nearest.

    A search among many hands of a person serves several steps. It must be dense: among few hands, even the
    nearest one is far from a target that the map reaches.

    Attributes:
        reached: fraction of the targets that were reached within RADIUS in the latest search.
    """

    def __init__(
        self,
        people: TrainingPeople,
        kinematics: HandKinematics,
        voxels: Sequence[torch.Tensor],
        generator: torch.Generator,
    ):
        """Takes each finger's voxel centres (M, 3) in B, m."""
        self._people, self._kinematics, self._voxels = people, kinematics, voxels
        self._generator = generator
        self._pool: list[tuple[int, int, torch.Tensor, torch.Tensor]] = []
        self.reached = 0.0

    def loss(self, network: Network) -> torch.Tensor:
        """Returns the mean `coverage_loss` between targets and the fingertips of the nearest hands.

        A person's finger counts less if it visits fewer places than the average person's.
        """
        while len(self._pool) < POOL:
            self._pool.append(self._search(network))
        self._pool.append(self._search(network))
        self._pool.pop(0)
        people, fingers = self._people, len(self._voxels)
        chosen = torch.randperm(POOL, generator=self._generator)[:PEOPLE].tolist()
        number = torch.tensor([self._pool[i][0] for i in chosen], device=people.device)
        code = torch.tensor([self._pool[i][1] for i in chosen], device=people.device)
        drawn = people.below(TARGETS, PEOPLE, fingers, DRAWN)
        targets = torch.stack([self._pool[i][2] for i in chosen])
        targets = targets.gather(2, drawn[..., None].expand(-1, -1, -1, 3))
        rows = torch.stack([self._pool[i][3] for i in chosen]).gather(2, drawn)
        hands = people.p_HF[number[:, None], rows.flatten(1)]
        tips = self._kinematics.fingertips(network(hands, people.codes[number, code]))
        tips = tips.reshape(PEOPLE, fingers, DRAWN, fingers, 3).diagonal(dim1=1, dim2=3).movedim(-1, 1)
        weight = people.reach[number][..., None]
        return (weight * coverage_loss(tips, targets)).mean() / weight.mean()

    @torch.no_grad()
    def _search(self, network: Network) -> tuple[int, int, torch.Tensor, torch.Tensor]:
        """Draws a person, a code and targets (F, TARGETS, 3); finds rows (F, TARGETS) of nearest hands."""
        people = self._people
        number, code = int(people.draw_people(1)), int(people.below(people.codes.shape[1], 1))
        rows = people.anchors[number].flatten()
        rows = rows[torch.randperm(len(rows), generator=self._generator)[:SEARCHED]]
        hands = people.p_HF[number, rows][None]
        tips = self._kinematics.fingertips(network(hands, people.codes[number, code][None]))[0]
        targets = torch.stack([voxels[people.below(len(voxels), TARGETS)] for voxels in self._voxels])
        distance, nearest = torch.cdist(targets, tips.transpose(0, 1)).min(2)
        self.reached = float((distance < RADIUS).float().mean())
        return number, code, targets, rows[nearest]


def coverage_loss(points: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Computes d⁴ / (d⁴ + RADIUS⁴) ≤ 1 for the distances d between points and targets (..., 3), m."""
    fourth = ((points - targets) / RADIUS).square().sum(-1).square()
    return fourth / (fourth + 1.0)

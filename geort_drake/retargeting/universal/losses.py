"""What the universal map is asked for: an objective, and constraints whose multipliers adapt.

The objective is posture. Each constraint is a differentiable loss and a figure; its bound applies to the
figure. Distances of robot fingertips are in units of the fingertip radius, so that small hands close their
pinches.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch.nn.functional import cosine_similarity

from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.collision import CollisionGaps
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.universal.batches import Hands, of_finger
from geort_drake.retargeting.universal.settings import UniversalSettings

# Of robot fingertips in contact, in tip radii: their centres are two radii apart.
TOUCH = 2.0
# Maps hands (G, N, F, 3), m, of G people with shapes (G, 4F), m, to joint angles (G, N, n), rad.
Network = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


class DistalDirections:
    """Computes the unit vectors from each finger's last joint to its tip, in B."""

    def __init__(self, kinematics: HandKinematics):
        self._last_joints = kinematics.to_last_joints()
        lengths = [np.linalg.norm(chain.p_tip) for chain in kinematics.fingers]
        self._lengths = torch.tensor(np.array(lengths)[:, None])

    def __call__(self, q: torch.Tensor, tips: torch.Tensor) -> torch.Tensor:
        """Returns (..., F, 3) for joint angles q (..., n), rad, and the fingertips (..., F, 3) there, m."""
        return (tips - fingertips(self._last_joints, q)) / self._lengths.to(tips)


class Criteria:
    """Computes the objective and the constraints of a map.

    Args:
        kinematics: kinematics of the robot hand.
        pairs: pairs of finger numbers that pinch.
        size: (F,) the robot's motion over the person's, times the length of the person's finger, m; see
            `train.affine_size`.
        settings: weights and scales.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        pairs: Sequence[tuple[int, int]],
        size: torch.Tensor,
        settings: UniversalSettings,
    ):
        self._kinematics, self._settings, self._size = kinematics, settings, size
        self._first, self._second = (list(side) for side in zip(*pairs, strict=True))
        self._directions = DistalDirections(kinematics)
        few = [len(chain.joint_names) < 3 for chain in kinematics.fingers]
        self._few_joints = torch.tensor(few, device=size.device)

    def pair_distances(self, points: torch.Tensor) -> torch.Tensor:
        """Returns distances (..., P) of pinching pairs of fingertips (..., F, 3); gradients are finite."""
        d = points[..., self._first, :] - points[..., self._second, :]
        return torch.sqrt(d.square().sum(-1) + 1e-10)

    def __call__(
        self, network: Network, hands: Hands
    ) -> tuple[torch.Tensor, dict[str, tuple[torch.Tensor, torch.Tensor]]]:
        """Returns the objective, and loss and figure of each constraint except collision, by name."""
        one = torch.nn.functional.one_hot(hands.finger, hands.moved.shape[2])[..., None]
        seen = hands.seen
        parts = [seen, hands.moved + one * hands.d[:, :, None], hands.before]
        q = network(torch.cat(parts, 1), hands.shapes)
        tips = fingertips(self._kinematics, q)
        seen_tips, ahead, before = tips.split([part.shape[1] for part in parts], dim=1)
        moved, after, pinching = seen_tips.split(
            [hands.moved.shape[1], hands.after.shape[1], hands.pinching.shape[1]], dim=1
        )
        motion = ahead - moved
        finger_motion = of_finger(motion, hands.finger)
        cosine = cosine_similarity(finger_motion, hands.d, dim=-1, eps=1e-7)
        terms = {
            "direction": _same_figure(_worse_half((1.0 - cosine).mean(1))),
            "track": _same_figure(_worse_half(self._track(hands, after - before))),
            "cross_talk": _same_figure(_worse_half(_cross_talk(motion, hands.finger))),
            "size": self._size_error(finger_motion, cosine, hands),
            **self._pinches(hands, pinching),
            "false_pinch": self._false_pinches(seen, seen_tips),
        }
        directions = self._directions(q[:, : seen.shape[1]], seen_tips)
        return (1.0 - (directions * hands.directions).sum(-1)).mean(), terms

    def _track(self, hands: Hands, answer: torch.Tensor) -> torch.Tensor:
        """Returns (G,) the mean of 1 − cosine over the recorded steps of each person."""
        step = hands.after - hands.before
        length, (least, most) = step.norm(dim=-1), self._settings.step_range_m
        weight = ((length > least) & (length < most)).float()
        error = 1.0 - cosine_similarity(answer, step, dim=-1, eps=1e-7)
        return (error * weight).sum((1, 2)) / (weight.sum((1, 2)) + 1e-9)

    def _size_error(
        self, finger_motion: torch.Tensor, cosine: torch.Tensor, hands: Hands
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns the mean excess of the log gain over its band, and its frequency.

        A fingertip with fewer than three joints moves on a curve or a surface. Its gain refers to the
        component of d along its motion; motions that it hardly follows do not count.
        """
        settings, fingers = self._settings, hands.moved.shape[2]
        length = hands.shapes[:, 3 * fingers :].gather(1, hands.finger)
        reference = torch.log(self._size[hands.finger] / length)
        gain = (
            0.5 * torch.log((finger_motion.square().sum(-1) + 1e-10) / hands.d.square().sum(-1)) - reference
        )
        counted = torch.ones_like(gain)
        if self._few_joints.any():
            limited = self._few_joints[hands.finger]
            gain = torch.where(limited, gain - torch.log(cosine.clamp(min=settings.least_cosine)), gain)
            counted = (~limited | (cosine > settings.least_cosine)).float()
        low, high = settings.gain_band
        excess = torch.relu(low - gain) + torch.relu(gain - high)
        return _mean(excess, counted), _mean(excess > 0, counted)

    def _pinches(self, hands: Hands, tips: torch.Tensor) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
        settings, weight = self._settings, hands.pinched.float()
        distance = self.pair_distances(tips) / self._kinematics.tip_radius
        distance = distance.gather(-1, hands.pinch_pair[..., None])[..., 0]
        # Quadratic near the target, linear far from it.
        e = (distance - settings.pinch_target).abs() / settings.pinch_scale
        deep = torch.relu(settings.deep_margin - distance) / settings.depth_scale
        return {
            "open_pinch": (_mean(e.square() / (1.0 + e), weight), _mean(distance > TOUCH, weight)),
            "deep_pinch": (_mean(deep, weight), _mean(distance < settings.deep, weight)),
        }

    def _false_pinches(self, seen: torch.Tensor, tips: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        settings, human = self._settings, self.pair_distances(seen)
        distance = self.pair_distances(tips) / self._kinematics.tip_radius
        depth = torch.relu(TOUCH + settings.false_margin - distance) / settings.depth_scale
        nearly, apart = settings.apart_m
        return _mean(depth, human > nearly), _mean(distance < TOUCH, human > apart)


class NearCollisions:
    """Remembers hands whose robot postures nearly collide, and computes a loss on them.

    Few hands of a batch collide, so the loss of a batch alone would be too noisy.
    """

    def __init__(self, gaps: CollisionGaps, settings: UniversalSettings, generator: torch.Generator):
        self._gaps, self._settings, self._generator = gaps, settings, generator
        self.hands: torch.Tensor | None = None
        self.shapes: torch.Tensor | None = None

    @torch.no_grad()
    def search(self, network: Network, hands: Hands) -> torch.Tensor:
        """Remembers the hands of a batch that nearly collide; returns the fraction of `after` colliding."""
        settings, seen = self._settings, hands.seen
        margin, depth = settings.collision_margin_m, settings.collision_depth_m
        q = network(seen, hands.shapes)
        least = self._gaps.least(q.flatten(0, 1), settings.collision_near_m)
        near = least < margin + 0.5 * depth
        shapes = hands.shapes[:, None].expand(-1, seen.shape[1], -1).flatten(0, 1)[near]
        seen = seen.flatten(0, 1)[near]
        if self.hands is not None and self.shapes is not None:
            seen, shapes = torch.cat([seen, self.hands]), torch.cat([shapes, self.shapes])
        self.hands = seen[: settings.remembered_collisions]
        self.shapes = shapes[: settings.remembered_collisions]
        first = hands.moved.shape[1]
        recorded = least.reshape(len(q), -1)[:, first : first + hands.after.shape[1]]
        return (recorded < -depth).float().mean()

    def loss(self, network: Network) -> torch.Tensor | None:
        """Returns the mean depth beyond the margin; None while few hands are remembered."""
        settings = self._settings
        count = settings.drawn_collisions
        if self.hands is None or self.shapes is None or len(self.hands) < count:
            return None
        chosen = torch.randint(len(self.hands), (count,), generator=self._generator)
        hands = self.hands[chosen]
        noise = torch.randn(hands.shape, generator=self._generator).to(hands.device)
        q = network((hands + settings.collision_jitter_m * noise)[:, None], self.shapes[chosen])[:, 0]
        row, pair, gap = self._gaps.near(q.detach(), settings.collision_near_m)
        near = gap < settings.collision_near_m
        margin = settings.collision_margin_m
        return self._gaps.loss(q, row[near], pair[near], margin, settings.collision_scale_m)


class Multipliers:
    """One multiplier per constraint figure ≤ bound, adapted by multiplicative dual ascent.

    The figures of batches are noisy, so each is averaged over about fifty batches.

    Attributes:
        values: multiplier of each constraint.
        figures: running mean of each figure.
    """

    def __init__(self, bounds: Mapping[str, float], settings: UniversalSettings):
        self._bounds, self._settings = dict(bounds), settings
        self.values = dict.fromkeys(bounds, settings.multiplier_start)
        self.figures: dict[str, float] = {}

    def update(self, figures: Mapping[str, torch.Tensor]) -> None:
        """Updates the multipliers from the figures of a batch."""
        settings = self._settings
        least, most = settings.multiplier_bounds
        for name, figure in figures.items():
            value = float(figure.detach())
            mean = self.figures.get(name, value)
            self.figures[name] = mean = mean + settings.figure_averaging * (value - mean)
            violation = min(max(mean / self._bounds[name] - 1.0, -0.5), 1.5)
            rate = settings.collision_rate if name == "collision" else settings.multiplier_rate
            value = self.values[name] * math.exp(rate * violation)
            self.values[name] = min(max(value, least), most)


def _cross_talk(motion: torch.Tensor, finger: torch.Tensor, floor: float = 1e-4) -> torch.Tensor:
    """Returns (G,) the others' mean motion over the moved finger's; `floor`, m, keeps gradients finite."""
    length = torch.sqrt(motion.square().sum(-1) + floor**2) - floor
    length_moved = length.gather(2, finger[..., None])[..., 0]
    others = (length.sum(2) - length_moved) / (motion.shape[2] - 1)
    return others.mean(1) / (length_moved.mean(1) + floor)


def _worse_half(values: torch.Tensor) -> torch.Tensor:
    """Returns the mean over the half of the people (G,) for whom a figure is worse."""
    return values.topk((len(values) + 1) // 2).values.mean()


def _mean(values: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    return (values * weight).sum() / (weight.sum() + 1e-9)


def _same_figure(loss: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return loss, loss

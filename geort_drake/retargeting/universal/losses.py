"""What the universal map is asked for: an objective, and constraints whose multipliers adapt.

The objective is posture. Each constraint is a differentiable loss and a figure; its bound applies to the
figure. Distances of robot fingertips are in units of the fingertip radius, so that small hands close their
pinches. `UniversalSettings` has the bounds, and all other constants of the training.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import cosine_similarity

from geort_drake.errors import TrainingError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.base import thumb_and_others
from geort_drake.retargeting.collision import CollisionGaps
from geort_drake.retargeting.kinematics import fingertips

# Of robot fingertips in contact, in tip radii: their centres are two radii apart.
TOUCH = 2.0
# Maps hands (G, N, F, 3), m, of G people with shapes (G, 4F), m, to joint angles (G, N, n), rad.
Network = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
CONSTRAINTS = (
    "direction", "track", "size", "open_pinch", "deep_pinch", "false_pinch", "collision",
)  # fmt: skip


@dataclass(frozen=True)
class UniversalSettings:
    """The constants of the training, with their reasons. Lengths are in m unless a field says otherwise.

    `refined` changes some for the second stage.

    The first seven bounds apply to running means over training hands, many of which are harder than recorded
    ones. Bounds that exclude each other are exceeded; then `multiplier_bounds` weighs them.
    """

    steps: int = 10_000  # gradient steps, which take seven to nine minutes on one core
    people: int = 400  # hands of the population, so many that the shapes between them are interpolated
    play_s: float = 40.0  # length of each person's play, s, in which most people make all their movements
    # Bounds of the constraints:
    direction: float = 0.030  # 1 − mean cosine between motions of human and robot fingertips
    track: float = 0.030  # the same for recorded steps, in which all fingers move
    size: float = 0.35  # fraction of motions whose gain is below `least_gain`; a half would be the median
    open_pinch: float = 0.010  # fraction of pinches in which the robot's fingertips do not touch
    deep_pinch: float = 0.010  # fraction of pinches in which they overlap by most of their diameter
    false_pinch: float = 0.001  # fraction of pairs that touch although the person's are apart
    collision: float = 0.001  # fraction of hands in which links overlap by `collision_depth_m`
    # The objective:
    # From 10 to 5, motion preservation gains 0.002, and the angle loses 4° in the median and 14° at p90.
    posture_weight: float = 8.0
    posture_first: float = 4.0  # factor on it at first, because fingers keep a wrong posture once formed
    posture_first_share: float = 0.12  # fraction of the steps in which this factor falls to 1
    # Size:
    # Quantile of the affine fits of all people, which stands for those who use their range most, because the
    # shape of a hand does not tell how far its owner moves it.
    size_quantile: float = 0.05
    least_gain: float = 0.8  # gain over that fit's
    least_cosine: float = 0.3  # of a motion that a fingertip with one or two joints can follow
    # Pinches, with robot distances in fingertip radii, of which contact takes two:
    pinch_target: float = 0.875  # distance at which pinches aim, so that noise does not open them
    pinch_scale: float = 0.667  # distance from the target at which the loss turns from quadratic to linear
    deep: float = 0.333  # distance below which fingertips overlap by most of their diameter
    deep_margin: float = 0.5  # distance at which the loss of deep pinches begins
    false_margin: float = 0.25  # distance beyond contact at which the loss of false pinches begins
    depth_scale: float = 0.4  # unit of the depths of deep and false pinches
    apart_m: tuple[float, float] = (0.027, 0.030)  # human distances that the loss and the figure call apart
    # Self-collision:
    collision_near_m: float = 0.003  # gap below which pairs of links are examined
    collision_margin_m: float = 0.001  # gap that is wanted
    collision_remembered_m: float = 0.002  # gap below which a hand is remembered
    collision_depth_m: float = 0.002  # overlap that counts
    collision_scale_m: float = 0.0025  # unit of the loss
    collision_jitter_m: float = 0.004  # deviation of remembered fingertips, so that their surroundings count
    collision_every: int = 3  # steps from one loss to the next; one costs half a step
    collision_search_every: int = 20  # steps from one search to the next; one costs a step
    remembered_collisions: int = 4000  # hands; older ones are forgotten
    drawn_collisions: int = 64  # hands per loss
    # Batches:
    people_per_batch: int = 12  # a few, because the gradients of others average out over steps
    moved: int = 20  # hands of each person with one moved fingertip
    steps_per_person: int = 12  # recorded steps of each
    pinches: int = 8  # recorded pinches of each; as many again are synthetic
    step_m: tuple[float, float] = (0.001, 0.011)  # motions of one fingertip, as in evaluations
    step_range_m: tuple[float, float] = (0.001, 0.03)  # recorded steps: shorter are noise, longer are gaps
    step_lags: tuple[int, ...] = (1, 2, 3)  # frames between both hands of a step
    anchors: int = 400  # frames per person and finger, uniform over the finger's places
    anchor_voxel_m: float = 0.002  # edge of such a place
    shapes_per_person: int = 8  # shapes of all frames, of one, and of windows of random lengths
    mixed: float = 0.35  # fraction of moved hands whose other fingers are from other frames
    spread: float = 0.3  # fraction of hands whose fingertips are displaced, because play leaves gaps
    spread_m: float = 0.006  # standard deviation of these displacements
    pinch_reach_m: float = 0.035  # fingertips closer than this are moved together in synthetic pinches
    pinch_spread_m: float = 0.005  # standard deviation of synthetic pinches from recorded ones
    pinch_turn_m: float = 0.002  # standard deviation of both fingertips against each other, which turns them
    pinch_mixed: float = 0.5  # fraction of synthetic pinches whose other fingers are from other frames
    # Network:
    finger_units: int = 64  # width of both hidden layers of a finger
    residual_units: int = 128  # width of both hidden layers of the residual
    shape_units: int = 48  # width of both layers that process the shape
    # Descent:
    learning_rate: float = 0.003  # of SOAP; falls to zero along half a cosine
    warm_up: int = 100  # steps in which the learning rate rises
    weight_decay: float = 0.01  # of the fingers' networks
    shared_weight_decay: float = 0.03  # of parts that see combinations, which would fit the training's people
    momentum: tuple[float, float] = (0.95, 0.99)  # high, because gradients differ between people
    clip: float = 2.0  # largest norm of a gradient
    averages: int = 90  # the time constant of the average of the weights is `steps` divided by this
    average_every: int = 5  # steps from one average to the next, in which weights hardly move
    multiplier_start: float = 1.0  # of every constraint
    multiplier_rate: float = 0.006  # change of its logarithm per step at twice the bound
    # The same of collision, whose loss is on hands chosen because they collide; a fast multiplier would drown
    # all other losses.
    collision_rate: float = 0.0006
    # Limits of a figure's relative excess over its bound, so that a bad figure moves no multiplier far.
    violation_bounds: tuple[float, float] = (-0.5, 1.5)
    multiplier_bounds: tuple[float, float] = (0.1, 30.0)  # limits of a multiplier
    figure_averaging: float = 0.02  # weight of a batch in the running mean of a figure
    robot_samples: int = 60_000  # joint angles whose fingertips make up the robot's workspace

    def refined(self) -> "UniversalSettings":
        """Returns the settings of a second, shorter training, which continues from the first.

        The first leaves three times as many collisions as their bound allows. The second draws them more
        often and in larger numbers, weighs them more, and starts with large multipliers, so that no criterion
        is lost meanwhile. Posture and size weigh less, for what the collisions need.
        """
        return dataclasses.replace(
            self,
            steps=max(self.steps // 4, 1),
            learning_rate=self.learning_rate / 3.0,
            multiplier_start=20.0,
            posture_first=1.0,
            posture_weight=0.75 * self.posture_weight,
            size=1.2 * self.size,
            open_pinch=0.5 * self.open_pinch,
            collision=0.5 * self.collision,
            collision_rate=5.0 * self.collision_rate,
            collision_every=2,
            drawn_collisions=96,
        )

    def validate(self) -> None:
        """Raises TrainingError if a setting is out of range."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float) and not value > 0:
                raise TrainingError(f"training: {field.name} must be positive, it is {value}")


@dataclass(frozen=True)
class Hands:
    """A batch of hands of G people: fingertips (G, ·, F, 3) in H, m.

    Attributes:
        shapes: (G, 4F) shapes of the people's hands, m.
        moved: hands whose finger `finger` (G, ·) moves by d (G, ·, 3), m.
        before, after: hands at the beginning and the end of recorded steps.
        pinching: hands whose thumb and another finger, of the numbers `pinch_pair` (G, ·) among the others,
            meet where `pinched` (G, ·) is true.
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


class Criteria:
    """Computes the objective and the constraints of a map.

    Args:
        kinematics: kinematics of the robot hand.
        size: (F,) the robot's motion over the person's, times the length of the person's finger, m; see
            `train.affine_size`.
        settings: weights and scales.
    """

    def __init__(self, kinematics: HandKinematics, size: torch.Tensor, settings: UniversalSettings):
        self._kinematics, self._settings, self._size = kinematics, settings, size
        self._thumb, self._others = thumb_and_others(kinematics.finger_names)
        self._last_joints = kinematics.to_last_joints()
        lengths = np.array([np.linalg.norm(chain.p_tip) for chain in kinematics.fingers])
        self._last_lengths = torch.tensor(lengths[:, None], dtype=torch.float32, device=size.device)
        few = [len(chain.joint_names) < 3 for chain in kinematics.fingers]
        self._few_joints = torch.tensor(few, device=size.device)

    def pair_distances(self, points: torch.Tensor) -> torch.Tensor:
        """Returns distances (..., F − 1) of fingertips (..., F, 3) from the thumb's; gradients are finite."""
        d = points[..., [self._thumb], :] - points[..., self._others, :]
        return torch.sqrt(d.square().sum(-1) + 1e-10)

    def __call__(
        self, network: Network, hands: Hands
    ) -> tuple[torch.Tensor, dict[str, tuple[torch.Tensor, torch.Tensor]]]:
        """Returns the objective, and loss and figure of each constraint except collision, by name."""
        moved_finger = torch.nn.functional.one_hot(hands.finger, hands.moved.shape[2])[..., None]
        seen = hands.seen
        parts = [seen, hands.moved + moved_finger * hands.d[:, :, None], hands.before]
        q = network(torch.cat(parts, 1), hands.shapes)
        tips = fingertips(self._kinematics, q)
        seen_tips, ahead, before = tips.split([part.shape[1] for part in parts], dim=1)
        moved, after, pinching = seen_tips.split(
            [hands.moved.shape[1], hands.after.shape[1], hands.pinching.shape[1]], dim=1
        )
        finger_motion = of_finger(ahead - moved, hands.finger)
        cosine = cosine_similarity(finger_motion, hands.d, dim=-1, eps=1e-7)
        terms = {
            "direction": _worse_half((1.0 - cosine).mean(1)),
            "track": _worse_half(self._track(hands, after - before)),
            "size": self._size_error(finger_motion, cosine, hands),
            **self._pinches(hands, pinching),
            "false_pinch": self._false_pinches(seen, seen_tips),
        }
        directions = self.distal_directions(q[:, : seen.shape[1]], seen_tips)
        return (1.0 - (directions * hands.directions).sum(-1)).mean(), terms

    def distal_directions(self, q: torch.Tensor, tips: torch.Tensor) -> torch.Tensor:
        """Returns unit vectors (..., F, 3) in B from each finger's last joint to its tip.

        Args:
            q: joint angles (..., n), rad.
            tips: the fingertips (..., F, 3) at these angles in B, m.
        """
        return (tips - fingertips(self._last_joints, q)) / self._last_lengths

    def _track(self, hands: Hands, answer: torch.Tensor) -> torch.Tensor:
        """Returns (G,) the mean of 1 − cosine over the recorded steps of each person."""
        step = hands.after - hands.before
        length, (shortest, longest) = step.norm(dim=-1), self._settings.step_range_m
        weight = ((length > shortest) & (length < longest)).float()
        error = 1.0 - cosine_similarity(answer, step, dim=-1, eps=1e-7)
        return (error * weight).sum((1, 2)) / (weight.sum((1, 2)) + 1e-9)

    def _size_error(
        self, finger_motion: torch.Tensor, cosine: torch.Tensor, hands: Hands
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns by how much the log gain is too small on average, and how often it is.

        A fingertip with fewer than three joints moves on a curve or a surface. Its gain refers to the
        component of d along its motion; motions that it hardly follows do not count.
        """
        settings, fingers = self._settings, hands.moved.shape[2]
        length = hands.shapes[:, 3 * fingers :].gather(1, hands.finger)
        reference = torch.log(self._size[hands.finger] / length)
        gain = (
            0.5 * torch.log((finger_motion.square().sum(-1) + 1e-10) / hands.d.square().sum(-1)) - reference
        )
        is_limited = self._few_joints[hands.finger]
        gain = torch.where(is_limited, gain - torch.log(cosine.clamp(min=settings.least_cosine)), gain)
        weight = (~is_limited | (cosine > settings.least_cosine)).float()
        shortfall = torch.relu(math.log(settings.least_gain) - gain)
        return _mean(shortfall, weight), _mean(shortfall > 0, weight)

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
        self.memory: list[torch.Tensor] = []  # hands (M, F, 3), m, and their shapes (M, 4F), m

    @torch.no_grad()
    def search(self, network: Network, hands: Hands) -> torch.Tensor:
        """Remembers the hands of a batch that nearly collide; returns the fraction of `after` colliding."""
        settings, seen = self._settings, hands.seen
        q = network(seen, hands.shapes)
        gap = self._gaps.least(q.flatten(0, 1), settings.collision_near_m)
        is_near = gap < settings.collision_remembered_m
        shapes = hands.shapes[:, None].expand(-1, seen.shape[1], -1)
        memory = [each.flatten(0, 1)[is_near] for each in (seen, shapes)]
        if self.memory:
            memory = [torch.cat(pair) for pair in zip(memory, self.memory, strict=True)]
        self.memory = [each[: settings.remembered_collisions] for each in memory]
        first = hands.moved.shape[1]
        recorded_gap = gap.reshape(len(q), -1)[:, first : first + hands.after.shape[1]]
        return (recorded_gap < -settings.collision_depth_m).float().mean()

    def loss(self, network: Network) -> torch.Tensor | None:
        """Returns the mean depth beyond the margin; None while few hands are remembered."""
        settings = self._settings
        count = settings.drawn_collisions
        if not self.memory or len(self.memory[0]) < count:
            return None
        chosen = torch.randint(len(self.memory[0]), (count,), generator=self._generator)
        hands, shapes = (each[chosen] for each in self.memory)
        noise = torch.randn(hands.shape, generator=self._generator).to(hands.device)
        q = network((hands + settings.collision_jitter_m * noise)[:, None], shapes)[:, 0]
        _, _, gap = self._gaps.near(q, settings.collision_near_m)
        depth = torch.relu(settings.collision_margin_m - gap[gap < settings.collision_near_m])
        return depth.sum() / (settings.collision_scale_m * len(q))


def _worse_half(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns as loss and as figure the mean over the half of the people (G,) for whom it is worse."""
    mean = values.topk((len(values) + 1) // 2).values.mean()
    return mean, mean


def _mean(values: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    return (values * weight).sum() / (weight.sum() + 1e-9)


def of_finger(x: torch.Tensor, finger: torch.Tensor) -> torch.Tensor:
    """Selects from x (G, N, F, ·) the finger (G, N) of each hand: (G, N, ·)."""
    return x.gather(2, finger[..., None, None].expand(-1, -1, 1, x.shape[-1]))[:, :, 0]

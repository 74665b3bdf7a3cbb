"""The constraints of a training: for each a differentiable loss, and the figure to which its bound applies.

The robot's pinch distances are in units of the fingertip radius, so that small hands close their pinches.
"""

from dataclasses import dataclass

import torch
from torch.nn.functional import cosine_similarity

from geort_drake.retargeting.methods.coupled.people import (
    APART,
    NEARLY_APART,
    Hands,
    TrainingPeople,
    of_finger,
)
from geort_drake.retargeting.training.kinematics import HandKinematics

# Distances in fingertip radii.
TOUCH = 2.0  # of two tips in contact
PINCH_TARGET, PINCH_SCALE = 0.875, 0.667
DEEP, DEEP_MARGIN = 0.333, 0.5
FALSE_MARGIN = 0.25
SCALE = 0.4  # unit of the depths of deep and false pinches
GAIN_BAND = 0.6  # permitted deviation of the logarithm of the gain from its median
LEAST_COSINE = 0.3  # between a motion and that of a fingertip with few joints, if it can follow
STEP_RANGE = (0.001, 0.03)  # m; shorter steps are noise, longer ones gaps


@dataclass(frozen=True)
class RobotTips:
    """The robot's fingertips (G, ·, F, 3) in B, m, for the fields of `Hands` of the same names.

    `ahead` and `behind` are those of the moved hands with one finger displaced by d and −d.
    """

    moved: torch.Tensor
    ahead: torch.Tensor
    behind: torch.Tensor
    before: torch.Tensor
    after: torch.Tensor
    pinching: torch.Tensor


def constraint_terms(
    hands: Hands, robot: RobotTips, people: TrainingPeople, kinematics: HandKinematics
) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Returns loss and figure of each constraint except collision, by the names in `CoupledConfig`.

    With codes, direction, track and cross-talk are means over the half of the people for whom they are worse.
    """
    mean = _worse_half if people.codes.shape[2] else torch.mean
    motion = robot.ahead - robot.moved
    own = of_finger(motion, hands.finger)
    terms = {
        "direction": _same_figure(mean((1.0 - cosine_similarity(own, hands.d, dim=-1, eps=1e-7)).mean(1))),
        "track": _same_figure(mean(_track(hands, robot))),
        "cross_talk": _same_figure(mean(_cross_talk(motion, hands.finger))),
        "curvature": _same_figure(_curvature(hands, robot, own)),
        "uneven": _unevenness(own, hands, kinematics),
    }
    tip_radius = kinematics.tip_radius
    distance = people.pair_distances(robot.pinching) / tip_radius
    pinched = distance.gather(-1, hands.pinch_pair[..., None])[..., 0]
    weight = hands.pinched.float()
    terms["open_pinch"] = (_mean(pinch_loss(pinched), weight), _mean(pinched > TOUCH, weight))
    deep = torch.relu(DEEP_MARGIN - pinched) / SCALE
    terms["deep_pinch"] = (_mean(deep, weight), _mean(pinched < DEEP, weight))
    terms["false_pinch"] = _false_pinches(hands, robot, people, tip_radius)
    return terms


def pinch_loss(distance: torch.Tensor) -> torch.Tensor:
    """Computes e² / (1 + e) with e = |distance − target| / scale, in tip radii: quadratic, then linear."""
    e = (distance - PINCH_TARGET).abs() / PINCH_SCALE
    return e.square() / (1.0 + e)


def _track(hands: Hands, robot: RobotTips) -> torch.Tensor:
    """Returns (G,) the mean of 1 − cosine over the recorded steps of each person."""
    step, answer = hands.after - hands.before, robot.after - robot.before
    length = step.norm(dim=-1)
    long = (length > STEP_RANGE[0]) & (length < STEP_RANGE[1])
    error = 1.0 - cosine_similarity(answer, step, dim=-1, eps=1e-7)
    weight = long.float()
    return (error * weight).sum((1, 2)) / (weight.sum((1, 2)) + 1e-9)


def _cross_talk(motion: torch.Tensor, finger: torch.Tensor, floor: float = 1e-4) -> torch.Tensor:
    """Returns (G,) the others' mean motion over the moved finger's; `floor`, m, keeps gradients finite."""
    fingers = motion.shape[2]
    length = torch.sqrt(motion.square().sum(-1) + floor**2) - floor
    own = length.gather(2, finger[..., None])[..., 0]
    others = (length.sum(2) - own) / (fingers - 1)
    return others.mean(1) / (own.mean(1) + floor)


def _curvature(hands: Hands, robot: RobotTips, own: torch.Tensor) -> torch.Tensor:
    second = of_finger(robot.ahead + robot.behind - 2.0 * robot.moved, hands.finger)
    return (second.square().sum(-1).mean(1) / (own.square().sum(-1).mean(1) + 1e-12)).mean()


def _unevenness(
    own: torch.Tensor, hands: Hands, kinematics: HandKinematics
) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns the mean excess of log gain over the band around a person's median, and its frequency.

    A fingertip with fewer than three joints moves on a curve or a surface. Its gain refers to the component
    of d along its motion; motions that it hardly follows do not count.
    """
    gain = 0.5 * torch.log((own.square().sum(-1) + 1e-10) / hands.d.square().sum(-1))
    few_joints = torch.tensor([len(chain.joint_names) < 3 for chain in kinematics.fingers], device=own.device)
    counted = None
    if few_joints.any():
        limited = few_joints[hands.finger]
        along = cosine_similarity(own, hands.d, dim=-1, eps=1e-7)
        gain = torch.where(limited, gain - torch.log(along.clamp(min=LEAST_COSINE)), gain)
        counted = ~limited | (along > LEAST_COSINE)
    excess = torch.relu((gain - gain.detach().median(1, keepdim=True).values).abs() - GAIN_BAND)
    if counted is None:
        return excess.mean(), (excess > 0).float().mean()
    return _mean(excess, counted), _mean(excess > 0, counted)


def _false_pinches(
    hands: Hands, robot: RobotTips, people: TrainingPeople, tip_radius: float
) -> tuple[torch.Tensor, torch.Tensor]:
    human = people.pair_distances(torch.cat([hands.after, hands.pinching, hands.moved], 1))
    tips = torch.cat([robot.after, robot.pinching, robot.moved], 1)
    distance = people.pair_distances(tips) / tip_radius
    depth = torch.relu(TOUCH + FALSE_MARGIN - distance) / SCALE
    return _mean(depth, human > NEARLY_APART), _mean(distance < TOUCH, human > APART)


def _worse_half(values: torch.Tensor) -> torch.Tensor:
    """Returns the mean over the half of the people (G,) for whom a figure is worse."""
    return values.topk((len(values) + 1) // 2).values.mean()


def _mean(values: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    return (values * weight).sum() / (weight.sum() + 1e-9)


def _same_figure(loss: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return loss, loss

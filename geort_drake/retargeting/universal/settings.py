"""The settings of a training of the universal map."""

import dataclasses
from dataclasses import dataclass

from geort_drake.errors import TrainingError

CONSTRAINTS = (
    "direction", "track", "cross_talk", "size", "open_pinch", "deep_pinch", "false_pinch", "collision",
)  # fmt: skip


@dataclass(frozen=True)
class UniversalSettings:
    """All constants of the training, with their reasons. Lengths are in m unless a field says otherwise.

    The first eight bounds apply to running means over training hands, many of which are harder than recorded
    ones. Bounds that exclude each other are exceeded; then `multiplier_bounds` weighs them.
    """

    steps: int = 10_000  # gradient steps, which take nine minutes on one core
    people: int = 400  # hands of the population, so many that the shapes between them are interpolated
    play_s: float = 40.0  # length of each person's play, s, in which most people make all their movements
    # Bounds of the constraints:
    direction: float = 0.030  # 1 − mean cosine between motions of human and robot fingertips
    track: float = 0.030  # the same for recorded steps, in which all fingers move
    cross_talk: float = 0.040  # mean motion of the other fingertips over that of the moved one
    size: float = 0.35  # fraction of motions with a gain outside the band; at a half, its edge is the median
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
    gain_band: tuple[float, float] = (-0.22, 0.5)  # log of gain over that fit's: 20 % below to 65 % above
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
    # Network:
    finger_units: int = 64  # width of both hidden layers of a finger
    residual_units: int = 128  # width of both hidden layers of the residual
    shape_units: int = 48  # width of both layers that process the shape
    # Descent:
    learning_rate: float = 0.003  # of SOAP; falls to zero along half a cosine
    warm_up: int = 100  # steps in which the learning rate rises
    weight_decay: float = 0.01  # three times as much for parts that see combinations
    momentum: tuple[float, float] = (0.95, 0.99)  # high, because gradients differ between people
    clip: float = 2.0  # largest norm of a gradient
    averaged_steps: int = 90  # time constant of the average of the weights
    multiplier_start: float = 1.0  # of every constraint
    multiplier_rate: float = 0.006  # change of its logarithm per step at twice the bound
    # The same of collision, whose loss is on hands chosen because they collide; a fast multiplier would drown
    # all other losses.
    collision_rate: float = 0.0006
    multiplier_bounds: tuple[float, float] = (0.1, 30.0)  # limits of a multiplier
    figure_averaging: float = 0.02  # weight of a batch in the running mean of a figure
    robot_samples: int = 60_000  # joint angles whose fingertips make up the robot's workspace

    def refined(self) -> "UniversalSettings":
        """Returns the settings of a second, shorter training, which continues from the first.

        The first leaves three times as many collisions as their bound allows. The second searches them more
        often, weighs them more, and starts with large multipliers, so that no criterion is lost meanwhile.
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

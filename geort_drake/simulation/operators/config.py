"""Every parameter of the simulated person, with where its value comes from."""

import dataclasses as dc
import math

# Times, lengths and speeds that something is divided by.
_DIVISORS = (
    "period",
    "peak_wrist_speed",
    "peak_wrist_turn",
    "min_movement_time",
    "closing_lead",
    "squeeze_time",
)


@dc.dataclass
class OperatorConfig:
    """A person who teleoperates; one set of values for every method, object and hand.

    Sources: [S05] Saunders and Knill 2005, visual correction of reaching; [F65] Ferrell 1965, remote
    manipulation with delay; [FH85] Flash and Hogan 1985, minimum jerk; [HW98] Harris and Wolpert 1998,
    signal-dependent noise; [J89] Jones 1989, just noticeable differences of force; [R97] Riviere 1997,
    tremor of eye surgeons; [M] fingertip speeds measured on recorded glove play.
    """

    # Time between two decisions, s.
    period: float = 0.01
    # The scene is seen this late, s: visual corrections start after 117 ms (direction) to 200 ms
    # (distance) [S05]. A multiple of `period`.
    visual_delay: float = 0.18
    # Standard deviation of every seen coordinate, m: of the fingertips, the hand and the object.
    visual_noise: float = 0.001
    # Standard deviation of the seen rotation of hand and object about each axis, rad: `visual_noise` at a
    # lever of 0.1 m.
    visual_turn_noise: float = 0.01
    # Standard deviation of a felt contact force as a share of it; its just noticeable difference is 7 to
    # 10 % [J89].
    contact_noise: float = 0.1
    # The person moves a fingertip by this much per second for each metre of error that is seen and not
    # yet dealt with, 1/s. The naive gain: the robot's fingertip is taken to move like the own.
    correction_rate: float = 2.5
    # Fastest voluntary fingertip motion while shaping the hand, m/s; median to 95th percentile of free
    # play is 0.1 to 0.5 [M].
    max_fingertip_speed: float = 0.25
    # Fastest motion onto an object from the aperture just around it, m/s; people slow down before
    # contact.
    closing_speed: float = 0.02
    # Time constant with which a finger's speed changes, s.
    muscle_time_constant: float = 0.06
    # Standard deviation of motor noise as a share of the speed [HW98].
    motor_noise: float = 0.05
    # Root mean square of the fingertips' tremor, m [R97: 49 µm].
    tremor: float = 5e-5
    # Peak speeds of a minimum-jerk wrist movement [FH85], m/s and rad/s.
    peak_wrist_speed: float = 0.4
    peak_wrist_turn: float = 1.5
    # Shortest wrist movement, s.
    min_movement_time: float = 0.4
    # Pause after a wrist movement before its result is judged, on top of the visual delay, s: with delay,
    # people move and wait [F65]. What is judged is what was seen over about this time.
    judging_time: float = 0.09
    # After so many movements to one place the hand is taken to be as near as the arm gets it.
    max_corrections: int = 4
    # The hand counts as there and shaped within these, m and rad.
    reach_tolerance: float = 0.008
    turn_tolerance: float = 0.08
    shape_tolerance: float = 0.010
    # When the fingers' error has not fallen for this long, the fingers are seen to be at their limit, s;
    # then the whole hand is shifted by the middle of their errors, if that is above this, m.
    patience: float = 0.5
    shift_tolerance: float = 0.003
    # Before closing, the fingertips gather this far from the surface, m, each this well, m.
    aperture: float = 0.008
    aperture_tolerance: float = 0.007
    # Then they aim this far below the surface, m.
    overshoot: float = 0.02
    # A finger this far ahead of the slowest waits for it, m.
    closing_lead: float = 0.003
    # A seen contact force above this counts as touching, N.
    touch_force: float = 0.05
    # After all grasping fingers touch, the robot's fingertips are asked to go this much further inwards, m,
    # going by the gain that was sensed: 10 to 30 mm hold small objects at the hand's stiffness.
    squeeze: float = 0.02
    squeeze_time: float = 0.4
    # The hand is raised by this much, m, when the squeeze has settled for this long, s.
    settle_time: float = 0.2
    lift_height: float = 0.15
    # An object left behind by more than this is noticed as lost, m.
    lost_distance: float = 0.04

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"operator.{field.name} must be finite and not negative, not {value}")
        for name in _DIVISORS:
            if getattr(self, name) == 0:
                raise ValueError(f"operator.{name} must be positive, not 0")
        steps = self.visual_delay / self.period
        if abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"operator.visual_delay ({self.visual_delay}) must be a multiple of operator.period "
                f"({self.period})"
            )

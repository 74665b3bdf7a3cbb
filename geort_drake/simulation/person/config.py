"""Parameters of the simulated person, with their sources."""

import dataclasses as dc
import math

from geort_drake.settings import require_numbers

# Parameters by which code divides, so zero is refused.
_DIVISORS = (
    "period",
    "max_fingertip_speed",
    "closing_speed",
    "peak_wrist_speed",
    "peak_wrist_turn",
    "lowering_speed",
    "min_movement_time",
    "closing_lead",
    "squeeze_speed",
    "opening_speed",
    "press_time",
    "attention_time",
)


@dc.dataclass
class OperatorConfig:
    """Parameters of a person who teleoperates; one set of values serves every method, object and hand.

    Sources: [S05] Saunders and Knill 2005, visual correction of reaching; [F65] Ferrell 1965, remote
    manipulation with delay; [FH85] Flash and Hogan 1985, minimum jerk; [HW98] Harris and Wolpert 1998,
    signal-dependent noise; [J89] Jones 1989, just noticeable differences of force; [R97] Riviere 1997,
    tremor of eye surgeons; [B02] van Beers et al. 2002, vision in depth and in azimuth; [WJ84] Westling and
    Johansson 1984, forces of the precision grip; [F54] Fitts 1954, time of aimed movements; [H52] Hick 1952,
    time to choose; [JW88] Johansson and Westling 1988, force commands after lifts; [R98] Rayner 1998,
    fixations; [K00] Krakauer et al. 2000, adaptation to rotated and scaled motion; [M] fingertip speeds
    measured on recorded glove play.
    """

    # Time between two decisions, s.
    period: float = 0.01
    # Delay of vision, s; visual corrections start after 117 ms (direction) to 200 ms (distance) [S05]. A
    # multiple of `period`.
    visual_delay: float = 0.18
    # Standard deviations of the seen positions of fingertips and hand relative to the object, m: across the
    # line of sight, and along it, where vision is worse [B02]. The sizes are assumptions.
    visual_noise: float = 0.002
    visual_depth_noise: float = 0.005
    # Standard deviation of the seen rotation of hand and object about each axis, rad: `visual_noise` at a
    # radius of 0.1 m.
    visual_turn_noise: float = 0.02
    # Time constant of these errors, a first-order autoregressive process, s; 0 for white noise. Assumed, so
    # that people do not average the errors away.
    visual_noise_time: float = 1.0
    # Whether contact forces are felt. If not, closing ends when the fingers are seen to stop.
    touch: bool = True
    # Standard deviation of a felt contact force as a fraction of it; the just noticeable difference is 7 to
    # 10 % [J89].
    contact_noise: float = 0.1
    # Fingertip speed per seen error that is not yet corrected, 1/s. The person assumes that the robot's
    # fingertips move like their own.
    correction_rate: float = 2.5
    # Largest fingertip speed while shaping the hand, m/s; median and 95th percentile of free play are 0.1 and
    # 0.5 [M].
    max_fingertip_speed: float = 0.25
    # Largest fingertip speed from the aperture onto the object, m/s; people slow down before contact.
    closing_speed: float = 0.02
    # Time constant with which a finger's speed changes, s.
    muscle_time_constant: float = 0.06
    # Standard deviation of motor noise as a fraction of the speed [HW98].
    motor_noise: float = 0.05
    # Root mean square of the fingertips' tremor, m [R97: 49 µm].
    tremor: float = 5e-5
    # Peak speeds of a minimum-jerk wrist movement [FH85], m/s and rad/s.
    peak_wrist_speed: float = 0.4
    peak_wrist_turn: float = 1.5
    # Peak speed of a wrist that lowers an object onto something, m/s: people slow down before contact. An
    # assumption; the object is seen to stand after `visual_delay`, in which the hand moves by 9 mm.
    lowering_speed: float = 0.05
    # Shortest wrist movement, s.
    min_movement_time: float = 0.4
    # Pause after a wrist movement and the visual delay before the result is judged, s: with delay, people
    # move and wait [F65]. Vision is averaged over about this time.
    judging_time: float = 0.09
    # After this many movements, the person assumes that the arm cannot bring the hand nearer to its target.
    max_corrections: int = 4
    # Tolerances of the hand's position, m, its rotation, rad, and the fingertips, m.
    reach_tolerance: float = 0.008
    turn_tolerance: float = 0.08
    shape_tolerance: float = 0.010
    # If the fingertips' error has not fallen for `patience`, s, the fingers are at their limit. The hand then
    # shifts by the midrange of their errors, if that is larger than `shift_tolerance`, m.
    patience: float = 0.5
    shift_tolerance: float = 0.003
    # If the fingers are at their limit this long, s, after a phase began, the hand goes to the object all the
    # same. An assumption, made after the study of the others.
    shaping_time: float = 4.0
    # Least distance of the fingertips from the object's surface before closing, and its tolerance, m. The
    # distance is twice the error of vision if that is more: people open wider the less well they see (Wing,
    # Turton and Fraser 1986; Jakobson and Goodale 1991).
    aperture: float = 0.008
    aperture_tolerance: float = 0.007
    # Depth below the surface that closing fingertips aim for, m.
    overshoot: float = 0.02
    # A finger this far ahead of the slowest waits for it, m.
    closing_lead: float = 0.003
    # A felt force above this is a touch, N.
    touch_force: float = 0.05
    # After all grasping fingers touch, thumb and fingers press towards each other, the thumb at this speed,
    # m/s, until both sides feel the force of a grip, or a fingertip has moved by `squeeze`, m. The force is
    # that of a light grip, N, or this multiple of the object's weight if it is more: friction of 0.8 on two
    # sides needs 0.63, or 1.0 on a ball whose contacts are 15° above its middle, because the person sees no
    # better; a lift accelerates the object; and people hold about twice as much as a margin [WJ84].
    squeeze_speed: float = 0.03
    grip_force: float = 1.0
    grip_per_weight: float = 2.5
    squeeze: float = 0.02
    # After this time, s, the person lifts or turns all the same: people reach the force of a grip in 0.2 to
    # 0.5 s, and do not wait for every finger [WJ84].
    squeeze_time: float = 0.5
    # Factor on that force after each slip: people adapt their grip to the last lift [JW88]. The size is an
    # assumption.
    firmer: float = 1.5
    # Fingers that let go move off a surface at most at this speed, m/s, for at most this time, s.
    opening_speed: float = 0.1
    opening_time: float = 2.0
    # Pause after the squeeze, s, and height of the lift, m. A hand that is seen lower by more than the
    # tolerance, m, rises again: about five times the error of vision, an assumption, made after the study of
    # the others.
    settle_time: float = 0.2
    lift_height: float = 0.15
    lift_tolerance: float = 0.03
    # The object counts as lost after it has moved this far in the hand, m, or by four times the error of
    # vision if that is more.
    lost_distance: float = 0.04
    # Duration of a press or a release, s: 10 mm to within 3 mm are 2.7 bits of 0.1 s each [F54].
    press_time: float = 0.27
    # Time from a seen cue to the press, s: one of four, none included, is 2 bits of 0.15 s each [H52].
    choice_time: float = 0.3
    # Shortest time between two changes of the finger that is looked at, s; fixations take 0.2 to 0.3 s [R98].
    attention_time: float = 0.25
    # Correction rate of *mimicry* people, 1/s: a fifth of the others'. An assumption.
    mimicry_rate: float = 0.5
    # Standard deviation of each entry of the Jacobian around the identity that *adaptive* people expect
    # before free play, and of its drift in a second. Rotations of 30° and gains of 1.5 are learned [K00].
    jacobian_spread: float = 0.5
    jacobian_drift: float = 0.02
    # Time between two comparisons of own and robot motion, s, and the least own motion compared, m.
    # Assumptions; the time is that of a fixation.
    comparison_time: float = 0.25
    least_motion: float = 0.005
    # *adaptive* people learn from free play within this distance of the own fingertip, m. An assumption.
    neighbourhood: float = 0.04
    # A finger whose key is not seen to go down is pushed further, at `push_speed`, m/s, by at most
    # `most_push`, m. Assumptions.
    push_speed: float = 0.02
    most_push: float = 0.02
    # A finger without a cue that is seen to press, or feels its key, is raised by this, m, in every
    # `attention_time`, up to three times as far. An assumption.
    lift: float = 0.004
    # An object is carried to within `place_tolerance`, m, of the point above its place, and lowered to
    # `place_overshoot`, m, below the seen place, to be set down. Both are about the error of vision [B02].
    place_tolerance: float = 0.003
    place_overshoot: float = 0.005

    @property
    def visual_error(self) -> float:
        """Root mean square of the distance by which a point is seen displaced, m."""
        return math.sqrt(2 * self.visual_noise**2 + self.visual_depth_noise**2)

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "operator", may_be_zero=True)
        for name in _DIVISORS:
            if getattr(self, name) == 0:
                raise ValueError(f"operator.{name} must be positive, not 0")
        steps = self.visual_delay / self.period
        if abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"operator.visual_delay ({self.visual_delay}) must be a multiple of operator.period "
                f"({self.period})"
            )

"""When a hand that was held is followed again, and with how much of its speed."""

import dataclasses as dc
import math

# Sums of periods round, s.
_TIME_TOLERANCE = 1e-9


@dc.dataclass(slots=True)
class Easing:
    """Tells from update to update whether the hand follows, is held, or follows again with growing speed.

    Input is followed once it has been good for the settling time. After a hold, the share of the joints'
    speed limit that may be used grows from zero to one over as long as the hand was held.

    Attributes, in s:
        good_since: NaN while the input is bad.
        held_since: NaN while the hand follows.
        eased_from: when the last easing began.
        duration: how long it takes; 0 where none is going on.
    """

    good_since: float
    held_since: float
    eased_from: float = 0.0
    duration: float = 0.0

    @classmethod
    def at_start(cls, ease: bool) -> "Easing":
        """The start counts as the end of a long hold, or the first good input is followed at once."""
        return cls(math.nan, -math.inf) if ease else cls(-math.inf, math.nan)

    def follows(self) -> bool:
        """Whether the hand followed at the last update, or counts as if it had."""
        return math.isnan(self.held_since)

    def settled(self, time: float, settle_time: float) -> bool:
        """Whether input that is good at `time` has been good for `settle_time`; both in s."""
        if math.isnan(self.good_since):
            self.good_since = time
        return time - self.good_since >= settle_time - _TIME_TOLERANCE

    def hold(self, time: float, good: bool) -> None:
        """Holds the hand at `time`, s; input that is `good` only has to settle."""
        if not good:
            self.good_since = math.nan
        if math.isnan(self.held_since):
            self.held_since = time

    def follow(self, time: float, period: float, longest: float) -> float:
        """Ends a hold, if there was one, by an easing of at most `longest`; all times in s.

        Returns:
            The share of the speed limit that may be used from `time` until a period later.
        """
        if not math.isnan(self.held_since):
            self.duration, self.eased_from = min(longest, time - self.held_since), time
            self.held_since = math.nan
        if self.duration > 0.0:
            return min((time - self.eased_from + period) / self.duration, 1.0)
        return 1.0

    def end(self) -> None:
        """The joints have caught up, or may use their full speed."""
        self.duration = 0.0

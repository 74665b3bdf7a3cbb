"""What a check found in a recording: how bad it is, what and where it is, and what to do about it."""

import dataclasses
import enum


class Severity(enum.StrEnum):
    """How bad a finding is."""

    ERROR = "error"  # the recording is refused
    UNFIT = "unfit"  # it can be replayed, but not be trained on
    WARNING = "warning"  # usable; look at it
    ADVICE = "advice"  # nothing is wrong, a better recording would hold more


@dataclasses.dataclass(frozen=True)
class Finding:
    """One fault of a recording, or one thing that was repaired.

    Attributes:
        check: short name of what was looked at, such as "unit".
        severity: how bad it is.
        what: what was wanted and what was given.
        where: the field and frame, where the fault has a place.
        advice: what the user can do.
        lost: frames that mean nothing because of it and are to be marked invalid.
    """

    check: str
    severity: Severity
    what: str
    where: str = ""
    advice: str = ""
    lost: tuple[int, ...] = ()

    def __str__(self) -> str:
        place = f" ({self.where})" if self.where else ""
        return f"{self.what}{place}" + (f"; {self.advice}" if self.advice else "")

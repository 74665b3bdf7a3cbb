"""What a recorder has sampled of one spec."""

import math
from dataclasses import dataclass, field

from geort_drake.rerun.specs import Spec


@dataclass
class Track:
    """Rows of one spec.

    Attributes:
        key: entity path.
        inputs: names of the recorder's input ports that hold the spec's values; tracks may share one.
        rows: one per sample; None where no value was due.
    """

    key: str
    spec: Spec
    inputs: list[str]
    rows: list = field(default_factory=list)
    _read_at: float = -math.inf

    def due(self, time: float) -> bool:
        """Whether to read at this time, s; if so, the next reading is a period later."""
        if self._read_at <= time < self._read_at + self.spec.period - 1e-9:
            return False
        self._read_at = time
        return True

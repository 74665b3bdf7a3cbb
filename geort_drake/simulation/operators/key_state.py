"""What a person who presses keys does and remembers."""

import dataclasses as dc
import enum

import numpy as np

from geort_drake.simulation.operators.finger_state import FingerState


class KeyPhase(enum.IntEnum):
    """What the person is doing."""

    SETTLE = 0  # moves the fingers above the keys
    WAIT = 1
    CHOOSE = 2  # a cue is seen
    PRESS = 3
    RELEASE = 4


@dc.dataclass
class PresserState(FingerState):
    """Memory of a person who presses keys."""

    handled_cue: int = 0  # the cue that was last acted on; 0 once it has gone
    # (F,) by how much each finger's place is raised, m.
    raised: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))

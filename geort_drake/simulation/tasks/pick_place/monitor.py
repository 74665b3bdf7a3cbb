"""Judges from the simulated physics alone which steps of a block's transfer are done."""

import dataclasses as dc
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from geort_drake.simulation.monitor import Outcome, TaskMonitor
from geort_drake.systems.port_values import pose_to_vector, vector_to_pose

TOUCH_FORCE = 0.02  # N, force above which a finger touches
HOLD_TIME = 0.5  # s for which the last step must stay done
# The block is lost if it is this far below its support, or this far from its place and untouched, m.
_MAX_FALL, _MAX_OFFSET = 0.03, 0.4
_MAX_ANGLE = math.radians(15)


class BlockState(NamedTuple):
    """A block relative to its support and its place; lengths in m, angles in rad."""

    height: float  # height of its lowest point above the support
    offset: float  # horizontal distance from its place
    turn: float  # angle about the vertical from its place, modulo the quarter turns of a square
    tilt: float  # angle of its z axis from the vertical
    touching: int  # number of fingers that touch it


def _is_placed(block: BlockState) -> bool:
    return block.height < 0.003 and block.offset < 0.010 and max(abs(block.turn), block.tilt) < _MAX_ANGLE


# Name of a step → whether it is done; a step counts only after those before it.
STEPS: dict[str, Callable[[BlockState], bool]] = {
    "grasped": lambda block: block.touching >= 2,
    "lifted": lambda block: block.touching >= 2 and block.height > 0.08,
    "carried": lambda block: block.touching >= 2 and block.height > 0.003 and block.offset < 0.03,
    "placed": _is_placed,
    "released": lambda block: _is_placed(block) and block.touching == 0,
}


@dc.dataclass(frozen=True)
class TransferOutcome(Outcome):
    """The steps so far; times in s since the start."""

    # When each step was reached, in order.
    times: tuple[float, ...] = ()
    # Since when the last step has been done; NaN while it is not.
    done_since: float = math.nan
    block: BlockState | None = None
    lost: bool = False

    @property
    def success(self) -> bool:
        """Whether all steps were reached."""
        return len(self.times) == len(STEPS)

    @property
    def over(self) -> bool:
        """Whether the transfer is decided."""
        return self.success or self.lost

    @property
    def score(self) -> float:
        """Fraction of the steps that were reached, one after another."""
        return len(self.times) / len(STEPS)

    @property
    def completion_time(self) -> float:
        """Time from the start until the last step was done, s; NaN without success."""
        return self.times[-1] if self.success else math.nan


class TransferMonitor(TaskMonitor[TransferOutcome]):
    """Judges the transfer of a block, without delay or noise, and terminates a decided simulation.

    Input ports, besides those of `TaskMonitor`:
        object_pose (7): X_WO, qw qx qy qz x y z.
    Output ports:
        place_pose (7): X_WP, where the block belongs, qw qx qy qz x y z.
        step (1): number of steps reached.
        outcome (abstract TransferOutcome).

    Args:
        X_WP: pose at which the block belongs.
        lowest_point: maps X_WO to the height in W of the block's lowest point, m.
        support_height: height of the support in W, m.
    """

    def __init__(
        self,
        num_fingers: int,
        X_WP: RigidTransform,
        lowest_point: Callable[[RigidTransform], float],
        support_height: float,
    ):
        super().__init__(num_fingers, TransferOutcome())
        self._X_WP, self._lowest_point, self._support = X_WP, lowest_point, support_height
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        place = pose_to_vector(X_WP)
        self._declare_output("place_pose", 7, lambda outcome: place)
        self._declare_output("step", 1, lambda outcome: len(outcome.times))

    def _seen(self, context: Context) -> BlockState:
        X_WO = vector_to_pose(self._object_pose.Eval(context))
        offset = X_WO.translation() - self._X_WP.translation()
        R = self._X_WP.rotation().matrix().T @ X_WO.rotation().matrix()
        turn = math.remainder(math.atan2(R[1, 0], R[0, 0]), math.pi / 2)
        return BlockState(
            height=self._lowest_point(X_WO) - self._support,
            offset=math.hypot(*offset[:2]),
            turn=turn,
            tilt=math.acos(min(max(X_WO.rotation().matrix()[2, 2], -1.0), 1.0)),
            touching=int(np.sum(self._contact.Eval(context) > TOUCH_FORCE)),
        )

    def _judged(self, context: Context, before: TransferOutcome) -> TransferOutcome:
        t, block = before.t, self._seen(context)
        times, done_since = before.times, math.nan
        if list(STEPS.values())[len(times)](block):
            if len(times) < len(STEPS) - 1:
                times = (*times, t)
            else:
                done_since = t if math.isnan(before.done_since) else before.done_since
                if t - done_since > HOLD_TIME - 1e-9:
                    times = (*times, done_since)
        return before.having(
            times=times,
            done_since=done_since,
            block=block,
            lost=block.height < -_MAX_FALL or (block.offset > _MAX_OFFSET and block.touching == 0),
        )

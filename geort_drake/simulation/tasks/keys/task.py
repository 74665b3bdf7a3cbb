"""The keys: press the cued one of three without moving the others, with a parked hand."""

import dataclasses as dc
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    PrismaticSpring,
    SpatialInertia,
)
from pydrake.systems.framework import Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask, Handled
from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings
from geort_drake.simulation.operators.key_presser import KeyPresser
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.keys.planner import CAP_LENGTH, CAP_WIDTH, TRAVEL, KeysGoal, KeysPlanner

_CAP_HEIGHT, _CAP_MASS = 0.006, 0.005  # m, kg
_STIFFNESS, _DAMPING = 150.0, 1.7  # N/m and N s/m of a key; the damping is critical
_FRICTION = CoulombFriction(0.6, 0.6)
_COLOR, _BED_COLOR = np.array([0.93, 0.93, 0.90, 1.0]), np.array([0.25, 0.26, 0.28, 1.0])


@dc.dataclass(frozen=True)
class KeysSettings(TaskSettings):
    """Number and timing of the presses, and criteria for one to count."""

    # Number of cues; time before the first, longest time of a cue, and time between two, s. A cue ends when
    # its key was pressed and is up again.
    presses: float = 12
    ready_time: float = 6.0
    cue_time: float = 2.0
    rest_time: float = 0.5
    # During the cue, the cued key must go down by more than `depth` and no other by more than `still`, m.
    depth: float = 0.003
    still: float = 0.0005
    # Number of counted presses needed for success.
    enough: float = 10


@dc.dataclass(frozen=True)
class Press:
    """One cued press; lengths in m, times in s."""

    key: int
    depth: float = 0.0  # largest travel of the cued key
    others: float = 0.0  # largest travel of another key
    time: float = math.nan  # time from the cue until the key was down

    def seen(self, travel: np.ndarray, since: float, down: float) -> "Press":
        """Updates with the keys' travel (K,), `since` s after the cue; beyond `down` a key is down."""
        depth, others = float(travel[self.key]), float(np.delete(travel, self.key).max(initial=0.0))
        time = since if math.isnan(self.time) and depth > down else self.time
        return Press(self.key, max(self.depth, depth), max(self.others, others), time)


@dc.dataclass(frozen=True)
class KeysOutcome(Outcome):
    """The presses so far."""

    settings: KeysSettings
    # When the next cue follows, s after the task began; and since when the present cue is shown, s; NaN
    # between cues.
    next_cue: float
    cued_since: float = math.nan
    presses: tuple[Press, ...] = ()
    over: bool = False

    def clean(self, press: Press) -> bool:
        """Whether a press counts."""
        return press.depth > self.settings.depth and press.others < self.settings.still

    @property
    def score(self) -> float:
        """Fraction of the presses that count."""
        return sum(map(self.clean, self.presses)) / round(self.settings.presses)

    @property
    def success(self) -> bool:
        """Whether enough presses count."""
        return self.over and sum(map(self.clean, self.presses)) >= self.settings.enough


class KeysMonitor(TaskMonitor[KeysOutcome]):
    """Cues keys one after another, watches all of them, and terminates the simulation after the last cue.

    Input ports (K keys), besides those of `TaskMonitor`:
        joints (2K): travel of each key, m, then its speed.
    Output ports:
        cue (1): number of the key to press, from 1; 0 for none.
        travel (K): travel of each key, m.
        outcome (abstract KeysOutcome).

    Args:
        cued: key of each cue.
    """

    def __init__(self, num_keys: int, num_fingers: int, cued: Sequence[int], settings: KeysSettings):
        super().__init__(num_fingers, KeysOutcome(settings, settings.ready_time))
        self._cued, self._num_keys = list(cued), num_keys
        self._keys = self.DeclareVectorInputPort("joints", 2 * num_keys)
        self._declare_output(
            "cue", 1, lambda now: 0 if math.isnan(now.cued_since) else now.presses[-1].key + 1
        )
        self._declare_positions("travel", self._keys)

    def _judged(self, context: Context, before: KeysOutcome) -> KeysOutcome:
        settings, t = before.settings, before.t
        presses, cued_since, next_cue = before.presses, before.cued_since, before.next_cue
        if not math.isnan(cued_since):
            travel = self._keys.Eval(context)[: self._num_keys]
            press = presses[-1].seen(travel, t - cued_since, settings.depth)
            presses = (*presses[:-1], press)
            is_up = travel[press.key] < settings.still
            if t - cued_since > settings.cue_time - 1e-9 or (press.depth > settings.depth and is_up):
                cued_since, next_cue = math.nan, t - before.began + settings.rest_time
        elif t - before.began > next_cue - 1e-9:
            presses, cued_since = (*presses, Press(self._cued[len(presses)])), t
        return before.having(
            cued_since=cued_since,
            next_cue=next_cue,
            presses=presses,
            over=len(presses) == len(self._cued) and math.isnan(cued_since),
        )


@dc.dataclass(frozen=True)
class KeysResult(TrialResult):
    """Result of one trial of keys. `outcome` is "success", or the number of each fault."""

    # Presses in which the cued key went down, and in which the others stayed still.
    pressed: int
    still: int
    # Means over the presses: largest travel of another key, m; and time until the cued key was down, s; None
    # if none was.
    others_travel: float
    press_time: float | None


class KeysTask(FingerTask[KeysGoal]):
    """Press the cued one of three keys without moving the others."""

    name = "keys"
    summary = "press the cued one of three keys without moving the others"
    result = KeysResult
    scenario = Path(__file__).with_name("scenario.yaml"), "Keys"
    settings = KeysSettings
    planner = KeysPlanner
    person_type = KeyPresser
    percepts = ("travel", "cue")

    def add_handled(
        self, plant: MultibodyPlant, goal: KeysGoal, X_WB: RigidTransform, rng: np.random.Generator
    ) -> Handled:
        """Adds key caps on springs above a bed; they are pressed along +x of B."""
        model = plant.AddModelInstance("keys")
        bed = plant.AddRigidBody("bed", model, SpatialInertia.SolidBoxWithMass(0.5, 0.006, 0.15, 0.06))
        depth = _CAP_HEIGHT + TRAVEL + 0.004  # from the caps' tops to the middle of the bed
        X_WBed = X_WB @ RigidTransform(goal.p_BK.mean(axis=0) + [depth, 0, 0])
        plant.WeldFrames(plant.world_frame(), bed.body_frame(), X_WBed)
        plant.RegisterVisualGeometry(bed, RigidTransform(), Box(0.006, 0.15, 0.06), "bed", _BED_COLOR)
        caps, joints = [], []
        shape = Box(_CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
        for number, p in enumerate(goal.p_BK):
            inertia = SpatialInertia.SolidBoxWithMass(_CAP_MASS, _CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
            cap = plant.AddRigidBody(f"cap_{number + 1}", model, inertia)
            X_WCap = X_WB @ RigidTransform(p + [_CAP_HEIGHT / 2, 0, 0])
            joint = plant.AddJoint(
                PrismaticJoint(
                    f"key_{number + 1}",
                    plant.AddFrame(FixedOffsetFrame(f"rest_{number + 1}", bed, X_WBed.inverse() @ X_WCap)),
                    cap.body_frame(),
                    [1.0, 0.0, 0.0],
                    0.0,
                    TRAVEL,
                    _DAMPING,
                )
            )
            plant.AddForceElement(PrismaticSpring(joint, 0.0, _STIFFNESS))
            plant.RegisterCollisionGeometry(cap, RigidTransform(), shape, "cap", _FRICTION)
            plant.RegisterVisualGeometry(cap, RigidTransform(), shape, "cap", _COLOR)
            caps.append(cap)
            joints.append(joint)
        return Handled(bed, caps, joints)

    def make_monitor(
        self,
        num_fingers: int,
        goal: KeysGoal,
        X_WB: RigidTransform,
        settings: KeysSettings,
        rng: np.random.Generator,
    ) -> KeysMonitor:
        # Cues every key equally often.
        cued = rng.permutation(np.arange(round(settings.presses)) % len(goal.p_BK))
        return KeysMonitor(len(goal.p_BK), num_fingers, cued.tolist(), settings)

    def recorded(self, monitor: TaskMonitor, settings: KeysSettings) -> tuple[States, Signals]:
        cue, travel = monitor.GetOutputPort("cue"), monitor.GetOutputPort("travel")
        names = [f"key {number + 1}" for number in range(travel.size())]
        return {"cue": (cue, ["none", *names])}, {"keys/travel": (travel, names, "m")}

    def result_fields(self, outcome: KeysOutcome, description: HandDescription) -> dict[str, Any]:
        settings, presses = outcome.settings, outcome.presses
        pressed = sum(press.depth > settings.depth for press in presses)
        still = sum(press.others < settings.still for press in presses)
        times = [press.time for press in presses if press.depth > settings.depth]
        if outcome.success:
            text = "success"
        else:
            text = f"{len(presses) - pressed} not pressed, {len(presses) - still} with others"
        return {
            "outcome": text,
            "pressed": pressed,
            "still": still,
            "others_travel": float(np.mean([press.others for press in presses])) if presses else 0.0,
            "press_time": float(np.mean(times)) if times else None,
        }


TASK = KeysTask()

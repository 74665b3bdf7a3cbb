"""A person who moves a puck between the robot's fingertips to targets."""

import dataclasses as dc
import enum
import math

import numpy as np

from geort_drake.simulation.operators.finger_person import SeenFingers
from geort_drake.simulation.operators.holding import HolderState, HoldingPerson
from geort_drake.simulation.operators.intention import ADAPTIVE, SERVO
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.port_values import rotation_of_vector, vector_to_pose

# s; after this time, fingers close although they are not where they are meant to be. An assumption.
_SHAPING = 4.0


class PuckPhase(enum.IntEnum):
    """What the person is doing."""

    SETTLE = 0  # moves the fingers around the puck, and corrects
    CLOSE = 1  # until the puck is felt
    SQUEEZE = 2
    WAIT = 3
    CHOOSE = 4  # a target is seen
    MOVE = 5  # to it, and corrects


@dc.dataclass
class MoverState(HolderState):
    """Memory of a person who moves a puck. A place and an axis are (2, 3): m, and a direction, in B."""

    cue: int = 0  # the target that was last acted on
    # (F, 3) from the puck to each fingertip when all were felt, m; forces (F,) felt after the squeeze, N; and
    # motions (F,) of the fingertips towards the puck in the last decision, m.
    arms: np.ndarray = dc.field(default_factory=lambda: np.zeros((0, 3)))
    force: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    press: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    # Of the present movement: its start, and where the puck is meant to be now.
    start: np.ndarray = dc.field(default_factory=lambda: np.zeros((2, 3)))
    meant: np.ndarray = dc.field(default_factory=lambda: np.zeros((2, 3)))


class PuckMover(HoldingPerson[MoverState]):
    """Holds the puck and moves it as a whole: the fingertips move by v + ω × r, and keep their felt forces.

    Perceives `object_pose`, `target_pose` (7) and the `cue`, see `TrackingMonitor`, besides the `contact`.
    The own fingertips of SERVO and MIMICRY hold a virtual puck, as large as when the robot's touched, so r is
    from the own fingertips' middle; ADAPTIVE takes it from the seen robot's. The person looks at the puck,
    not at a finger, and so corrects all fingers that hold it.
    """

    phases, state, begins_open = PuckPhase, MoverState, True

    def _advance_phase(self, state: MoverState, t: float, scene: SeenFingers) -> None:
        super()._advance_phase(state, t, scene)
        cue = round(scene.percepts["cue"][0])
        if state.phase == PuckPhase.SQUEEZE and not len(state.arms):
            p_HF, goal = state.p_HF_past[-1][self._own], self._goal
            own, robot = p_HF - p_HF[self._used].mean(axis=0), goal.p_BF_touch - goal.X_BG.translation()
            state.arms = robot if self._kind == ADAPTIVE else own
        if state.phase == PuckPhase.WAIT:
            state.force = self._felt(scene)
        if state.phase >= PuckPhase.WAIT and cue and cue != state.cue:
            state.cue = cue
            self._enter(state, PuckPhase.CHOOSE, t)
        elif state.phase == PuckPhase.CHOOSE and t - state.phase_start > self._intention.choice_time:
            state.start = state.meant = self._seen(state, scene)
            self._enter(state, PuckPhase.MOVE, t)

    def _is_shaped(self, state: MoverState, t: float, scene: SeenFingers) -> bool:
        p_BF = scene.p_BF + state.sight.p[:-1] @ scene.X_WB.rotation().matrix()
        worst = np.linalg.norm(self._error(state, p_BF, scene)[self._used], axis=1).max()
        return worst < self._config.shape_tolerance or t - state.phase_start > state.settle_time + _SHAPING

    def _watched(self, state: MoverState) -> np.ndarray:
        closing = [finger for finger in self._used.tolist() if finger not in state.touching]
        return np.array(closing) if closing else self._used

    def _corrected(self, state: MoverState) -> list[int]:
        if state.phase == PuckPhase.MOVE:
            return self._used.tolist()
        return [finger for finger in super()._corrected(state) if finger not in state.touching]

    def _reference(self, state: MoverState, t: float, scene: SeenFingers) -> np.ndarray:
        if state.phase < PuckPhase.MOVE:
            state.press = np.zeros(len(self._own))
            return state.reference if state.phase > PuckPhase.SQUEEZE else self._grip(state, t)
        config = self._config
        missing = 1 - self._felt(scene) / np.maximum(state.force, config.touch_force)
        state.press = config.closing_speed * config.period * np.clip(missing, -1, 1)
        before, target = state.meant, _place_and_axis(scene, "target_pose")
        share = minimum_jerk((t - state.phase_start) / config.min_movement_time)
        turned = rotation_of_vector(share * _turn(state.start[1], target[1])).matrix() @ state.start[1]
        state.meant = np.array([state.start[0] + share * (target[0] - state.start[0]), turned])
        return state.reference + _rigid_motion(before, state.meant, self._arms(state, before[1]))

    def _error(self, state: MoverState, p_BF: np.ndarray, scene: SeenFingers) -> np.ndarray:
        if state.phase != PuckPhase.MOVE:
            return super()._error(state, p_BF, scene)
        seen = self._seen(state, scene)
        arms = self._arms(state, seen[1])
        done = (state.p_HF_past[-1] - state.p_HF_past[0])[self._own]
        moved = (state.learned.J @ done[..., None])[..., 0]
        return _rigid_motion(seen, state.meant, arms) - self._shared_motion(arms, moved)

    def _shared_motion(self, arms: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """The rigid part of motions of the holding fingertips, (F, 3) m: pressing does not move the puck."""
        held, middle = arms[self._used], moved[self._used].mean(axis=0)
        arm = held - held.mean(axis=0)
        inertia = (arm**2).sum() * np.eye(3) - arm.T @ arm
        turn = np.linalg.pinv(inertia) @ np.cross(arm, moved[self._used]).sum(axis=0)
        return middle + np.cross(turn, arms - held.mean(axis=0))

    def _own_movement(self, state: MoverState, t: float, change: np.ndarray) -> np.ndarray:
        """Closing and motions of the puck as learned; each kind squeezes, and keeps the felt force."""
        step = np.zeros((5, 3))
        moves = self._kind != SERVO or state.phase == PuckPhase.SQUEEZE
        for finger in self._used.tolist():
            wanted = moves * change[finger] - state.press[finger] * self._goal.n_B[finger]
            step[self._own[finger]] = self._intended(state, finger, wanted)
        return step

    def _seen(self, state: MoverState, scene: SeenFingers) -> np.ndarray:
        """Place and axis of the puck, with the errors of vision relative to the target."""
        place, axis = _place_and_axis(scene, "object_pose")
        R_BW = scene.X_WB.rotation().matrix().T
        turn = rotation_of_vector(R_BW @ state.sight.turn[0]).matrix()
        return np.array([place + R_BW @ state.sight.p[-1], turn @ axis])

    def _arms(self, state: MoverState, axis: np.ndarray) -> np.ndarray:
        """From the puck's middle to the fingertips on its surface with its axis so, (F, 3) m."""
        turned = _turn(self._goal.X_BG.rotation().matrix()[:, 2], axis)
        return state.arms @ rotation_of_vector(turned).matrix().T


def _rigid_motion(start: np.ndarray, end: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """v + ω × r between two places and axes, (F, 3) m."""
    return end[0] - start[0] + np.cross(_turn(start[1], end[1]), arms)


def _place_and_axis(scene: SeenFingers, name: str) -> np.ndarray:
    X_BO = scene.X_WB.inverse() @ vector_to_pose(scene.percepts[name])
    return np.array([X_BO.translation(), X_BO.rotation().matrix()[:, 2]])


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotation vector (3,), rad, between two directions."""
    normal = np.cross(start, end)
    sine = float(np.linalg.norm(normal))
    return normal * (math.atan2(sine, float(start @ end)) / max(sine, 1e-9))

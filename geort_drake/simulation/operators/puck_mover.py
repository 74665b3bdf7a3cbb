"""A person who holds a puck with the robot's fingertips and moves it to targets."""

import dataclasses as dc
import enum
import math

import numpy as np

from geort_drake.simulation.operators.finger_person import SeenFingers
from geort_drake.simulation.operators.holding import HolderState, HoldingPerson
from geort_drake.simulation.operators.intention import ADAPTIVE, SERVO
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.port_values import rotation_of_vector, vector_to_pose

# s; after this time, the fingers close even if they are not at their open positions. An assumption.
_SHAPING_S = 4.0


class PuckPhase(enum.IntEnum):
    """Phases of a person who moves a puck."""

    SETTLE = 0  # moves the fingers around the puck, with corrections
    CLOSE = 1  # until the puck is felt
    SQUEEZE = 2
    WAIT = 3
    CHOOSE = 4  # a target is seen
    MOVE = 5  # moves the puck to the target, with corrections


@dc.dataclass
class MoverState(HolderState):
    """Memory of a person who moves a puck. `start` and `intended` are (2, 3): position, m, and axis, in B."""

    cue: int = 0  # last target that was acted on
    # (F, 3) vectors from the puck to the fingertips when all touched, m; (F,) forces felt after the squeeze,
    # N; and (F,) motions of the fingertips towards the puck in the last decision, m.
    arms: np.ndarray = dc.field(default_factory=lambda: np.zeros((0, 3)))
    force: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    press: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    # The puck's pose at the start of the present movement, and its intended pose now.
    start: np.ndarray = dc.field(default_factory=lambda: np.zeros((2, 3)))
    intended: np.ndarray = dc.field(default_factory=lambda: np.zeros((2, 3)))


class PuckMover(HoldingPerson[MoverState]):
    """Holds the puck and moves it as a whole: the fingertips move by v + ω × r and keep their felt forces.

    The person perceives `object_pose`, `target_pose` (7) and `cue`, see `TrackingMonitor`, besides `contact`.
    For SERVO and MIMICRY, r starts at the middle of the own fingertips, which hold a virtual puck; for
    ADAPTIVE, at the puck between the robot's. The person looks at the puck, not at a finger, and so corrects
    all fingers that hold it.
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
            state.start = state.intended = self._seen(state, scene)
            self._enter(state, PuckPhase.MOVE, t)

    def _is_shaped(self, state: MoverState, t: float, scene: SeenFingers) -> bool:
        p_BF = scene.p_BF + state.sight.p[:-1] @ scene.X_WB.rotation().matrix()
        worst = np.linalg.norm(self._error(state, p_BF, scene)[self._used], axis=1).max()
        return worst < self._config.shape_tolerance or t - state.phase_start > state.settle_time + _SHAPING_S

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
        before, target = state.intended, _position_and_axis(scene, "target_pose")
        share = minimum_jerk((t - state.phase_start) / config.min_movement_time)
        turned = rotation_of_vector(share * _turn(state.start[1], target[1])).matrix() @ state.start[1]
        state.intended = np.array([state.start[0] + share * (target[0] - state.start[0]), turned])
        return state.reference + _rigid_motion(before, state.intended, self._arms(state, before[1]))

    def _error(self, state: MoverState, p_BF: np.ndarray, scene: SeenFingers) -> np.ndarray:
        if state.phase != PuckPhase.MOVE:
            return super()._error(state, p_BF, scene)
        seen = self._seen(state, scene)
        arms = self._arms(state, seen[1])
        done = (state.p_HF_past[-1] - state.p_HF_past[0])[self._own]
        moved = (state.learned.J @ done[..., None])[..., 0]
        return _rigid_motion(seen, state.intended, arms) - self._shared_motion(arms, moved)

    def _shared_motion(self, arms: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Returns the rigid part (F, 3), m, of motions of the holding fingertips, without their pressing."""
        held, middle = arms[self._used], moved[self._used].mean(axis=0)
        arm = held - held.mean(axis=0)
        inertia = (arm**2).sum() * np.eye(3) - arm.T @ arm
        turn = np.linalg.pinv(inertia) @ np.cross(arm, moved[self._used]).sum(axis=0)
        return middle + np.cross(turn, arms - held.mean(axis=0))

    def _own_movement(self, state: MoverState, t: float, change: np.ndarray) -> np.ndarray:
        """Returns the learned motion to close and move the puck; SERVO only squeezes and keeps the force."""
        step = np.zeros((5, 3))
        moves = self._kind != SERVO or state.phase == PuckPhase.SQUEEZE
        for finger in self._used.tolist():
            wanted = moves * change[finger] - state.press[finger] * self._goal.n_B[finger]
            step[self._own[finger]] = self._intended(state, finger, wanted)
        return step

    def _seen(self, state: MoverState, scene: SeenFingers) -> np.ndarray:
        """Returns the seen position and axis (2, 3) of the puck; the target is seen without error."""
        position, axis = _position_and_axis(scene, "object_pose")
        R_BW = scene.X_WB.rotation().matrix().T
        turn = rotation_of_vector(R_BW @ state.sight.turn[0]).matrix()
        return np.array([position + R_BW @ state.sight.p[-1], turn @ axis])

    def _arms(self, state: MoverState, axis: np.ndarray) -> np.ndarray:
        """Returns vectors (F, 3), m, from the puck's middle to the fingertips, for an axis of the puck."""
        turned = _turn(self._goal.X_BG.rotation().matrix()[:, 2], axis)
        return state.arms @ rotation_of_vector(turned).matrix().T


def _rigid_motion(start: np.ndarray, end: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """Returns the displacement v + ω × r (F, 3), m, between two positions and axes (2, 3)."""
    return end[0] - start[0] + np.cross(_turn(start[1], end[1]), arms)


def _position_and_axis(scene: SeenFingers, name: str) -> np.ndarray:
    X_BO = scene.X_WB.inverse() @ vector_to_pose(scene.percepts[name])
    return np.array([X_BO.translation(), X_BO.rotation().matrix()[:, 2]])


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Returns the shortest rotation vector (3,), rad, between two unit vectors."""
    normal = np.cross(start, end)
    sine = float(np.linalg.norm(normal))
    return normal * (math.atan2(sine, float(start @ end)) / max(sine, 1e-9))

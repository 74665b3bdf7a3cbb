"""Base class of a person who moves the robot's fingers by moving their own.

The person sees the robot's fingertips and what the task shows, with delay and noise, and moves their own
fingers but not the wrist. They do not know the retargeting map. Tasks give the reference motion.
"""

import abc
import dataclasses as dc
import enum
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import FingerMotion, limited
from geort_drake.simulation.operators.intention import (
    ADAPTIVE,
    MIMICRY,
    SERVO,
    IntentionConfig,
    LearnedMotion,
    learned_in_play,
    motion_noise,
)
from geort_drake.simulation.operators.perception import VisualError
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.port_values import Immutable, vector_to_pose


@dc.dataclass
class FingerState(Immutable):
    """The person's memory between decisions; `FingerPerson.step` changes only a copy of it."""

    theta: np.ndarray  # (20,) joint angles of the own hand, rad
    X_WH: RigidTransform
    # (5, 3) own fingertips in H at the last decisions, m; the oldest are as old as the seen scene.
    p_HF_past: tuple[np.ndarray, ...]
    sight: VisualError
    learned: LearnedMotion
    # (5, 3) own fingertips of the relaxed hand, and of the open hand that begins the task, m; and duration of
    # the movement between the two, s.
    p_HF_rest: np.ndarray
    p_HF_open: np.ndarray
    settle_time: float
    phase: enum.IntEnum
    phase_start: float = 0.0
    looking: bool = False  # whether the person has seen the scene yet
    attempt: int = 1
    finger: int = -1  # robot finger that acts
    # (5, 3) own fingertips when the last press and release began, m.
    p_HF_press: np.ndarray | None = None
    p_HF_release: np.ndarray | None = None
    finger_velocity: np.ndarray = dc.field(default_factory=lambda: np.zeros((5, 3)))
    # (F, 3) intended position of each robot fingertip in B, m.
    reference: np.ndarray = dc.field(default_factory=lambda: np.zeros((0, 3)))
    # Finger that is looked at, since when, and when each finger was last looked at (F,), s.
    attended: int = -1
    attended_since: float = 0.0
    looked: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    # Own and robot fingertip (3,), m, at the last comparison of their motions, and its time, s.
    compared: tuple[np.ndarray, np.ndarray] | None = None
    compared_at: float = 0.0
    # (3, 3) matrix applied to the present movement: motor error in direction and size.
    motor: np.ndarray = dc.field(default_factory=lambda: np.eye(3))


State = TypeVar("State", bound=FingerState)


@dc.dataclass(frozen=True)
class SeenFingers:
    """The scene as the person sees it."""

    p_BF: np.ndarray  # (F, 3) robot fingertips in the frame of the hand's base, m
    X_WB: RigidTransform
    percepts: Mapping[str, np.ndarray]  # name → value of an input port of the person


class FingerPerson(abc.ABC, Generic[State]):
    """Decides from the seen scene how a person's fingers move next.

    Attributes:
        phases: phases of the person's behaviour; the first is the movement to the task's open posture.
        state: type of the person's memory.
        begins_open: whether the fingers are straight at first, because bent ones would collide.

    Args:
        hand: the person's hand.
        goal: a `Goal` with `p_BF_open`, such as `KeysGoal`.
        kind: SERVO, MIMICRY or ADAPTIVE.
        config, intention: the person's parameters.
        rng: draws the noise of perception and motion.
    """

    phases: ClassVar[type[enum.IntEnum]]
    state: type[State]
    begins_open: ClassVar[bool] = False

    def __init__(
        self,
        hand: HumanHand,
        goal: Any,
        kind: str,
        config: OperatorConfig,
        intention: IntentionConfig,
        rng: np.random.Generator,
    ):
        intention.validate()
        self._hand, self._goal, self._kind = hand, goal, kind
        self._config, self._intention, self._rng = config, intention, rng
        self._motion = FingerMotion(hand)
        self._own = np.array([FINGER_NAMES.index(name) for name in goal.finger_names])
        self._used = np.flatnonzero(goal.touches)
        used = self._own[self._used]
        # The person's unused fingers, except the thumb, follow their neighbour.
        self._followers = [i for i in range(1, 5) if i not in used]
        self._rate = config.correction_rate if kind != MIMICRY else intention.mimicry_rate

    @abc.abstractmethod
    def _advance_phase(self, state: State, t: float, scene: SeenFingers) -> None:
        """Updates `phase`, `phase_start` and `finger` of `state`."""

    @abc.abstractmethod
    def _reference(self, state: State, t: float, scene: SeenFingers) -> np.ndarray:
        """Returns the intended positions of the robot's fingertips at t, s, (F, 3) m in B."""

    @abc.abstractmethod
    def _watched(self, state: State) -> np.ndarray:
        """Returns the robot fingers that the person looks at in turn."""

    @abc.abstractmethod
    def _is_free(self, state: State, scene: SeenFingers, finger: int) -> bool:
        """Whether a finger touches nothing, so that the person can learn from its motion."""

    @abc.abstractmethod
    def _own_movement(self, state: State, t: float, change: np.ndarray) -> np.ndarray:
        """Returns the step (5, 3), m, that is not a correction; for `change` (F, 3), m, see `_move`."""

    def _corrected(self, state: State) -> list[int]:
        """Returns the fingers whose seen errors are corrected."""
        return self._used.tolist() if self._kind == SERVO else [state.attended]

    def _error(self, state: State, p_BF: np.ndarray, scene: SeenFingers) -> np.ndarray:
        """Returns the seen errors of the robot's fingertips, (F, 3) m in B."""
        # Forward model: the learned motion of the robot's fingers since the seen scene.
        done = (state.p_HF_past[-1] - state.p_HF_past[0])[self._own]
        return state.reference - p_BF - (state.learned.J @ done[..., None])[..., 0]

    def start(self, X_WH: RigidTransform) -> State:
        """Returns the state before the first decision: a hand at X_WH that does not move."""
        theta = np.clip(self._first_posture(), self._hand.lower, self._hand.upper)
        p_HF = self._hand.fingertips(theta)
        steps = round(self._config.visual_delay / self._config.period)
        p_HF_open, goal, play = p_HF.copy(), self._goal, self._goal.play
        num_fingers = len(self._own)
        learned = LearnedMotion.unlearned(num_fingers, self._intention)
        if play is not None and len(play.p_HF):
            noise = np.sqrt(0.5) * motion_noise(self._config, np.inf)
            seen = play.p_BF + self._rng.normal(0, noise, play.p_BF.shape)
            nearest = np.linalg.norm(seen - goal.p_BF_open, axis=-1).argmin(axis=0)
            for finger in self._used:
                p_HF_open[self._own[finger]] = play.p_HF[nearest[finger], finger]
            for own in self._followers:
                p_HF_open[own] += p_HF_open[own - 1] - p_HF[own - 1]
            if self._kind == ADAPTIVE:
                learned = learned_in_play(
                    play, p_HF_open[self._own], self._intention, self._config, self._rng
                )
        # A minimum-jerk movement peaks at 15/8 of its mean speed.
        farthest = np.linalg.norm(p_HF_open - p_HF, axis=1).max()
        return self.state(
            theta=theta,
            X_WH=X_WH,
            p_HF_past=(p_HF,) * max(steps, 1),
            sight=VisualError.draw(num_fingers, self._config, self._rng),
            learned=learned,
            p_HF_rest=p_HF,
            p_HF_open=p_HF_open,
            settle_time=max(
                self._config.min_movement_time, 1.875 * farthest / self._config.max_fingertip_speed
            ),
            phase=self.phases(0),
            reference=goal.p_BF_open.copy(),
            attended=int(self._used[0]),
            looked=np.zeros(num_fingers),
        )

    def _first_posture(self) -> np.ndarray:
        """Returns joint angles (20,), rad, of a relaxed or open hand with its thumb straight and abducted."""
        theta = self._motion.rest.reshape(5, 4)
        theta[0] = self._hand.upper[0], self._hand.lower[1], 0.0, 0.0
        if self.begins_open:
            theta[1:, 1:] = 0.0
        return theta.ravel()

    def seen(self, values: Mapping[str, np.ndarray]) -> SeenFingers:
        """Returns the scene from the values of ports: fingertips, hand pose, and percepts of the task."""
        X_WB, p_WF = vector_to_pose(values["hand_pose"]), values["fingertips"].reshape(-1, 3)
        return SeenFingers(X_WB.inverse().multiply(p_WF.T).T, X_WB, values)

    def step(self, state: State, t: float, scene: SeenFingers) -> State:
        """Returns the state after one decision at time t, s; does not change `state`."""
        past = (*state.p_HF_past[1:], self._hand.fingertips(state.theta))
        state = dc.replace(state, p_HF_past=past, sight=state.sight.later(self._config, self._rng))
        p_BF = scene.p_BF + state.sight.p[:-1] @ scene.X_WB.rotation().matrix()
        if not state.looking:
            state.looking, state.phase_start = True, t
        self._advance_phase(state, t, scene)
        self._attend(state, t)
        if self._kind == ADAPTIVE:
            self._compare(state, t, scene, p_BF)
        before, state.reference = state.reference, self._reference(state, t, scene)
        self._move(state, t, p_BF, scene, state.reference - before)
        return state

    def _enter(self, state: State, phase: enum.IntEnum, t: float) -> None:
        state.phase, state.phase_start = phase, t
        noise = self._config.motor_noise / np.sqrt(3)
        state.motor = np.eye(3) + self._rng.normal(0, noise, (3, 3))

    def _attend(self, state: State, t: float) -> None:
        """Looks at the watched finger that has not been looked at for the longest time."""
        state.looked = state.looked.copy()
        state.looked[state.attended] = t
        if t - state.attended_since < self._intention.attention_time:
            return
        watched = self._watched(state)
        next_finger = int(watched[np.argmin(state.looked[watched])])
        if next_finger != state.attended:
            state.attended, state.attended_since, state.compared = next_finger, t, None

    def _compare(self, state: State, t: float, scene: SeenFingers, p_BF: np.ndarray) -> None:
        """Learns from the motion of the attended finger while it is free."""
        config, finger = self._intention, state.attended
        own, robot = state.p_HF_past[0][self._own[finger]], p_BF[finger]
        if not self._is_free(state, scene, finger):
            state.compared = None
            return
        elapsed = t - state.compared_at
        if state.compared is None:
            state.compared, state.compared_at = (own, robot), t
        elif elapsed >= config.comparison_time:
            moved = own - state.compared[0]
            if np.linalg.norm(moved) > config.least_motion:
                noise = motion_noise(self._config, elapsed)
                seen = robot - state.compared[1]
                state.learned = state.learned.compared(
                    finger, moved, seen, noise, elapsed, config.jacobian_drift
                )
            state.compared, state.compared_at = (own, robot), t

    def _move(self, state: State, t: float, p_BF: np.ndarray, scene: SeenFingers, change: np.ndarray) -> None:
        """Moves the own fingers; `change` (F, 3), m, is the reference's change since the last decision."""
        if state.phase == 0 and t - state.phase_start <= state.settle_time:
            step = self._settling_step(state, t)
        else:
            step = self._correction(state, self._error(state, p_BF, scene))
            step += self._own_movement(state, t, change)
        for own in self._followers:
            step[own] = step[own - 1]
        state.theta = self._motion.follow(state.theta, state.p_HF_past[-1] + step)

    def _correction(self, state: State, error: np.ndarray) -> np.ndarray:
        """Returns a step (5, 3), m, of the own fingers in proportion to the seen errors (F, 3), m."""
        config = self._config
        velocity = np.zeros((5, 3))
        for finger in self._corrected(state):
            velocity[self._own[finger]] = self._rate * state.learned.own_motion(finger, error[finger])
        velocity = limited(velocity, config.max_fingertip_speed)
        weight = config.period / (config.period + config.muscle_time_constant)
        state.finger_velocity = state.finger_velocity + weight * (velocity - state.finger_velocity)
        noise = self._rng.normal(0, config.motor_noise, (5, 1))
        return config.period * state.finger_velocity * (1 + noise)

    def _intended(self, state: State, finger: int, change: np.ndarray) -> np.ndarray:
        """Returns the own step (3,), m, expected to move a robot fingertip by `change` (3,), m."""
        return state.motor @ state.learned.own_motion(finger, change)

    def _return(self, state: State, t: float) -> np.ndarray:
        """Returns the own step (3,), m, of a release, back to where the press began."""
        assert state.p_HF_press is not None and state.p_HF_release is not None  # set by the press
        own = self._own[state.finger]
        back = state.motor @ (state.p_HF_press - state.p_HF_release)[own]
        return self._progress(t - state.phase_start, self._intention.press_time) * back

    def _settling_step(self, state: State, t: float) -> np.ndarray:
        """Returns the step (5, 3), m, of the first movement, from the relaxed to the open hand."""
        displacement = state.p_HF_open - state.p_HF_rest
        return self._progress(t - state.phase_start, state.settle_time) * displacement

    def _progress(self, since: float, duration: float) -> float:
        """Returns the share of a minimum-jerk movement done in the period that ends `since` its start, s."""
        return minimum_jerk(since / duration) - minimum_jerk((since - self._config.period) / duration)

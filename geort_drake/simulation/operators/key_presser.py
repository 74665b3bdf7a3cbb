"""A person who presses keys with the robot's fingers; the intention is a motion of the own fingers.

The person sees the robot's fingertips, the keys and a cue, with delay and noise, and moves the own fingers.
The hand stays where it is. Nothing here knows the retargeting map.
"""

import dataclasses as dc

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import FingerMotion
from geort_drake.simulation.operators.intention import (
    ADAPTIVE,
    MIMICRY,
    SERVO,
    IntentionConfig,
    LearnedMotion,
    learned_in_play,
    motion_noise,
)
from geort_drake.simulation.operators.key_state import KeyPhase, PresserState, SeenKeys
from geort_drake.simulation.operators.perception import VisualError
from geort_drake.simulation.tasks.keys.goal import KeysGoal
from geort_drake.simulation.wrist_motion import minimum_jerk

_DOWN = 0.0035  # m; a key that has gone down so far is seen to be down
_MOVED = 0.0005  # m; a key that has moved so far is seen to move
_PRESS = np.array([1.0, 0.0, 0.0])  # direction in B


class KeyPresser:
    """Decides how a person's fingers move next.

    Args:
        hand: the person's hand.
        goal: the keys.
        kind: SERVO, MIMICRY or ADAPTIVE.
        config, intention: the person's parameters.
        rng: draws the noise of perception and motion.
    """

    def __init__(
        self,
        hand: HumanHand,
        goal: KeysGoal,
        kind: str,
        config: OperatorConfig,
        intention: IntentionConfig,
        rng: np.random.Generator,
    ):
        self._hand, self._goal, self._kind = hand, goal, kind
        self._config, self._intention, self._rng = config, intention, rng
        self._motion = FingerMotion(hand)
        self._own = np.array([FINGER_NAMES.index(name) for name in goal.finger_names])
        self._pressing = np.flatnonzero(goal.touches)
        used = self._own[self._pressing]
        # The own fingers beyond the thumb that press nothing follow their neighbour.
        self._followers = [i for i in range(1, 5) if i not in used]
        self._rate = config.correction_rate if kind != MIMICRY else intention.mimicry_rate

    def start(self, X_WH: RigidTransform) -> PresserState:
        """The state before the first decision: a relaxed hand at X_WH, its thumb straight and aside."""
        theta = self._motion.rest
        theta[:4] = self._hand.upper[0], self._hand.lower[1], 0.0, 0.0
        theta = np.clip(theta, self._hand.lower, self._hand.upper)
        p_HF = self._hand.fingertips(theta)
        steps = round(self._config.visual_delay / self._config.period)
        p_HF_open, goal, play = p_HF.copy(), self._goal, self._goal.play
        num_fingers = len(self._own)
        learned = LearnedMotion.unlearned(num_fingers, self._intention)
        if play is not None and len(play.p_HF):
            noise = np.sqrt(0.5) * motion_noise(self._config, np.inf)
            seen = play.p_BF + self._rng.normal(0, noise, play.p_BF.shape)
            nearest = np.linalg.norm(seen - goal.p_BF_open, axis=-1).argmin(axis=0)
            for finger in self._pressing:
                p_HF_open[self._own[finger]] = play.p_HF[nearest[finger], finger]
            for own in self._followers:
                p_HF_open[own] += p_HF_open[own - 1] - p_HF[own - 1]
            if self._kind == ADAPTIVE:
                learned = learned_in_play(
                    play, p_HF_open[self._own], self._intention, self._config, self._rng
                )
        # A minimum-jerk movement peaks at 15/8 of its mean speed.
        farthest = np.linalg.norm(p_HF_open - p_HF, axis=1)[1:].max()
        return PresserState(
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
            raised=np.zeros(num_fingers),
            reference=goal.p_BF_open.copy(),
            attended=int(self._pressing[0]),
            looked=np.zeros(num_fingers),
        )

    def step(self, state: PresserState, t: float, scene: SeenKeys) -> PresserState:
        """The state after one decision at time t, s; does not change `state`."""
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
        self._move(state, t, p_BF, state.reference - before)
        return state

    def _advance_phase(self, state: PresserState, t: float, scene: SeenKeys) -> None:
        config, since = self._intention, t - state.phase_start
        if scene.cue == 0:
            state.handled_cue = 0
        if state.phase == KeyPhase.SETTLE:
            if since > state.settle_time:
                self._enter(state, KeyPhase.WAIT, t)
        elif state.phase == KeyPhase.WAIT:
            if scene.cue and scene.cue != state.handled_cue:
                state.handled_cue = scene.cue
                state.finger = int(np.flatnonzero(self._goal.key_of == scene.cue - 1)[0])
                self._enter(state, KeyPhase.CHOOSE, t)
        elif state.phase == KeyPhase.CHOOSE:
            if since > config.choice_time:
                self._enter(state, KeyPhase.PRESS, t)
                state.p_HF_press = state.p_HF_past[-1]
        elif state.phase == KeyPhase.PRESS:
            if scene.travel[self._goal.key_of[state.finger]] > _DOWN or not scene.cue:
                self._enter(state, KeyPhase.RELEASE, t)
                state.p_HF_release = state.p_HF_past[-1]
        elif since > config.press_time:
            self._enter(state, KeyPhase.WAIT, t)

    def _enter(self, state: PresserState, phase: KeyPhase, t: float) -> None:
        state.phase, state.phase_start = phase, t
        noise = self._config.motor_noise / np.sqrt(3)
        state.motor = np.eye(3) + self._rng.normal(0, noise, (3, 3))

    def _attend(self, state: PresserState, t: float) -> None:
        """Looks at the finger that presses, or else at the one that was not looked at for longest."""
        state.looked = state.looked.copy()
        state.looked[state.attended] = t
        if t - state.attended_since < self._intention.attention_time:
            return
        if state.phase in (KeyPhase.CHOOSE, KeyPhase.PRESS, KeyPhase.RELEASE):
            next_finger = state.finger
        else:
            next_finger = int(self._pressing[np.argmin(state.looked[self._pressing])])
        if next_finger != state.attended:
            state.attended, state.attended_since, state.compared = next_finger, t, None

    def _compare(self, state: PresserState, t: float, scene: SeenKeys, p_BF: np.ndarray) -> None:
        """Learns from the motion of the finger that is looked at, while its key is seen to be up."""
        config, finger = self._intention, state.attended
        own, robot = state.p_HF_past[0][self._own[finger]], p_BF[finger]
        if scene.travel[self._goal.key_of[finger]] > _MOVED:
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

    def _reference(self, state: PresserState, t: float, scene: SeenKeys) -> np.ndarray:
        """Where the robot's fingertips are meant to be now, (F, 3) m in B."""
        goal, config, since = self._goal, self._intention, t - state.phase_start
        # A key that goes down without a cue shows a finger that is too low.
        idle = np.array([f for f in self._pressing if f != state.finger or state.phase == KeyPhase.WAIT])
        low = [f for f in idle if scene.travel[goal.key_of[f]] > _MOVED]
        state.raised = state.raised.copy()
        for finger in low:
            step = config.lift * self._config.period / config.attention_time
            state.raised[finger] = min(state.raised[finger] + step, 3 * config.lift)
        reference = goal.p_BF_open - np.outer(state.raised, _PRESS)
        if state.phase in (KeyPhase.PRESS, KeyPhase.RELEASE):
            way = (goal.p_BF_pressed - goal.p_BF_open)[state.finger]
            share = minimum_jerk(since / config.press_time)
            if state.phase == KeyPhase.RELEASE:
                share = 1 - share
            late = max(since - config.press_time - self._config.visual_delay, 0.0)
            further = min(config.push_speed * late, config.most_push)
            push = further if state.phase == KeyPhase.PRESS else 0.0
            reference[state.finger] += share * way + push * _PRESS
        return reference

    def _move(self, state: PresserState, t: float, p_BF: np.ndarray, change: np.ndarray) -> None:
        """Moves the own fingers; `change` (F, 3), m, is that of the reference since the last decision."""
        if state.phase == KeyPhase.SETTLE:
            step = self._settling_step(state, t)
        else:
            step = self._correction(state, p_BF)
            if self._kind != SERVO:
                step += self._own_movement(state, t, change)
        for own in self._followers:
            step[own] = step[own - 1]
        state.theta = self._motion.follow(state.theta, state.p_HF_past[-1] + step)

    def _correction(self, state: PresserState, p_BF: np.ndarray) -> np.ndarray:
        """Step (5, 3), m, in proportion to seen errors."""
        config, learned = self._config, state.learned
        # Forward model: since the seen scene, the robot's fingers moved as learned.
        done = (state.p_HF_past[-1] - state.p_HF_past[0])[self._own]
        error = state.reference - p_BF - (learned.J @ done[..., None])[..., 0]
        velocity = np.zeros((5, 3))
        fingers = self._pressing.tolist() if self._kind == SERVO else [state.attended]
        for finger in fingers:
            velocity[self._own[finger]] = self._rate * learned.own_motion(finger, error[finger])
        if self._kind != SERVO and state.phase == KeyPhase.RELEASE:
            velocity[self._own[state.finger]] = 0.0  # goes back to where it was
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        velocity *= np.minimum(1.0, config.max_fingertip_speed / np.maximum(speed, 1e-9))
        weight = config.period / (config.period + config.muscle_time_constant)
        state.finger_velocity = state.finger_velocity + weight * (velocity - state.finger_velocity)
        noise = self._rng.normal(0, config.motor_noise, (5, 1))
        return config.period * state.finger_velocity * (1 + noise)

    def _own_movement(self, state: PresserState, t: float, change: np.ndarray) -> np.ndarray:
        """Step (5, 3), m, of the intended motion: a press as learned, a release to where it began."""
        step = np.zeros((5, 3))
        own = self._own[state.finger]
        if state.phase == KeyPhase.RELEASE:
            assert state.p_HF_press is not None and state.p_HF_release is not None  # set by the press
            back = state.motor @ (state.p_HF_press - state.p_HF_release)[own]
            step[own] = self._progress(t - state.phase_start, self._intention.press_time) * back
        elif state.phase == KeyPhase.PRESS:
            step[own] = state.motor @ state.learned.own_motion(state.finger, change[state.finger])
        return step

    def _settling_step(self, state: PresserState, t: float) -> np.ndarray:
        """Step (5, 3), m, of the first movement, from the relaxed hand to where the task begins."""
        way = state.p_HF_open - state.p_HF_rest
        step = self._progress(t - state.phase_start, state.settle_time) * way
        step[0] = 0.0
        return step

    def _progress(self, since: float, duration: float) -> float:
        """Share of a minimum-jerk movement that is made in one period, after this time, s."""
        return minimum_jerk(since / duration) - minimum_jerk((since - self._config.period) / duration)

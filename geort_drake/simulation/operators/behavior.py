"""Behaviour of a person who grasps with a robot: reach, approach, close, squeeze, lift, and retry.

The person sees the robot's fingertips, its hand and the object, with delay and noise, and moves their hand.
Fingers are corrected continuously, in proportion to the seen error. The wrist makes minimum-jerk movements
and waits to see the result. The person does not know the retargeting map.
"""

from collections.abc import Mapping

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import FingerMotion, limited
from geort_drake.simulation.operators.goal import GraspGoal
from geort_drake.simulation.operators.perception import Seen, SensedGain, VisualError, averaged, perceive
from geort_drake.simulation.operators.state import OperatorState, Phase
from geort_drake.simulation.wrist_motion import WristMovement, minimum_jerk
from geort_drake.systems.port_values import vector_to_pose


class GraspingPerson:
    """Decides from the seen scene how the person's fingers and wrist move next.

    Args:
        hand: the person's hand.
        goal: the intended grasp.
        config: the person's parameters.
        rng: draws the noise of perception and motion.
    """

    phases = Phase

    def __init__(self, hand: HumanHand, goal: GraspGoal, config: OperatorConfig, rng: np.random.Generator):
        self._hand = hand
        self._motion = FingerMotion(hand)
        self._goal = goal
        self._config = config
        self._rng = rng
        # The person's finger for each robot finger; their other fingers follow their neighbour.
        self._own = np.array([FINGER_NAMES.index(name) for name in goal.finger_names])
        self._followers = [i for i in range(5) if i not in self._own]
        self._posture = np.zeros(0), np.zeros((5, 3))  # the last one and its fingertips

    def start(self, X_WH: RigidTransform) -> OperatorState:
        """Returns the state before the first decision: a relaxed hand at X_WH."""
        theta = self._motion.rest
        steps = round(self._config.visual_delay / self._config.period)
        p_HF = self._hand.fingertips(theta)
        return OperatorState(
            theta=theta,
            X_WH=X_WH,
            p_HF_past=(p_HF,) * max(steps, 1),
            sensed=SensedGain(),
            visual_error=VisualError.draw(len(self._own), self._config, self._rng),
        )

    def seen(self, values: Mapping[str, np.ndarray]) -> Seen:
        """Returns the scene from the values of ports; without `place_pose`, the object has no place."""
        poses = {name: vector_to_pose(value) for name, value in values.items() if name.endswith("_pose")}
        return Seen(
            p_WF=values["fingertips"].reshape(-1, 3),
            X_WB=poses["hand_pose"],
            X_WO=poses["object_pose"],
            contact=values["contact"],
            X_WP=poses.get("place_pose"),
        )

    def step(self, state: OperatorState, t: float, scene: Seen) -> OperatorState:
        """Returns the state after one decision at time t, s; does not change `state`."""
        if state.theta is not self._posture[0]:  # a hand that holds something keeps its posture
            self._posture = state.theta, self._hand.fingertips(state.theta)
        past = (*state.p_HF_past[1:], self._posture[1])
        visual_error = state.visual_error.later(self._config, self._rng)
        state = state.having(p_HF_past=past, visual_error=visual_error)
        seen = perceive(scene, visual_error, self._config, self._rng)
        free = seen.contact <= self._config.touch_force
        # The oldest remembered own fingertips are as old as the seen scene.
        tips = np.array([past[0][self._own], seen.p_BF])
        state.fingertips = averaged(state.fingertips, tips, self._config)
        own, robot = state.fingertips
        state.sensed = state.sensed.update(t, own, robot, free)
        state.p_BO = averaged(state.p_BO, seen.X_BW @ seen.X_WO.translation(), self._config)
        error = self._fingertip_errors(state, seen)
        state.shape_error = averaged(state.shape_error, error, self._config)
        self._advance_phase(state, t, seen)
        if state.shape_error is None:  # a new phase has other fingertip targets
            state.shape_error = error = self._fingertip_errors(state, seen)
        self._move_fingers(state, t, seen, error)
        self._move_wrist(state, t, seen)
        return state

    # -- phases

    def _advance_phase(self, state: OperatorState, t: float, seen: Seen) -> None:
        config, goal = self._config, self._goal
        # After several movements, the arm is taken to be unable to bring the hand nearer.
        wrist_arrived = self._wrist_rests(state, t) and (
            state.movements >= config.max_corrections or self._at(state, seen)
        )
        touching = (seen.contact > config.touch_force)[goal.touches]
        if state.phase in (Phase.REACH, Phase.RELEASE):
            # Fingers at their limit may miss by up to the clearance.
            near = goal.clearance if self._fingers_at_limit(state, t) else 0.0
            if wrist_arrived and self._worst_error(state) < max(config.shape_tolerance, near):
                self._enter(state, Phase.APPROACH, t)
        elif state.phase == Phase.APPROACH:
            if wrist_arrived:
                self._enter(state, Phase.SURROUND, t)
        elif state.phase == Phase.SURROUND:
            if self._wrist_rests(state, t) and self._shaped(state, t, seen, config.aperture_tolerance):
                self._enter(state, Phase.CLOSE, t)
        elif state.phase == Phase.CLOSE:
            # A person without touch takes fingers that have stopped to be touching.
            stopped = not config.touch and self._fingers_at_limit(state, t)
            if touching.all() or (stopped and self._hand_shift(state, seen) is None):
                self._enter(state, Phase.SQUEEZE, t)
                state.p_HF_start = state.p_HF_past[-1]
                R_BO = (seen.X_BW @ goal.object_frame(seen.X_WO)).rotation().matrix()
                state.n_BF = goal.n_OF @ R_BO.T
        elif state.phase == Phase.SQUEEZE:
            if t - state.phase_start >= config.squeeze_time + config.settle_time:
                self._enter(state, Phase.LIFT, t)
                state.p_BO_start = state.p_BO
        elif self._has_slipped(state):
            self._enter(state, Phase.RELEASE, t)
            state.attempt += 1
        elif state.phase == Phase.LIFT and self._wrist_rests(state, t) and state.movement is not None:
            self._enter(state, Phase.HOLD, t)

    def _enter(self, state: OperatorState, phase: Phase, t: float) -> None:
        state.phase, state.phase_start = phase, t
        state.best_error, state.best_time = np.inf, t
        state.shape_error = state.intended = None
        if phase != Phase.HOLD:
            state.movement, state.movements = None, 0

    def _shaped(self, state: OperatorState, t: float, seen: Seen, tolerance: float) -> bool:
        """Whether the fingertips are at their targets, or as near as fingers and hand can bring them."""
        if self._worst_error(state) < tolerance:
            return True
        return self._fingers_at_limit(state, t) and self._hand_shift(state, seen) is None

    def _worst_error(self, state: OperatorState) -> float:
        assert state.shape_error is not None  # set at the start of every decision
        return float(np.linalg.norm(state.shape_error[self._goal.touches], axis=1).max())

    def _fingers_at_limit(self, state: OperatorState, t: float) -> bool:
        worst = self._worst_error(state)
        if worst < state.best_error - 0.001:
            state.best_error, state.best_time = worst, t
        return t - state.best_time > self._config.patience

    def _hand_shift(self, state: OperatorState, seen: Seen) -> np.ndarray | None:
        """Returns a shift of the hand, (3,) m in W, for errors out of the fingers' reach; None if small.

        It is the midrange of the fingertips' errors, which minimises the largest error.
        """
        error = state.shape_error
        assert error is not None  # set at the start of every decision
        if state.phase == Phase.CLOSE:
            # Errors to the surface, not to the targets below it; a finger that touches has arrived.
            X_BO = seen.X_BW @ self._goal.object_frame(seen.X_WO)
            error = error - self._config.overshoot * (self._goal.n_OF @ X_BO.rotation().matrix().T)
            error[seen.contact > self._config.touch_force] = 0
        error = error[self._goal.touches]
        middle = 0.5 * (error.min(axis=0) + error.max(axis=0))
        if np.linalg.norm(middle) < self._config.shift_tolerance:
            return None
        return seen.X_WB.rotation().matrix() @ middle

    def _has_slipped(self, state: OperatorState) -> bool:
        assert state.p_BO is not None and state.p_BO_start is not None  # set when the lift begins
        return bool(np.linalg.norm(state.p_BO - state.p_BO_start) > self._config.lost_distance)

    # -- fingers

    def _fingertip_errors(self, state: OperatorState, seen: Seen) -> np.ndarray:
        """Returns vectors from the seen robot fingertips to their targets, (F, 3) m in B."""
        target = self._goal.p_BF_open.copy()
        if state.phase in (Phase.SURROUND, Phase.CLOSE):
            X_BO = seen.X_BW @ self._goal.object_frame(seen.X_WO)
            closing = state.phase == Phase.CLOSE
            depth = self._config.overshoot if closing else -self._config.aperture
            aim = self._goal.p_OF_touch + depth * self._goal.n_OF
            touches = self._goal.touches
            target[touches] = X_BO.multiply(aim[touches].T).T
        error = target - seen.p_BF
        if state.phase == Phase.SURROUND:
            # A finger that touches has arrived: a person does not push what they feel.
            error[self._goal.touches & (seen.contact > self._config.touch_force)] = 0
        return error

    def _move_fingers(self, state: OperatorState, t: float, seen: Seen, error: np.ndarray) -> None:
        """Moves the person's fingers to reduce `error` (F, 3), m, of the robot's fingertips in B."""
        config = self._config
        if state.phase in (Phase.SQUEEZE, Phase.LIFT, Phase.HOLD, Phase.CARRY, Phase.LOWER):
            self._squeeze(state, t)
            return
        p_HF = state.p_HF_past[-1]
        # Forward model (Miall and Wolpert 1996) of the robot's motion since the seen scene.
        done = self._expected(state, (p_HF - state.p_HF_past[0])[self._own])
        error = error - done
        limit = np.full(len(error), config.max_fingertip_speed)
        if state.phase == Phase.CLOSE:
            limit = config.closing_speed * self._closing_fraction(state.shape_error - done, seen)
        target = np.zeros((5, 3))
        target[self._own] = limited(self._wanted_velocity(state, t, error, limit[:, None]), limit[:, None])
        for own in self._followers:
            target[own] = target[own - 1]
        share = config.period / (config.period + config.muscle_time_constant)
        velocity = state.finger_velocity + share * (target - state.finger_velocity)
        state.finger_velocity = velocity
        noisy = velocity * (1 + self._rng.normal(0, config.motor_noise, (5, 1)))
        state.theta = self._motion.follow(state.theta, p_HF + config.period * noisy)

    def _expected(self, state: OperatorState, own: np.ndarray) -> np.ndarray:
        """Returns the robot motion (F, 3), m, expected for `own` finger motion; here the same."""
        return own

    def _wanted_velocity(
        self, state: OperatorState, t: float, error: np.ndarray, limit: np.ndarray
    ) -> np.ndarray:
        """Returns velocities (F, 3), m/s, of own fingertips that reduce the robot's errors (F, 3), m."""
        return self._config.correction_rate * error

    def _inwards(self, state: OperatorState, share: float) -> np.ndarray:
        """Returns the motion (F, 3), m, of own fingertips after `share` of a squeeze, by the sensed gain.

        The axes of H and B are assumed to be parallel.
        """
        assert state.n_BF is not None  # set when the squeeze begins
        return self._config.squeeze / state.sensed.ratio * share * state.n_BF

    def _squeeze(self, state: OperatorState, t: float) -> None:
        """Moves the grasping fingertips inwards in the phase SQUEEZE; otherwise keeps the posture."""
        config, goal = self._config, self._goal
        state.finger_velocity = np.zeros((5, 3))
        if state.phase != Phase.SQUEEZE:
            return
        assert state.p_HF_start is not None  # set when the squeeze begins
        share = minimum_jerk((t - state.phase_start) / config.squeeze_time)
        inwards, touches = np.zeros((5, 3)), goal.touches
        inwards[self._own[touches]] = self._inwards(state, share)[touches]
        state.theta = self._motion.follow(state.theta, state.p_HF_start + inwards)

    def _closing_fraction(self, error: np.ndarray, seen: Seen) -> np.ndarray:
        """Returns fractions (F,) of the closing speed: touching fingers stop, leading ones wait."""
        config, touches = self._config, self._goal.touches
        distance = np.linalg.norm(error, axis=1)
        touching = seen.contact > config.touch_force
        pending = touches & ~touching
        slowest = distance[pending].max() if pending.any() else 0.0
        fraction = np.clip(1 - (slowest - distance - config.closing_lead) / config.closing_lead, 0, 1)
        return np.where(touches & touching, 0.0, fraction)

    # -- wrist

    def _target_hand_pose(self, state: OperatorState, seen: Seen) -> RigidTransform:
        X_WO = self._goal.object_frame(seen.X_WO)
        before = state.phase in (Phase.REACH, Phase.RELEASE, Phase.RETREAT)
        return X_WO @ (self._goal.X_OB_before if before else self._goal.X_OB)

    def _wrist_rests(self, state: OperatorState, t: float) -> bool:
        if state.movement is None:
            return True
        return t >= state.movement.t_end + self._config.visual_delay + self._config.judging_time

    def _at(self, state: OperatorState, seen: Seen) -> bool:
        X = seen.X_BW @ self._target_hand_pose(state, seen)
        turn = X.rotation().ToAngleAxis().angle()
        return bool(
            np.linalg.norm(X.translation()) < self._reach_tolerance(state)
            and turn < self._config.turn_tolerance
        )

    def _reach_tolerance(self, state: OperatorState) -> float:
        return self._config.reach_tolerance

    def _move_wrist(self, state: OperatorState, t: float, seen: Seen) -> None:
        if self._wrist_rests(state, t):
            shift = self._wrist_shift(state, t, seen)
            if shift is not None:
                state.movement = WristMovement.planned(state.X_WH, *shift, t, self._config, self._rng)
                state.movements += 1
        # Two periods after its end, the last pose has been applied, and the wrist stays there.
        if state.movement is not None and t < state.movement.t_end + 2 * self._config.period:
            state.X_WH = state.movement.pose(t)

    def _wrist_shift(
        self, state: OperatorState, t: float, seen: Seen
    ) -> tuple[np.ndarray, RotationMatrix] | None:
        """Returns translation (m) and rotation in W of the next movement; None to stay."""
        if state.phase == Phase.LIFT:
            raised = state.movement is not None
            return None if raised else (np.array([0, 0, self._config.lift_height]), RotationMatrix())
        if state.phase in (Phase.SQUEEZE, Phase.HOLD):
            return None
        if state.phase in (Phase.SURROUND, Phase.CLOSE):
            if not self._fingers_at_limit(state, t):
                return None
            shift = self._hand_shift(state, seen)
            if shift is None:
                return None
            state.best_error, state.best_time = np.inf, t
            return shift, RotationMatrix()
        if self._at(state, seen):
            return None
        target = self._target_hand_pose(state, seen)
        turn = target.rotation() @ seen.X_WB.rotation().inverse()
        return target.translation() - seen.X_WB.translation(), turn

"""The engine of the simulated person, who sees and feels the robot and moves their own hand.

The behaviour in a task is a table of phases. In each, the person intends positions of the robot's fingertips
and of its hand; kinds of people differ in how they move their own fingers for that. The own fingers are
solid: where they meet, they stop. The person does not know the retargeting map.
"""

import dataclasses as dc
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.solid import MAX_INTERPENETRATION, SolidHand
from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.person.finger_motion import FingerMotion, limited
from geort_drake.simulation.person.learning import LearnedMotion, learn_in_play, motion_noise
from geort_drake.simulation.person.perception import Percept, average, draw_errors, later_errors, perceive
from geort_drake.simulation.wrist_motion import WristMovement, minimum_jerk
from geort_drake.systems.port_values import Immutable


class Kind(NamedTuple):
    """A kind of person: how they move a finger so that the robot's fingertip moves as intended.

    Attributes:
        feedforward: the own motion made for an intended one: "none", the same ("as own"), or the one that the
            person has "learned" to cause it.
        rate: name of the parameter with the rate at which seen errors are corrected.
        looks_at: whether errors of "all" fingers are corrected, or those of "one" and the thumb.
    """

    feedforward: str
    rate: str
    looks_at: str


KINDS = {
    "adaptive": Kind("learned", "correction_rate", "one"),
    "mimicry": Kind("as own", "mimicry_rate", "one"),
    "servo": Kind("none", "correction_rate", "all"),
}


class Phase(NamedTuple):
    """A row of the table that describes the person's behaviour in a task.

    The first lines of the functions' docstrings are the cells of that table in the docs.

    Attributes:
        name: name of the phase.
        fingertips: intended positions of the robot's fingertips, (F, 3) m in B, NaN for fingers that rest;
            None to keep the posture.
        ends: name of the next phase, or None to go on.
        wrist: intended pose of the robot's hand, X_WB; None to rest.
        speed: name of the parameter that limits the fingertips' intended speed, or a function that returns
            limits (F,), m/s. The largest limits corrections.
        error: corrects the seen errors (F, 3), m, before the person acts on them.
        press: intended velocities (F, 3), m/s in B, of the robot's fingertips that press or let go, besides
            all else. Force cannot be seen, so people of all kinds make this motion with their own fingers;
            only those who have learned know another one.
        from_seen: whether the intended motion begins where the fingertips are seen, not where they were meant
            to be.
        wrist_speed: name of the parameter with the wrist's peak speed.
    """

    name: str
    fingertips: Callable[["Moment"], np.ndarray | None]
    ends: Callable[["Moment"], str | None]
    wrist: Callable[["Moment"], RigidTransform | None]
    speed: str | Callable[["Moment"], np.ndarray] = "max_fingertip_speed"
    error: Callable[["Moment", np.ndarray], np.ndarray] | None = None
    press: Callable[["Moment"], np.ndarray] | None = None
    from_seen: bool = False
    wrist_speed: str = "peak_wrist_speed"


def opposition(p_F: np.ndarray, touches: np.ndarray, thumb: int) -> np.ndarray:
    """Returns motions (F, 3) of fingertips that press from both sides and leave their sum where it is.

    Each of n fingers moves towards the thumb, by 1/n, and the thumb by as much towards them as all of them
    together; other fingers rest. Forces along the lines between contacts are internal: they neither push nor
    turn what is held (Williams and Khatib 1993, "The virtual linkage", ICRA).

    Args:
        p_F: fingertips (F, 3), m.
        touches: (F,) which of them press.
        thumb: index of the thumb, which presses in any case.
    """
    others = touches & (np.arange(len(p_F)) != thumb)
    way = np.where(others[:, None], p_F[thumb] - p_F, 0.0)
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9) * max(np.count_nonzero(others), 1)
    way[thumb] = -way.sum(axis=0)
    return way


def rest(m: "Moment") -> None:
    """rests"""


@dc.dataclass
class Memory(Immutable):
    """The person's memory between decisions; `Person.step` changes only a copy of it.

    Frames: H the person's wrist, B the robot's hand base.
    """

    theta: np.ndarray  # (20,) joint angles of the own hand, rad
    X_WH: RigidTransform
    # (5, 3) own fingertips in H at the last decisions, m; the oldest are as old as the seen scene.
    p_HF_past: tuple[np.ndarray, ...]
    sight: np.ndarray  # present errors of vision, see `draw_errors`
    learned: LearnedMotion
    # The movement of the first phase: own fingertips (5, 3) where it starts, those of the open hand, m, and
    # its duration, s.
    p_HF_start: np.ndarray
    p_HF_open: np.ndarray
    settle_time: float
    phase: int = 0
    phase_start: float = 0.0
    is_looking: bool = False  # whether the person has seen the scene yet
    attempt: int = 1
    finger_velocity: np.ndarray = dc.field(default_factory=lambda: np.zeros((5, 3)))
    # (F, 3) intended positions of the robot's fingertips in B now, m.
    reference: np.ndarray = dc.field(default_factory=lambda: np.zeros((0, 3)))
    # The wrist's present or last movement in this phase, and the number of movements.
    movement: WristMovement | None = None
    movements: int = 0
    # Averages over time: the fingertips' errors (F, 3), m, in this phase, and the object's origin in B, (3,).
    error: np.ndarray | None = None
    p_BO: np.ndarray | None = None
    # Smallest error of a fingertip in this phase, m, and when it last fell, s.
    best_error: float = np.inf
    best_time: float = 0.0
    # Finger that is looked at, since when, and when each finger was last looked at (F,), s.
    attended: int = -1
    attended_since: float = 0.0
    looked_at: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    # Own and robot fingertip (3,), m, at the last comparison of their motions, and its time, s.
    compared: tuple[np.ndarray, np.ndarray] | None = None
    compared_at: float = 0.0
    # (3, 3) matrix applied to the present movement: motor error in direction and size.
    motor: np.ndarray = dc.field(default_factory=lambda: np.eye(3))
    # What phases remember.
    notes: Mapping[str, Any] = dc.field(default_factory=dict)


@dc.dataclass
class Moment:
    """What a phase decides upon: the present time, what is seen and felt, and what is remembered.

    Attributes:
        t: time, s.
        percept: the scene as it is perceived.
        memory: the person's memory, which the engine changes.
        expected: motion of the robot's fingertips that is expected since the seen scene, (F, 3) m.
        goal, config, settings: the goal, the person's parameters, and the task's settings.
    """

    t: float
    percept: Percept
    memory: Memory
    expected: np.ndarray
    goal: Any
    config: OperatorConfig
    settings: Any

    @property
    def since(self) -> float:
        """Time since the phase began, s."""
        return self.t - self.memory.phase_start

    @property
    def thumb(self) -> int:
        """Index of the thumb."""
        return self.goal.finger_names.index("thumb")

    @functools.cached_property
    def feels(self) -> np.ndarray:
        """(F,) whether each of the robot's fingers is felt to touch."""
        return self.percept.contact > self.config.touch_force

    def note(self, **notes: Any) -> None:
        """Remembers values for later moments."""
        self.memory.notes = {**self.memory.notes, **notes}

    def recall(self, name: str, default: Any = None) -> Any:
        """Returns a remembered value."""
        return self.memory.notes.get(name, default)

    def move(self, duration: float) -> float:
        """Returns the progress in [0, 1] of a minimum-jerk movement since the phase began."""
        return minimum_jerk(self.since / duration)

    @property
    def worst_error(self) -> float:
        """Largest averaged error of a touching fingertip, m."""
        error = self.memory.error
        assert error is not None  # set at the start of every decision
        return float(np.nan_to_num(np.linalg.norm(error[self.goal.touches], axis=1)).max())

    def tolerance(self, tolerance: float) -> float:
        """Returns a wanted tolerance, m, or the person's error of vision if it is larger: they know it."""
        return max(tolerance, self.config.visual_error)

    @property
    def turn_tolerance(self) -> float:
        """Tolerance of a rotation between two bodies, rad; each is seen with errors about three axes."""
        return max(self.config.turn_tolerance, np.sqrt(6) * self.config.visual_turn_noise)

    @property
    def fingers_at_limit(self) -> bool:
        """Whether the fingertips' error has not fallen for a while."""
        return self.t - self.memory.best_time > self.config.patience

    def fingers_have_come(self, tolerance: float) -> bool:
        """Whether the fingertips are within a tolerance, m, of their targets, or come no nearer."""
        return self.worst_error < self.tolerance(tolerance) or self.fingers_at_limit

    @property
    def wrist_rests(self) -> bool:
        """Whether the wrist rests, and its last movement has been seen."""
        movement = self.memory.movement
        if movement is None:
            return True
        return self.t >= movement.t_end + self.config.visual_delay + self.config.judging_time

    def is_at(self, X_WB: RigidTransform, tolerance: float) -> bool:
        """Whether the robot's hand is seen at a pose, within a distance, m."""
        X = self.percept.X_BW @ X_WB
        is_near = np.linalg.norm(X.translation()) < tolerance
        return bool(is_near and X.rotation().ToAngleAxis().angle() < self.turn_tolerance)

    def has_arrived(self, X_WB: RigidTransform, tolerance: float) -> bool:
        """Whether the wrist rests at a pose, or cannot come nearer."""
        gives_up = self.memory.movements >= self.config.max_corrections
        return self.wrist_rests and (gives_up or self.is_at(X_WB, tolerance))


class Person:
    """Decides from the seen scene how a person's fingers and wrist move next.

    Args:
        hand: the person's hand.
        goal: what the person intends.
        phases: the person's behaviour.
        kind: name of one of `KINDS`.
        config, settings: the person's parameters, and the task's settings.
        rng: draws the noise of perception and motion.
        straight: whether the fingers are straight at first, because bent ones would collide.
    """

    def __init__(
        self,
        hand: HumanHand,
        goal: Any,
        phases: Sequence[Phase],
        kind: str,
        config: OperatorConfig,
        settings: Any,
        rng: np.random.Generator,
        straight: bool = False,
    ):
        self.phases = tuple(phases)
        self.hand, self.config, self.rng = hand, config, rng
        self._goal, self._kind, self._settings = goal, KINDS[kind], settings
        self._straight = straight
        self._motion, self._solid = FingerMotion(hand), SolidHand(hand)
        self._numbers = {phase.name: number for number, phase in enumerate(phases)}
        self._finger_numbers = np.array([FINGER_NAMES.index(name) for name in goal.finger_names])
        self._thumb = goal.finger_names.index("thumb") if "thumb" in goal.finger_names else -1
        self._touching = np.flatnonzero(goal.touches)
        # Fingers whose positions do not matter follow their neighbour, except the thumb.
        moving = self._finger_numbers[np.isfinite(goal.p_BF_open).all(axis=1)]
        self._followers = [number for number in range(1, 5) if number not in moving]
        self._rate = getattr(config, self._kind.rate)
        self._posture = np.zeros(0), np.zeros((5, 3))  # the last one and its fingertips

    # -- memory

    def start(self, X_WH: RigidTransform) -> Memory:
        """Returns the memory before the first decision: a relaxed hand at X_WH that does not move."""
        theta = self._first_posture()
        p_HF, num_fingers, config = self.hand.fingertips(theta), len(self._finger_numbers), self.config
        p_HF_open, goal, play = p_HF.copy(), self._goal, self._goal.play
        learned = LearnedMotion.initial(num_fingers, config)
        if play is not None and len(play.p_HF):
            # The hand opens as it did when the robot's fingertips were nearest to the goal.
            noise = np.sqrt(0.5) * motion_noise(config, np.inf)
            p_BF = play.p_BF + self.rng.normal(0, noise, play.p_BF.shape)
            nearest = np.linalg.norm(p_BF - goal.p_BF_open, axis=-1).argmin(axis=0)
            for finger in np.flatnonzero(np.isfinite(goal.p_BF_open).all(axis=1)).tolist():
                p_HF_open[self._finger_numbers[finger]] = play.p_HF[nearest[finger], finger]
            for follower in self._followers:
                p_HF_open[follower] += p_HF_open[follower - 1] - p_HF[follower - 1]
            if self._kind.feedforward == "learned":
                learned = learn_in_play(play, p_HF_open[self._finger_numbers], config, self.rng)
        return Memory(
            theta=theta,
            X_WH=X_WH,
            p_HF_past=(p_HF,) * max(round(config.visual_delay / config.period), 1),
            sight=draw_errors(num_fingers, config, self.rng),
            learned=learned,
            p_HF_start=p_HF,
            p_HF_open=p_HF_open,
            settle_time=self._settle_time(p_HF, p_HF_open),
            reference=goal.p_BF_open.copy(),
            attended=int(self._touching[0]),
            looked_at=np.zeros(num_fingers),
        )

    def _settle_time(self, p_HF: np.ndarray, p_HF_open: np.ndarray) -> float:
        """Returns the duration, s, of the movement between own fingertips (5, 3), m."""
        # A minimum-jerk movement peaks at 15/8 of its mean speed.
        farthest = np.linalg.norm(p_HF_open - p_HF, axis=1).max()
        return max(self.config.min_movement_time, 1.875 * farthest / self.config.max_fingertip_speed)

    def _first_posture(self) -> np.ndarray:
        """Returns joint angles (20,), rad, of a relaxed hand; or of a straight one, with abducted thumb."""
        theta = self._motion.rest.reshape(5, 4)
        if self._straight:
            theta[0] = self.hand.upper[0], self.hand.lower[1], 0.0, 0.0
            theta[1:, 1:] = 0.0
        return self._solid.separate(np.clip(theta.ravel(), self.hand.lower, self.hand.upper))

    # -- decisions

    def step(self, memory: Memory, t: float, scene: Percept) -> Memory:
        """Returns the memory after one decision at time t, s; does not change `memory`."""
        config, rng = self.config, self.rng
        if memory.theta is not self._posture[0]:  # a hand that holds something keeps its posture
            self._posture = memory.theta, self.hand.fingertips(memory.theta)
        past = (*memory.p_HF_past[1:], self._posture[1])
        memory = dc.replace(memory, p_HF_past=past, sight=later_errors(memory.sight, config, rng))
        percept = perceive(scene, memory.sight, config, rng)
        m = Moment(t, percept, memory, self._expected(memory), self._goal, config, self._settings)
        if not memory.is_looking:
            memory.is_looking, memory.phase_start, memory.best_time = True, t, t
        memory.p_BO = average(memory.p_BO, percept.X_BW @ percept.X_WO.translation(), config)
        target = self._look(m)
        following = self.phases[memory.phase].ends(m)
        if following is not None:
            self._enter(m, following)
            target = self._look(m)
        self._attend(m)
        if self._kind.feedforward == "learned":
            self._compare(m)
        self._move_fingers(m, target)
        self._move_wrist(m)
        return memory

    def _look(self, m: Moment) -> np.ndarray | None:
        """Returns the phase's fingertips, and judges the errors of the robot's."""
        memory, target = m.memory, self.phases[m.memory.phase].fingertips(m)
        if target is not None:
            memory.error = average(memory.error, target - m.percept.p_BF, self.config)
            if m.worst_error < memory.best_error - 0.001:
                memory.best_error, memory.best_time = m.worst_error, m.t
        return target

    def _enter(self, m: Moment, name: str) -> None:
        memory = m.memory
        memory.phase, memory.phase_start = self._numbers[name], m.t
        phase = self.phases[memory.phase]
        memory.best_error, memory.best_time, memory.error = np.inf, m.t, None
        memory.movement, memory.movements = None, 0
        if phase.from_seen:
            memory.reference = m.percept.p_BF + m.expected
        if memory.phase == 0:
            memory.p_HF_start = memory.p_HF_past[-1]
            memory.settle_time = self._settle_time(memory.p_HF_start, memory.p_HF_open)
        noise = self.config.motor_noise / np.sqrt(3)
        memory.motor = np.eye(3) + self.rng.normal(0, noise, (3, 3))

    def _attend(self, m: Moment) -> None:
        """Looks at the finger that acts, or at the one of those that still move longest not looked at."""
        memory = m.memory
        memory.looked_at = memory.looked_at.copy()
        memory.looked_at[memory.attended] = m.t
        if m.t - memory.attended_since < self.config.attention_time:
            return
        candidates = m.recall("acting", self._touching[~m.feels[self._touching]])
        others = candidates[candidates != self._thumb]
        candidates = others if len(others) else candidates if len(candidates) else self._touching
        finger = int(candidates[np.argmin(memory.looked_at[candidates])])
        if finger != memory.attended:
            memory.attended, memory.attended_since, memory.compared = finger, m.t, None

    def _compare(self, m: Moment) -> None:
        """Learns from the motion of the finger that is looked at, while it is free."""
        config, memory, finger = self.config, m.memory, m.memory.attended
        human, robot = memory.p_HF_past[0][self._finger_numbers[finger]], m.percept.p_BF[finger]
        if m.percept.contact[finger] > config.touch_force:
            memory.compared = None
            return
        elapsed = m.t - memory.compared_at
        if memory.compared is None:
            memory.compared, memory.compared_at = (human, robot), m.t
        elif elapsed >= config.comparison_time:
            human_motion = human - memory.compared[0]
            if np.linalg.norm(human_motion) > config.least_motion:
                robot_motion, noise = robot - memory.compared[1], motion_noise(config, elapsed)
                memory.learned = memory.learned.compared(
                    finger, human_motion, robot_motion, noise, elapsed, config.jacobian_drift
                )
            memory.compared, memory.compared_at = (human, robot), m.t

    # -- fingers

    def _expected(self, memory: Memory) -> np.ndarray:
        """Returns the robot's motion (F, 3), m, since the seen scene, by the forward model.

        The person assumes that the robot has moved as they have learned (Miall and Wolpert 1996).
        """
        motion = (memory.p_HF_past[-1] - memory.p_HF_past[0])[self._finger_numbers]
        return np.einsum("fij,fj->fi", memory.learned.J, motion)

    def _move_fingers(self, m: Moment, target: np.ndarray | None) -> None:
        config, memory, phase = self.config, m.memory, self.phases[m.memory.phase]
        if memory.phase == 0 and m.since <= memory.settle_time:
            share = m.move(memory.settle_time) - minimum_jerk((m.since - config.period) / memory.settle_time)
            self._follow(memory, share * (memory.p_HF_open - memory.p_HF_start))
            # Until the movement ends, no error counts, and what is intended then begins at the open hand.
            memory.reference, memory.best_error, memory.best_time = self._goal.p_BF_open, np.inf, m.t
            memory.finger_velocity = np.zeros((5, 3))
            return
        step = np.zeros((5, 3))
        if phase.press is not None:
            for finger, change in enumerate(config.period * phase.press(m)):
                step[self._finger_numbers[finger]] += memory.learned.own_motion(finger, change)
        if target is None:
            memory.finger_velocity = np.zeros((5, 3))
            if not step.any():  # the hand keeps its posture
                return
        else:
            moves = np.isfinite(target).all(axis=1)
            speed = phase.speed(m) if callable(phase.speed) else getattr(config, phase.speed)
            limit = np.broadcast_to(speed, moves.shape)[:, None]
            way = np.where(moves[:, None], target - memory.reference, 0.0)
            change = config.period * limited(way / config.period, limit)
            memory.reference = memory.reference + change
            # Fingers that wait for others are corrected all the same.
            step += self._correction(m, moves, limit.max())
            if self._kind.feedforward != "none":
                for finger in np.flatnonzero(moves).tolist():
                    motion = memory.motor @ memory.learned.own_motion(finger, change[finger])
                    step[self._finger_numbers[finger]] += motion
        self._follow(memory, step)

    def _correction(self, m: Moment, moves: np.ndarray, limit: float) -> np.ndarray:
        """Returns a step (5, 3), m, of the own fingers in proportion to the seen errors."""
        config, memory, phase = self.config, m.memory, self.phases[m.memory.phase]
        error = memory.reference - m.percept.p_BF - m.expected
        if phase.error is not None:
            error = phase.error(m, error)
        if self._kind.looks_at == "one":
            moves = moves & np.isin(np.arange(len(moves)), (self._thumb, memory.attended))
        velocity = np.zeros((5, 3))
        for finger in np.flatnonzero(moves).tolist():
            robot_velocity = limited(self._rate * error[finger][None], limit)[0]
            velocity[self._finger_numbers[finger]] = memory.learned.own_motion(finger, robot_velocity)
        weight = config.period / (config.period + config.muscle_time_constant)
        memory.finger_velocity = memory.finger_velocity + weight * (velocity - memory.finger_velocity)
        noise = self.rng.normal(0, config.motor_noise, (5, 1))
        return config.period * memory.finger_velocity * (1 + noise)

    def _follow(self, memory: Memory, step: np.ndarray) -> None:
        """Moves the own fingertips by a step (5, 3), m."""
        for follower in self._followers:
            step[follower] = step[follower - 1]
        theta = memory.theta
        target = self._motion.follow(theta, memory.p_HF_past[-1] + step)
        touching = self._solid.depths(target)[: len(FINGER_NAMES) - 1] > MAX_INTERPENETRATION
        if touching.any():  # the own thumb and a finger feel that they meet, and both stop there
            digits = np.append(True, touching)
            target = np.where(np.repeat(digits, 4), theta, target)
            memory.finger_velocity = np.where(digits[:, None], 0.0, memory.finger_velocity)
        memory.theta, _ = self._solid.move(theta, target)

    # -- wrist

    def _move_wrist(self, m: Moment) -> None:
        memory, phase = m.memory, self.phases[m.memory.phase]
        if m.wrist_rests and (target := phase.wrist(m)) is not None:
            shift = target.translation() - m.percept.X_WB.translation()
            turn = target.rotation() @ m.percept.X_WB.rotation().inverse()
            memory.movement = WristMovement.planned(
                memory.X_WH, shift, turn, m.t, self.config, self.rng, phase.wrist_speed
            )
            memory.movements += 1
        # Two periods after its end, the last pose has been applied, and the wrist stays there.
        movement = memory.movement
        if movement is not None and m.t < movement.t_end + 2 * self.config.period:
            memory.X_WH = movement.pose(m.t)

"""Adapts the universal map to the person: estimates their code and fades to the map for it."""

import dataclasses as dc
from collections.abc import Callable
from functools import partial

import numpy as np

from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.retargeting.numpy_retargeter import Retargeter
from geort_drake.retargeting.person_observer import PersonObserver
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.systems.port_values import Immutable
from geort_drake.systems.retargeting_status import LEARNING, TRACKING, UNUSUAL

OBSERVATION_PERIOD = 0.03  # s; the frame period of the slowest device in training
FADE_TIME = 0.5  # s, to fade from one map to the next
HOLD_TIME = 1.0  # s, for which another person's hand is observed before it is followed
LEARNED_AFTER = 100  # observations, after which the person is known
_MIN_CODE_CHANGE = 0.1  # standard deviations of the code; a smaller change keeps the map
_ROUNDING = 1e-9  # s


@dc.dataclass(frozen=True)
class PersonFollowing(Immutable):
    """Observations of the person, their estimated code, and the map for it.

    Attributes:
        universal: the universal map.
        observer: observations so far.
        last: keypoints (21, 3) of the last observation, m; NaN before the first.
        code: the person's code; None before the first estimate.
        now, before: the present map, and the one that it replaces.
        since: when `now` began to replace `before`, s.
        own: whether `now` was fitted to the person; then the code no longer changes it.
        judged: when code and change of person were last checked, s.
        changed: when another person was noticed, s.
        unusual: what is unusual about the hand; see `UniversalRetargeter.unusual`.
    """

    universal: UniversalRetargeter
    observer: PersonObserver
    last: np.ndarray = dc.field(default_factory=lambda: np.full((KEYPOINT_COUNT, 3), np.nan))
    code: np.ndarray | None = None
    now: Retargeter | None = None
    before: Callable[[np.ndarray], np.ndarray] | None = None
    since: float = -np.inf
    own: bool = False
    judged: float = -np.inf
    changed: float = -np.inf
    unusual: str = ""

    @classmethod
    def start(cls, universal: UniversalRetargeter, time: float = -np.inf) -> "PersonFollowing":
        """Starts without observations; `time` is when another person was noticed, s."""
        return cls(universal, PersonObserver.empty(universal.finger_names), changed=time)

    def seeing(self, p_HK: np.ndarray, time: float) -> "PersonFollowing":
        """Returns the state after observing keypoints p_HK (21, 3), m, at `time`, s."""
        universal, observer = self.universal, self.observer.seeing(p_HK)
        if time - self.judged < FADE_TIME - _ROUNDING or len(observer.shapes) == 0:
            return dc.replace(self, observer=observer, last=p_HK)
        if observer.has_changed():
            return PersonFollowing.start(universal, time)
        if self.own:
            return dc.replace(self, observer=observer, last=p_HK, judged=time)
        code = universal.average.code(observer.observation())
        if self.code is not None:
            change = universal.deviations(code) - universal.deviations(self.code)
            if np.abs(change).max() < _MIN_CODE_CHANGE:
                return dc.replace(self, observer=observer, last=p_HK, judged=time)
        return dc.replace(
            self,
            observer=observer,
            last=p_HK,
            code=code,
            now=universal.folded(code),
            before=self.now,
            since=time,
            judged=time,
            unusual=universal.unusual(code),
        )

    @property
    def state(self) -> str:
        """State of `RetargetingSystem` while it tracks the hand."""
        if len(self.observer.shapes) < LEARNED_AFTER:
            return LEARNING
        return UNUSUAL if self.unusual else TRACKING

    def taking(self, retargeter: Retargeter, time: float) -> "PersonFollowing":
        """Returns a copy that fades to a map fitted to the person, from `time` on, s."""
        faded = time - self.since >= FADE_TIME
        before = self.now if faded else partial(self.retarget, time=time)
        return dc.replace(self, now=retargeter, before=before, since=time, own=True)

    def holds(self, time: float) -> bool:
        """Whether another person's hand is not followed yet at `time`, s."""
        return time - self.changed < HOLD_TIME - _ROUNDING

    def retarget(self, p_HK: np.ndarray, time: float) -> np.ndarray:
        """Returns joint angles (n,), rad, for p_HK (21, 3), m, at `time`, s; NaN if there is no map yet."""
        if self.now is None:
            first = self.seeing(p_HK, time)
            missing = np.full(len(self.universal.joint_names), np.nan)
            return missing if first.now is None else first.now(p_HK)
        q = self.now(p_HK)
        share = (time - self.since) / FADE_TIME
        if self.before is None or share >= 1.0:
            return q
        return share * q + (1.0 - share) * self.before(p_HK)

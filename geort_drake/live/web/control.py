"""Carries out the page's commands in a session, and publishes the session's state to the page."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace
from pydrake.systems.framework import Context

from geort_drake.console import warn
from geort_drake.errors import GeortError
from geort_drake.live.session import SteadyState
from geort_drake.live.teleoperation import Teleoperation
from geort_drake.live.web.messages import Disengage, Engage, Fist, Record, Reset, Stop
from geort_drake.live.web.operator_station import OperatorStation
from geort_drake.people.recording_log import RecordingLog
from geort_drake.simulation.task import Outcome, Stage
from geort_drake.simulation.tasks.grasp import explain
from geort_drake.systems.glove import GloveRecorder

_STATE_S = 0.1  # s between two states
# s between two frames on average; the page draws as many, which leaves time for its hand tracker.
_FRAME_S = 0.032
WAITING = "begins when you engage"
# Phase of a task in which disengaging by a fist drops nothing.
UNTOUCHED = "reach"
# The computer is too slow if less than this share of real time was simulated over the last seconds.
_SLOW, _PACE_S = 0.85, 3.0
_NEWEST = 300  # number of newest samples in the displayed delay


class WatchedTrial:
    """A trial of `geort-drake grasp`, which the page shows where nobody has a camera.

    It is read in the same way as a `Teleoperation`.

    Args:
        stage: stage of the trial.
        timeout: longest duration, s.
    """

    simulated_person = True
    late = 0

    def __init__(self, stage: Stage, timeout: float):
        self._stage, self._timeout = stage, timeout

    def outcome(self, root: Context) -> Outcome:
        """Returns the task's outcome so far; a trial that takes too long is over."""
        outcome = self._stage.outcome(root)
        return outcome.replace(over=outcome.over or root.get_time() >= self._timeout)

    def restart(self, root: Context) -> None:
        """Does nothing, as a trial begins when its diagram does."""

    def phase(self, root: Context) -> str:
        """Returns the name of the task's present state."""
        return self._stage.phase(root)

    def following(self, root: Context) -> bool:
        """Whether the robot follows the person."""
        return True

    def state(self, root: Context) -> str:
        """Returns what is shown as the state of the fingers."""
        return "a simulated person works"

    def delay(self, newest: int) -> dict[str, Any]:
        """Returns no figures, as nothing arrives from outside."""
        return {"count": 0, "median": None, "p99": None}


class PageControl:
    """Engages the person as the page asks; for all sessions of a page.

    Attributes:
        loop, recorder: what the present session runs, and its recorder; a watched trial has none.
        choice: robot hand, mount, task and object of the next session; None for the first or usual one.
        note: text shown instead of the state until the next command.
        again: whether the page asked for a new session.
        recordings: files that were written.

    Args:
        station: source of commands.
        publish: sends a state to all pages.
        folder: folder of recordings.
    """

    def __init__(
        self,
        station: OperatorStation,
        publish: Callable[[str], None],
        folder: Path,
    ):
        self._station, self._publish, self._folder = station, publish, folder
        self.loop: Teleoperation | WatchedTrial
        self.recorder: GloveRecorder | None
        self.choice = Reset()
        self.note = ""
        self.again = False
        self.recordings: list[Path] = []
        self._scene, self._steady = 0, SteadyState()
        self._facts: dict[str, Any] = {}
        self._root: Context
        self._published = -math.inf
        self._consent = False
        self._log: RecordingLog | None = None
        self._finishing: list[threading.Thread] = []

    def begin(
        self,
        loop: Teleoperation | WatchedTrial,
        recorder: GloveRecorder | None,
        scene: int,
        facts: dict[str, Any],
        show: Callable[[Context], None] = lambda root: None,
    ) -> None:
        """Begins a session.

        Args:
            loop, recorder: what the session runs, and its recorder, if it has one.
            scene: number of the scene.
            facts: facts for recordings: robot, task, object, seed.
            show: called every `_FRAME_S`; shows the poses of hands and robot.
        """
        self._show, self._next_frame = show, 0.0
        self.loop, self.recorder, self._scene, self._facts = loop, recorder, scene, facts
        self.choice = replace(self.choice, task=facts.get("task"), object=facts.get("object"))
        self._started = 0.0 if loop.simulated_person else math.nan
        self._pace: deque[tuple[float, float]] = deque()
        self.again, self._steady = False, SteadyState()
        if recorder is not None:
            recorder.switch(None)

    def end(self) -> None:
        """Ends the session's recording, if there is one."""
        if self._log is None or self.recorder is None:
            return
        log, self._log = self._log, None
        self.recorder.switch(None)
        outcome, delay = self._outcome(self._root), self.loop.delay(_NEWEST)

        # In a thread, because joining takes longer than a step of the loop.
        def finish() -> None:
            try:
                if log.finish(outcome=outcome, delay=delay):
                    self.recordings.append(log.path)
            except GeortError as error:
                self.note = str(error)
                warn(f"{log.path}: {error}")

        self._finishing.append(threading.Thread(target=finish, name="finishing", daemon=True))
        self._finishing[-1].start()

    def close(self) -> None:
        """Waits until all recordings are written."""
        for thread in self._finishing:
            thread.join()

    def step(self, root: Context, engaged: bool) -> bool:
        """Carries out new commands and shows the robot; returns whether to engage the person."""
        self._root = root
        if root.get_time() >= self._next_frame:
            self._next_frame += _FRAME_S
            self._show(root)
        while self._station.commands:
            command = self._station.commands.popleft()
            self.note = ""
            if isinstance(command, Engage | Disengage):
                engaged = isinstance(command, Engage) and not self.loop.simulated_person
            elif isinstance(command, Fist):
                engaged ^= self._fist_counts(engaged)
            elif isinstance(command, Reset):
                self.choice, self.again = _merge(self.choice, command), True
            elif isinstance(command, Record):
                self._consent = True
            elif isinstance(command, Stop):
                self._consent = False
                self.end()
        if self._station.simulated_person != self.loop.simulated_person and not self.note:
            self.again = True
        if self._log is not None and self._log.error is not None:
            self._consent = False
            self.end()
        if math.isnan(self._started):
            self.loop.restart(root)
            self._started = root.get_time() if engaged else math.nan
        # Recording begins at the engagement, because a replay follows from its start.
        if engaged and self._consent and self._log is None and self.recorder is not None:
            self._record(self.recorder)
        now = time.monotonic()
        if now - self._published >= _STATE_S:
            self._published = now
            self._publish(msgspec.json.encode(self._state(root, engaged)).decode())
        return engaged

    def _fist_counts(self, engaged: bool) -> bool:
        """Whether a held fist is a command: only in a simulation, and not while something is held."""
        if self._station.about.robot != "simulation":
            return False
        outcome = self.loop.outcome(self._root)
        return not engaged or outcome is None or outcome.over or self.loop.phase(self._root) == UNTOUCHED

    def _record(self, recorder: GloveRecorder) -> None:
        what = [str(self._facts[name]) for name in ("object", "seed") if name in self._facts]
        name = "-".join([time.strftime("%Y-%m-%dT%H-%M-%S"), *what])
        operator = self._station.operator
        facts = {
            "side": self._station.about.side,
            "source": "live web page",
            "consent": True,
            "device": operator and operator.device,
            "map": self._station.about.map,
            "began": self._clock(self._root),
            **self._facts,
        }
        if recorder.robot_signals:
            facts["robot_signals"] = recorder.robot_signals
        try:
            self._log = RecordingLog(self._folder / f"{name}.npz", facts)
        except GeortError as error:
            self.note, self._consent = str(error), False
            return
        recorder.switch(self._log)

    def _state(self, root: Context, engaged: bool) -> dict[str, Any]:
        station, outcome = self._station, self._outcome(root)
        over = outcome is not None and outcome["over"]
        return {
            "type": "state",
            "scene": self._scene,
            "task": self._facts.get("task"),
            "object": self._facts.get("object"),
            "mount": self._facts.get("mount"),
            "time": self._clock(root),
            "engaged": engaged,
            "simulated_person": self.loop.simulated_person,
            "following": self.loop.following(root),
            "slow": self._is_slow(root) and not over,
            "status": self.note or self._steady.step(root.get_time(), self.loop.state(root)),
            "fist": station.fist if self._fist_counts(engaged) else 0.0,
            "outcome": outcome,
            "delay": self.loop.delay(_NEWEST),
            "received": station.received,
            "refused": station.refused,
            "late": self.loop.late,
            "operator": station.operator is not None,
            "spectators": station.spectators,
            "recording": self._log.path.name if self._log else WAITING if self._consent else None,
        }

    def _clock(self, root: Context) -> float:
        """Returns the time since the session's first engagement, s; 0 before it."""
        return 0.0 if math.isnan(self._started) else root.get_time() - self._started

    def _is_slow(self, root: Context) -> bool:
        """Whether the simulation took longer than real time over the last seconds."""
        now, simulated = time.monotonic(), root.get_time()
        self._pace.append((now, simulated))
        while now - self._pace[0][0] > _PACE_S:
            self._pace.popleft()
        (began, start), full = self._pace[0], len(self._pace) >= _PACE_S / _STATE_S / 4
        return full and simulated - start < _SLOW * (now - began)

    def _outcome(self, root: Context) -> dict[str, Any] | None:
        outcome = self.loop.outcome(root)
        if outcome is None:
            return None
        return {
            "phase": self.loop.phase(root),
            "score": outcome.score,
            "seconds": outcome.completion_time - self._started if outcome.success else None,
            "over": outcome.over,
            "success": outcome.success,
            "reason": explain(outcome.text) if outcome.over and not outcome.success else None,
        }


def _merge(choice: Reset, wish: Reset) -> Reset:
    """Returns a choice with a page's wishes; another hand, mount or task begins with its usual object."""
    robot = replace(choice, hand=wish.hand or choice.hand, mount=wish.mount or choice.mount)
    task = wish.task or choice.task
    same = (robot.hand, robot.mount, task) == (choice.hand, choice.mount, choice.task)
    return replace(robot, task=task, object=wish.object or (choice.object if same else None))

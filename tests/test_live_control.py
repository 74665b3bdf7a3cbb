"""What the live page asks of a session: engagement, recordings, and the person's own map."""

import errno
import io
import json
import os
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from grasp_setup import plan_once
from live_messages import PLAY, headset, known, station
from loop_bench import LoopBench

from geort_drake import Recording, load_retargeter
from geort_drake.cli import main
from geort_drake.errors import LiveError
from geort_drake.files import writing
from geort_drake.live.glove_stream import HANDSHAKE_FRAMES
from geort_drake.live.web import control as page_control
from geort_drake.live.web import personal_map
from geort_drake.live.web.control import PageControl
from geort_drake.live.web.exports import SessionExports
from geort_drake.live.web.guide import DURATION_S, GuidedPlay
from geort_drake.live.web.messages import Disengage, Engage, Fist, Guide, Record, Refit, Reset, Stop
from geort_drake.live.web.personal_map import DONE, PersonalMap
from geort_drake.rerun.reader import read_samples
from geort_drake.simulation.tasks import find_task, task_names
from geort_drake.simulation.tasks.grasp.monitor import GraspOutcome, GraspPhase

UNIVERSAL = load_retargeter("allegro_right")
OWN, OTHERS = (UNIVERSAL.for_person(scale * PLAY.p_HK) for scale in (1.1, 0.9))
SEED = 5


class Page:
    """Sessions under a page's control, in steps of the retargeting."""

    def __init__(self, folder, retarget=UNIVERSAL, maps=(), **scenario):
        self.retarget, maps, self.scenario = retarget, iter(maps), scenario
        self.station = known(station())
        self.states, self.exported = [], []
        self.control = PageControl(
            self.station, self.states.append, folder,
            PersonalMap(folder / "a_map", lambda path: next(maps)),
            lambda *session: self.exported.append(session),
        )  # fmt: skip
        self.sessions = self.hands = 0
        self.begin()

    def begin(self):
        """Begins a session, as after a reset."""
        self.sessions += 1
        self.bench = LoopBench(self.station, self.retarget, SEED, **self.scenario)
        facts = {"hand": "allegro_right"}
        if not self.scenario.get("real"):
            facts |= {"object": self.bench.scenario.object.name, "seed": SEED + self.sessions - 1}
        self.control.begin(self.bench.loop, self.bench.recorder, self.sessions, facts)

    def run(self, *commands, steps=1, hand=None):
        """Runs steps of 20 ms with a hand each, the same one if given.

        Returns:
            The joint targets after each, rad, in the order of the maps.
        """
        self.station.commands.extend(commands)
        bench, targets = self.bench, []
        for _ in range(steps):
            self.hands += 1
            number = (HANDSHAKE_FRAMES + self.hands) % len(PLAY.t) if hand is None else hand
            self.station.take(1, headset(number, 100.0 + 0.02 * self.hands))
            bench.engage(self.control.step(bench.context, bench.engaged))
            targets.append(bench.step(0.02)[0])
        return np.array(targets)[:, [bench.model.hand.joints.index(name) for name in OWN.joint_names]]

    def reset(self):
        self.run(Reset())
        assert self.control.again
        self.control.end()
        self.begin()


def test_a_held_fist_engages_and_disengages_unless_it_is_asked_for_or_grasps(tmp_path, monkeypatch):
    page = Page(tmp_path)
    page.run(Guide(), Fist())
    assert not page.bench.engaged
    monkeypatch.setattr(page.control, "_guide", None)
    page.run(Fist())
    assert page.bench.engaged
    for phase, engaged in ((GraspPhase.GRASP, True), (GraspPhase.HOLD, True), (GraspPhase.REACH, False)):
        outcome = GraspOutcome(phase=phase)
        monkeypatch.setattr(page_control.Teleoperation, "outcome", lambda *_, outcome=outcome: outcome)
        monkeypatch.setattr(page_control.Teleoperation, "phase", lambda *_, phase=phase: phase.name.lower())
        page.run(Fist())
        assert page.bench.engaged == engaged, phase


def test_a_task_begins_when_the_person_engages(tmp_path, monkeypatch):
    """The first cue comes after the time to get ready."""
    plan_once(monkeypatch, "keys")
    page = Page(tmp_path, task="keys", text="{task_settings: {ready_time: 0.5}}")
    loop, context = page.bench.loop, page.bench.context
    page.run(steps=45)
    assert loop.phase(context) == "none"
    page.run(Engage(), steps=23)
    assert loop.phase(context) == "none"
    page.run(steps=4)
    assert loop.phase(context) != "none"


@pytest.mark.parametrize("task", task_names())
def test_the_page_shows_how_far_each_task_is(tmp_path, task, monkeypatch):
    if hasattr(find_task(task), "planner"):
        plan_once(monkeypatch, task)
    page = Page(tmp_path, task=task)
    page.run()
    outcome = json.loads(page.states[-1])["outcome"]
    assert outcome["phase"] and outcome["score"] == 0.0 and not outcome["over"]


def test_a_real_robots_session_is_exported_with_its_joints(tmp_path, monkeypatch):
    """Commands and measured joints are in the recording, the Rerun file and the dataset, by name."""
    page = Page(tmp_path, real=True)
    page.run(Record(keep=True), steps=20)
    targets = page.run(Engage(), steps=60)
    page.control.end()
    page.control.close()
    (path,) = tmp_path.glob("*.npz")
    monkeypatch.setattr(SessionExports, "_run", lambda _, *words: main([*map(str, words)]))
    SessionExports().write(path, tmp_path, simulated=False)
    folder = path.with_suffix("")
    names = json.loads((folder / "lerobot/meta/info.json").read_text())["features"]["action"]["names"]
    table = pq.read_table(folder / "lerobot/data/chunk-000/file-000.parquet")
    action, state = (np.array(table[name].to_pylist()) for name in ("action", "observation.state"))
    columns = [[name.rpartition(".")[2] for name in names].index(joint) for joint in OWN.joint_names]
    assert action.shape == state.shape == (len(table), 23)
    assert np.ptp(targets, axis=0).max() > 0.1
    assert np.abs(action[-1, columns] - targets[-1]).max() < 0.05
    # The robot follows its commands with a lag.
    assert 0.0 < np.abs(action - state).max() < 0.5
    drawn = read_samples(folder / "hand.rrd").signals
    assert set(names) < {name.removeprefix("robot.") for name in drawn}


def test_exports_end_when_they_are_closed(tmp_path, monkeypatch):
    """As when a second Ctrl-C ends the command: no process goes on, and none begins."""
    slow = tmp_path / "slow"
    slow.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/number\nexec sleep 600\n")
    slow.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(slow))
    exports, errors = SessionExports(), []

    def write() -> None:
        try:
            exports.write(tmp_path / "session.npz", tmp_path, simulated=True)
        except LiveError as error:
            errors.append(str(error))

    threads = [threading.Thread(target=write) for _ in range(2)]
    for thread in threads:
        thread.start()
    deadline = time.monotonic() + 120.0
    while not (tmp_path / "number").exists() or not (tmp_path / "number").read_text().strip():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    exports.close()
    for thread in threads:
        thread.join(120.0)
    assert sorted(errors) == ["grasp: closed before it started", "grasp: ended before it was done"]
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "number").read_text()), 0)


def test_with_consent_every_session_is_recorded_from_its_engagement_and_can_be_replayed(tmp_path):
    """Without a checkpoint: by the shipped map for the person in the session, with the object as it was."""
    page = Page(tmp_path)
    page.run(Record(keep=True), steps=20)
    page.run(Engage(), steps=30)
    page.run(Disengage(), steps=10)
    page.reset()
    page.run(Engage(), steps=30)
    page.run(Stop())
    page.reset()
    page.run(Engage(), steps=10)
    page.control.end()
    page.control.close()
    assert [(driver, simulated) for _, driver, simulated in page.exported] == 2 * [(tmp_path / "a_map", True)]
    first, second = (Recording.load(path) for path in sorted(tmp_path.glob("*.npz")))
    assert first.t[-1] == pytest.approx(0.8, abs=0.03)
    assert first.valid[5:55].all() and not first.valid[65:].any()
    assert second.valid.sum() > 50
    assert first.metadata["began"] == pytest.approx(0.0, abs=0.03)
    assert first.metadata["consent"] and first.metadata["outcome"]["phase"] == "reach"


@pytest.mark.filterwarnings("ignore:the recording ends here")
def test_a_full_disk_ends_the_recording_in_words_and_keeps_its_parts(tmp_path, monkeypatch):
    page, save, full = Page(tmp_path), Recording.save, False

    def save_unless_full(recording, path):
        with writing(path):
            if full:
                raise OSError(errno.ENOSPC, "No space left on device")
            save(recording, path)

    monkeypatch.setattr(Recording, "save", save_unless_full)
    page.bench.recorder._part_samples = 10
    page.run(Record(keep=True), Engage())
    (parts,) = tmp_path.glob("*.parts")
    while not (written := list(parts.glob("[0-9]*.npz"))):  # without drafts
        page.run(steps=10)
    full = True
    while "No space left" not in page.control.note:
        page.run(steps=10)
    page.control.end()
    page.control.close()
    assert written[0].is_file()
    page.control._published = 0.0
    page.run()
    assert json.loads(page.states[-1])["recording"] is None
    assert not page.exported


def test_a_map_made_mine_again_takes_over_without_a_new_session_or_a_jump(tmp_path, monkeypatch):
    """Also after a reset, which keeps the person's map; without consent nothing of it is kept."""
    # A fit of the map that is done at once.
    fit = {"state": lambda: DONE, "close": lambda: None}
    monkeypatch.setattr(
        personal_map, "Refitting", lambda _, output, *__: SimpleNamespace(output=output, **fit)
    )
    page = Page(tmp_path, maps=(OWN, OTHERS))
    page.run(Engage(), steps=100)
    guide = GuidedPlay(0.0, "right")
    for i in range(round(50 * DURATION_S) + 50):
        guide.see(i / 50, PLAY.p_HK[i % len(PLAY.p_HK)])
    monkeypatch.setattr(page.control, "_guide", guide)

    still = 60
    page.run(steps=120, hand=still)
    q = page.run(Refit(), steps=60, hand=still)
    np.testing.assert_allclose(q[-1], OWN(PLAY.p_HK[still]), atol=1e-3)
    assert not page.control.again
    page.reset()
    page.run(Engage(), steps=150, hand=still)
    q = page.run(steps=2, hand=still)
    np.testing.assert_allclose(q[-1], OWN(PLAY.p_HK[still]), atol=1e-3)
    q = np.concatenate([q, page.run(Refit(), steps=60, hand=still)])
    assert not page.control.again
    np.testing.assert_allclose(q[-1], OTHERS(PLAY.p_HK[still]), atol=1e-3)
    # Evenly within half a second, in steps of 20 ms.
    assert np.abs(np.diff(q, axis=0)).max() < 0.08 * np.abs(q[-1] - q[0]).max()
    page.control.close()
    assert not [*tmp_path.iterdir()]


def test_a_map_of_one_person_is_not_made_mine(tmp_path):
    """The page is told why."""
    (tmp_path / "a_map").mkdir()
    page = Page(tmp_path, OWN)
    page.run(Refit(), steps=10)
    assert "universal map" in json.loads(page.states[-1])["refit"]["text"]


@pytest.mark.parametrize("answer", ["", "\n", "no\n", "yess\n"])
def test_a_page_moves_a_real_robot_only_after_a_yes_in_the_terminal(answer, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    assert main(["live", "--robot", "lcm", "--no-open"]) == 2
    assert "needs the answer yes" in capsys.readouterr().err

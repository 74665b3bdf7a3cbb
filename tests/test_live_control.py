"""What the live page asks of a session: engagement and recordings."""

import errno
import io
import json

import numpy as np
import pytest
from grasp_setup import plan_once
from live_messages import PLAY, headset, known, station
from loop_bench import LoopBench

from geort_drake import Recording, load_retargeter
from geort_drake.cli import main
from geort_drake.live.glove_stream import HANDSHAKE_FRAMES
from geort_drake.live.web import control as page_control
from geort_drake.live.web.control import PageControl
from geort_drake.live.web.messages import Disengage, Engage, Fist, Record, Reset, Stop
from geort_drake.people.recording_log import RecordingLog, recover
from geort_drake.simulation.task import Outcome
from geort_drake.simulation.tasks import task_names
from geort_drake.simulation.tasks.grasp import GraspPhase

UNIVERSAL = load_retargeter("allegro_right")
SEED = 5


class Page:
    """Sessions under a page's control, in steps of the retargeting."""

    def __init__(self, folder, retarget=UNIVERSAL, **scenario):
        self.retarget, self.scenario = retarget, scenario
        self.station = known(station())
        self.states = []
        self.control = PageControl(self.station, self.states.append, folder)
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
        order = [bench.model.hand.joints.index(name) for name in self.retarget.joint_names]
        return np.array(targets)[:, order]

    def reset(self):
        self.run(Reset())
        assert self.control.again
        self.control.end()
        self.begin()


def test_a_held_fist_engages_and_disengages_unless_it_grasps(tmp_path, monkeypatch):
    page = Page(tmp_path)
    page.run(Fist())
    assert page.bench.engaged
    for phase, engaged in ((GraspPhase.GRASP, True), (GraspPhase.HOLD, True), (GraspPhase.REACH, False)):
        outcome = Outcome(phase=int(phase))
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


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "thrown: touch",
            "the object fell or was pushed away; just before, only one finger touched the object",
        ),
        ("timeout: reach", "time ran out; at the end, no finger touched the object"),
        ("lost: carried", "the object fell or was pushed away; the last step was: carried"),
        ("2 not pressed, 0 with others", "2 not pressed, 0 with others"),
        ("success", None),
    ],
)
def test_the_page_says_in_words_why_a_trial_failed(tmp_path, monkeypatch, text, reason):
    page = Page(tmp_path)
    outcome = Outcome(success=text == "success", over=True, text=text, completion_time=1.0)
    monkeypatch.setattr(page_control.Teleoperation, "outcome", lambda *_: outcome)
    page.run()
    assert json.loads(page.states[-1])["outcome"]["reason"] == reason


@pytest.mark.parametrize("task", task_names())
def test_the_page_shows_how_far_each_task_is(tmp_path, task, monkeypatch):
    if task in ("keys", "cap"):
        plan_once(monkeypatch, task)
    page = Page(tmp_path, task=task)
    page.run()
    outcome = json.loads(page.states[-1])["outcome"]
    assert outcome["phase"] and outcome["score"] == 0.0 and not outcome["over"]


def test_a_real_robots_session_is_recorded_with_its_joints(tmp_path):
    """Commands and measured joints are in the recording, by name."""
    page = Page(tmp_path, real=True)
    page.run(Record(keep=True), steps=20)
    targets = page.run(Engage(), steps=60)
    page.control.end()
    page.control.close()
    recording = Recording.load(*tmp_path.glob("*.npz"))
    names = recording.metadata["robot_signals"]
    last = [name.rpartition(".")[2] for name in names if name.startswith("joints.command")]
    command, measured = (
        recording.robot[:, [names.index(name) for name in names if name.startswith(f"joints.{kind}")]]
        for kind in ("command", "measured")
    )
    columns = [last.index(joint) for joint in page.retarget.joint_names]
    assert np.ptp(targets, axis=0).max() > 0.1
    assert np.abs(command[-1, columns] - targets[-1]).max() < 0.05
    # The robot follows its commands with a lag.
    assert 0.0 < np.abs(command - measured).max() < 0.5


def test_with_consent_every_session_is_recorded_from_its_engagement_and_can_be_replayed(tmp_path):
    """Without a map's file: by the shipped map for the person in the session, with the object as it was."""
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
    first, second = (Recording.load(path) for path in sorted(tmp_path.glob("*.npz")))
    assert first.t[-1] == pytest.approx(0.8, abs=0.03)
    assert first.valid[5:55].all() and not first.valid[65:].any()
    assert second.valid.sum() > 50
    assert first.metadata["began"] == pytest.approx(0.0, abs=0.03)
    assert first.metadata["consent"] and first.metadata["outcome"]["phase"] == "reach"


@pytest.mark.filterwarnings("ignore:the recording ends here")
def test_a_full_disk_ends_the_recording_in_words_and_keeps_its_log(tmp_path, monkeypatch):
    page, append, full = Page(tmp_path), RecordingLog.append, False

    class FullDisk:
        """A file whose disk has no space left."""

        def write(self, _data: bytes) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self) -> None:
            pass

    def append_unless_full(log, row):
        if full:
            log._file = FullDisk()
        append(log, row)

    monkeypatch.setattr(RecordingLog, "append", append_unless_full)
    page.run(Record(keep=True), Engage())
    (log,) = tmp_path.glob("*.log")
    page.run(steps=10)
    full = True
    while "No space left" not in page.control.note:
        page.run(steps=10)
    page.control.end()
    page.control.close()
    with pytest.warns(UserWarning, match="interrupted"):
        recover(tmp_path)
    assert len(Recording.load(log.with_suffix(""))) > 5
    page.control._published = 0.0
    page.run()
    assert json.loads(page.states[-1])["recording"] is None


@pytest.mark.parametrize("answer", ["", "\n", "no\n", "yess\n"])
def test_a_page_moves_a_real_robot_only_after_a_yes_in_the_terminal(answer, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("geort_drake.cli.live_session.find_page", lambda: tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    assert main(["live", "--robot", "lcm", "--no-open"]) == 2
    assert "only if you answer yes" in capsys.readouterr().err


def test_a_page_warns_of_a_robot_that_the_network_reaches(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("geort_drake.cli.live_session.find_page", lambda: tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO("no\n"))
    address = "lcm+udpm://239.255.76.67:7667?ttl=1"
    assert main(["live", "--robot", address, "--no-open"]) == 2
    assert f"{address} is open to the network" in " ".join(capsys.readouterr().err.split())

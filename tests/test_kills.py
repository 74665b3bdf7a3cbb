"""Programs that are killed: what they leave is complete, and they resume as if they had not been killed."""

import itertools
import multiprocessing
import os
import pkgutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from faults.sound import play
from grasp_setup import TOO_SHORT, judged, reach_goal
from light_training import train_lightly
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shared import synthesized

from geort_drake import GloveReplay, Recording, load_retargeter
from geort_drake.benchmark.log import read_rows
from geort_drake.cli import run_command
from geort_drake.people.recording_log import RecordingLog, recover
from geort_drake.systems.glove import GloveRecorder

NEW = multiprocessing.get_context("spawn")  # processes that inherit no threads, random numbers or caches


def train(folder: Path) -> None:
    train_lightly("allegro_right", synthesized(0, 20.0, 30.0), folder / "map.safetensors", "geort")


def train_universal(folder: Path) -> None:
    values = "people=2", "play_s=8", "steps=12", "robot_samples=4000", "people_per_batch=2"
    settings = [word for value in values for word in ("--set", value)]
    with mock.patch("geort_drake.retargeting.universal.train.SAVE_EVERY_S", 0.0):
        output = str(folder / "map.safetensors")
        run_command("train", ["--universal", "--hand", "allegro_right", *settings, "--output", output])


def benchmark(folder: Path) -> None:
    options = "--methods hold --objects cylinder --trials 2 --jobs 1 --scenario-text".split()
    with (
        mock.patch("geort_drake.benchmark.run.plan", lambda *_: [reach_goal()]),
        mock.patch("geort_drake.benchmark.run.training_recording", lambda *_: play()),
    ):
        run_command("benchmark", [*options, TOO_SHORT, "--output", str(folder)])


def die(work: Callable[[Path], None], folder: Path, function: str, times: int) -> None:
    """Runs a program that is killed when it calls a function for the n-th time."""
    original, calls = pkgutil.resolve_name(function), itertools.count(1)

    def call(*arguments: object) -> object:
        if next(calls) == times:
            os.kill(os.getpid(), signal.SIGKILL)
        return original(*arguments)

    with mock.patch(function, call):
        work(folder)


def killed(function: Callable, *arguments: object) -> bool:
    process = NEW.Process(target=function, args=arguments)
    process.start()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.mark.parametrize(
    ("work", "times", "left"),
    [(train, 1, ".map-*"), pytest.param(train_universal, 4, "map.state", marks=pytest.mark.slow)],
)
def test_a_killed_training_gives_the_same_map_when_it_is_run_again(work, times, left, tmp_path):
    """It leaves no map; that of the next run, which may resume, is the same bit for bit."""
    for name in ("whole", "broken"):
        (tmp_path / name).mkdir()
    work(tmp_path / "whole")
    assert killed(die, work, tmp_path / "broken", "os.replace", times)  # a file is written, not yet in place
    assert list((tmp_path / "broken").glob(left))
    assert not (tmp_path / "broken" / "map.safetensors").exists()
    work(tmp_path / "broken")
    whole, broken = (load_retargeter(tmp_path / name / "map.safetensors") for name in ("whole", "broken"))
    for name, array in whole.arrays.items():
        np.testing.assert_array_equal(broken.arrays[name], array)


APPEND = "geort_drake.benchmark.log.TrialLog.append"


def test_a_killed_benchmark_repeats_no_trial_and_changes_none(tmp_path):
    benchmark(tmp_path / "whole")
    assert killed(die, benchmark, tmp_path / "broken", APPEND, 2)  # one trial is written
    rows = tmp_path / "broken" / "trials.jsonl"
    first = rows.read_bytes()
    assert first.count(b"\n") == 1
    benchmark(tmp_path / "broken")
    assert rows.read_bytes().startswith(first) and rows.read_bytes().count(b"\n") == 2
    whole = read_rows(tmp_path / "whole" / "trials.jsonl")
    assert [judged(row) for row in read_rows(rows)] == [judged(row) for row in whole]


def teleoperate(path: Path, newest: object) -> None:
    """Records the replay of `play` in real time, and tells the time of the newest frame."""
    builder = DiagramBuilder()
    replay = builder.AddSystem(GloveReplay(play()))
    recorder = builder.AddSystem(GloveRecorder(0.01))
    recorder.switch(RecordingLog(path, {"side": "right"}))
    for name in ("keypoints", "wrist_pose", "valid"):
        builder.Connect(replay.GetOutputPort(name), recorder.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.set_target_realtime_rate(1.0)
    while True:
        simulator.AdvanceTo(newest.value + 0.01)
        newest.value += 0.01


def test_a_killed_live_session_loses_only_its_newest_frames(tmp_path):
    """Its frames become a recording at the next start."""
    path, newest = tmp_path / "session.npz", NEW.Value("d", 0.0)
    session = NEW.Process(target=teleoperate, args=(path, newest))
    session.start()
    while newest.value < 2.9:
        assert session.is_alive()
        time.sleep(0.01)
    session.kill()
    session.join()
    with pytest.warns(UserWarning, match=r"session\.npz, the recording of a session that was interrupted"):
        recover(tmp_path)
    recording = Recording.load(path)
    assert newest.value - recording.t[-1] < 0.05
    np.testing.assert_array_equal(recording.p_HK, play().p_HK[: len(recording)])

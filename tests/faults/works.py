"""Programs that write results, and digests of the results they leave."""

import dataclasses as dc
import functools
import hashlib
import json
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from grasp_setup import allegro
from joblib.externals.loky import get_reusable_executor
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from faults.sound import play, smooth_retargeter
from geort_drake.cli import run_command
from geort_drake.people.recording import Recording
from geort_drake.people.recording_parts import RecordingParts, read_parts
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.systems.glove_recorder import GloveRecorder
from geort_drake.systems.glove_replay import GloveReplay

SETTINGS = {
    "steps": 5, "points": 16, "targets": 32, "pinches": 8, "frames": 8, "hidden": 8,
    "classifier_steps": 5, "refreshes": 0,
}  # fmt: skip
ROW_ID = "rerun.controls.RowId"
SHORT = "{timeout: 0.3}"  # too short to grasp anything, long enough for every part of a trial


@dc.dataclass(frozen=True)
class Work:
    """A program that writes results into its working directory.

    Attributes:
        name: of the program.
        main: runs it with a seed; the same seed gives the same results.
        results: returns name → digest of every result in a folder, in the order in which they were made;
            raises for an incomplete one.
        replaces: whether another seed's results replace the earlier ones, one by one.
    """

    name: str
    main: Callable[[int], object]
    results: Callable[[Path], dict[str, str]]
    replaces: bool = True


def generate(seed: int) -> None:
    """A synthetic recording."""
    run_command("synthesize", ["play.npz", "--duration", "20", "--seed", str(seed)])


def generated(folder: Path) -> dict[str, str]:
    return {path.name: Recording.load(path).digest for path in _visible(folder, "play.npz")}


def train(seed: int) -> None:
    """A checkpoint."""
    from geort_drake.comparison import metrics
    from geort_drake.comparison.train import train_checkpoint
    from geort_drake.people.play import synthesize_play

    recording = synthesize_play(0, duration_s=20.0, rate_hz=30.0)
    with mock.patch.object(metrics, "ROBOT_SAMPLES", 300):
        train_checkpoint("allegro_right", recording, "trained", "geort", seed, show_progress=False,
                         settings=SETTINGS, robot_samples=1000)  # fmt: skip


def trained(folder: Path) -> dict[str, str]:
    from geort_drake.retargeting.checkpoint import load_checkpoint

    found = {}
    for path in _visible(folder, "trained"):
        arrays = load_checkpoint(path).arrays
        json.loads((path / "metrics.json").read_text())
        found[path.name] = _digest(b"".join(arrays[name].tobytes() for name in sorted(arrays)))
    return found


def benchmark(seed: int, jobs: int = 1) -> None:
    """A benchmark of two methods; it has fewer trials with seed 1 than with seed 0, which resumes it."""
    from geort_drake.benchmark import folder, trials

    goal = _goal()
    argv = [
        "--output", ".", "--methods", "hold", "nearest_neighbour", "--objects", "cylinder",
        "--jobs", str(jobs),
        "--scenario_text", SHORT, "--trials", "1" if seed == 1 else "2", "--zero_latency",
    ]  # fmt: skip
    with (
        mock.patch.object(trials, "plan", lambda *_: [goal]),
        mock.patch.object(folder, "synthesize_play", lambda seed, side: play()),
    ):
        run_command("benchmark", argv)
    if jobs > 1:
        # A script's interpreter does this at its end; a forked process does not.
        get_reusable_executor().shutdown()


def benchmarked(folder: Path) -> dict[str, str]:
    from geort_drake.benchmark.config import CONFIG, TRIALS, read_config
    from geort_drake.benchmark.records import key_of, read_records

    if (folder / CONFIG).exists():
        read_config(folder)
    if not (folder / TRIALS).exists():
        return {}
    return {
        str(key_of(record)): json.dumps(
            {name: value for name, value in record.items() if name != "wall_time"}
        )
        for record in read_records(folder / TRIALS)
    }


def record(seed: int) -> None:
    """A trial with its recordings, as `geort-drake grasp` writes them."""
    from geort_drake.people.human_hand import HumanHand
    from geort_drake.simulation.scenario import load_scenario
    from geort_drake.simulation.trial import run_trial

    person = HumanHand.fit(play())
    retarget = smooth_retargeter()
    retarget.joint_names = tuple(allegro().joint_names)
    scenario = load_scenario(text=SHORT)
    scenario.random_seed = seed
    _, glove = run_trial(scenario, retarget, (person, _goal()), "trial.rrd")
    glove.save("trial.glove.npz")


def recorded(folder: Path) -> dict[str, str]:
    from rerun.chunk import RrdReader

    found = {path.name: Recording.load(path).digest for path in _visible(folder, "*.glove.npz")}
    for path in _visible(folder, "*.rrd"):
        # Rerun's row ids and its division of static data into chunks depend on the clock; the rest does not.
        reader = RrdReader(path)
        columns: defaultdict[tuple[str, str], list] = defaultdict(list)
        for chunk in reader.stream():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name != ROW_ID:
                    values = batch.column(name).to_pylist()
                    columns[chunk.entity_path, name] += [
                        value for value in values if value is not None or not chunk.is_static
                    ]
        contents = (reader.recordings()[0].recording_id, sorted(columns.items(), key=lambda item: item[0]))
        found[path.name] = _digest(repr(contents).encode())
    return found


def teleoperate(seed: int) -> None:
    """The recording of a glove in teleoperation, written while the session lasts."""
    builder = DiagramBuilder()
    replay = builder.AddSystem(GloveReplay(_session(seed)))
    parts = RecordingParts("session.npz", {"side": "right"})
    recorder = builder.AddSystem(GloveRecorder(0.01, parts, part=0.1))
    for name in ("keypoints", "wrist_pose", "valid"):
        builder.Connect(replay.GetOutputPort(name), recorder.GetInputPort(name))
    simulator = Simulator(builder.Build())
    for tick in range(100):
        simulator.AdvanceTo(0.01 * tick)
        time.sleep(0.002)  # faster than in real time, but not than the disk
    recorder.finish()


def teleoperated(folder: Path) -> dict[str, str]:
    """The recording. What an interrupted session left must be the session's beginning."""
    kept = [Recording.load(path) for path in _visible(folder, "session-interrupted-*.npz")]
    unfinished = read_parts(folder / "session.npz.parts")
    for recording in kept + ([unfinished] if unfinished else []):
        n = len(recording)
        if not any((recording.p_HK == _session(seed).p_HK[:n]).all() for seed in (0, 1)):
            raise ValueError("an interrupted session left something else than its beginning")
    return {path.name: Recording.load(path).digest for path in _visible(folder, "session.npz")}


def _session(seed: int) -> Recording:
    part = slice(100 * seed, 100 * seed + 100)
    return Recording(play().t[part] - play().t[part][0], play().p_HK[part], play().valid[part])


def _visible(folder: Path, pattern: str) -> list[Path]:
    return [path for path in sorted(folder.glob(pattern)) if not path.name.startswith(".")]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _goal() -> GraspGoal:
    """A grasp; the trials end before the hand reaches it."""
    hand = allegro()
    tips = hand.fingertips(hand.default_position)
    inwards = np.tile([1.0, 0.0, 0.0], (len(tips), 1))
    X_OB, X_OB_before = RigidTransform([-0.1, 0.0, 0.05]), RigidTransform([-0.2, 0.0, 0.1])
    everyone = np.ones(len(tips), bool)
    return GraspGoal(
        tuple(hand.finger_names), everyone, X_OB, X_OB_before, 0.012, tips, 0.03 * inwards, inwards, 0.0
    )


WORKS = {
    work.name: work
    for work in (
        Work("data generation", generate, generated),
        Work("training", train, trained),
        Work("benchmark", benchmark, benchmarked, replaces=False),
        Work("benchmark of two workers", functools.partial(benchmark, jobs=2), benchmarked, replaces=False),
        Work("recording", record, recorded),
        Work("teleoperation", teleoperate, teleoperated),
    )
}

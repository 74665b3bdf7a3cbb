"""Programs that write results, and digests of the results they leave."""

import hashlib
import json
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from grasp_setup import TOO_SHORT, allegro, judged, reach_goal
from light_training import train_lightly
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shared import synthesized

from faults.sound import play, smooth_retargeter
from geort_drake import GloveReplay, Recording
from geort_drake.cli import run_command
from geort_drake.people.recording_log import RecordingLog
from geort_drake.systems.glove import GloveRecorder

ROW_ID = "rerun.controls.RowId"

# Each runs in its working directory; the same seed gives the same results.


def generate(seed: int) -> None:
    """A synthetic recording."""
    run_command("recording synthesize", ["--output", "play.npz", "--duration", "5", "--seed", str(seed)])


def train(seed: int) -> None:
    """A trained map."""
    recording = synthesized(0, 20.0, 30.0)
    train_lightly("allegro_right", recording, Path("trained.safetensors"), "geort", seed)


def benchmark(seed: int) -> None:
    """A benchmark, one job in this process.

    It has fewer trials with seed 1 than with seed 0, which resumes it.
    """
    from geort_drake.benchmark import run

    argv = [
        "--output", ".", "--methods", "hold", "--objects", "cylinder", "--jobs", "1",
        "--scenario-text", TOO_SHORT, "--trials", "1" if seed == 1 else "2",
    ]  # fmt: skip
    with (
        mock.patch.object(run, "plan", lambda *_: [reach_goal()]),
        mock.patch.object(run, "training_recording", lambda *_: play()),
    ):
        run_command("benchmark", argv)


def record(seed: int) -> None:
    """A trial with its recordings, as `geort-drake grasp` writes them."""
    from geort_drake.people.synthetic.hand import HumanHand
    from geort_drake.simulation.scenario_files import load_scenario
    from geort_drake.simulation.trial import run_trial

    person = HumanHand.fit(play())
    retarget = smooth_retargeter()
    retarget.joint_names = tuple(allegro().joint_names)
    scenario = load_scenario(text=TOO_SHORT)
    scenario.random_seed = seed
    _, glove = run_trial(scenario, retarget, (person, reach_goal()), "trial.rrd")
    glove.save("trial.glove.npz")


def teleoperate(seed: int) -> None:
    """The recording of a glove in teleoperation, written while the session lasts."""
    part = slice(100 * seed, 100 * seed + 100)
    session = Recording(play().t[part] - play().t[part][0], play().p_HK[part], play().valid[part])
    builder = DiagramBuilder()
    replay = builder.AddSystem(GloveReplay(session))
    log = RecordingLog("session.npz", {"side": "right"})
    recorder = builder.AddSystem(GloveRecorder(0.01, write_after=0.1))
    recorder.switch(log)
    for name in ("keypoints", "wrist_pose", "valid"):
        builder.Connect(replay.GetOutputPort(name), recorder.GetInputPort(name))
    simulator = Simulator(builder.Build())
    for tick in range(100):
        simulator.AdvanceTo(0.01 * tick)
        time.sleep(0.002)  # faster than in real time, but not than the disk
    recorder.switch(None)
    log.finish()


WORKS: dict[str, Callable[[int], object]] = {
    "data generation": generate,
    "training": train,
    "benchmark": benchmark,
    "recording": record,
    "teleoperation": teleoperate,
}


def results(folder: Path) -> dict[str, str]:
    """Name → digest of every result in a folder, trials in the order in which they were made.

    Raises an error for a result that is incomplete. What depends on the clock does not count, nor what is
    kept of an interrupted session, which has tests of its own.
    """
    from geort_drake import load_retargeter
    from geort_drake.benchmark.log import key_of, read_rows

    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if name.startswith(".") or "/." in name or "interrupted" in name or ".npz.parts" in name:
            continue
        if path.suffix == ".npz":
            with np.load(path) as arrays:
                found[name] = _digest(b"".join(arrays[key].tobytes() for key in sorted(arrays.files)))
        elif path.suffix == ".safetensors":
            arrays = load_retargeter(path).arrays
            found[name] = _digest(b"".join(arrays[key].tobytes() for key in sorted(arrays)))
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".jsonl":
            found |= {str(key_of(trial)): json.dumps(judged(trial)) for trial in read_rows(path)}
        elif path.suffix == ".rrd":
            found[name] = _digest_of_rrd(path)
    return found


def _digest_of_rrd(path: Path) -> str:
    """Without row ids and the division of static data into chunks, which depend on the clock."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    columns: defaultdict[tuple[str, str], list] = defaultdict(list)
    for chunk in reader.stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name != ROW_ID:
                columns[chunk.entity_path, name] += [
                    value
                    for value in batch.column(name).to_pylist()
                    if value is not None or not chunk.is_static
                ]
    contents = (reader.recordings()[0].recording_id, sorted(columns.items(), key=lambda item: item[0]))
    return _digest(repr(contents).encode())


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()

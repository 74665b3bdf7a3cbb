"""Programs that write results: what they run, and what is to be found of it."""

import dataclasses as dc
import functools
import hashlib
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from joblib.externals.loky import get_reusable_executor
from pydrake.math import RigidTransform

from faults.child import script
from faults.sound import allegro, play, smooth_retargeter
from geort_drake.operators.grasp_goal import GraspGoal

SETTINGS = {
    "steps": 5, "points": 16, "targets": 32, "pinches": 8, "frames": 8, "hidden": 8,
    "classifier_steps": 5, "refreshes": 0,
}  # fmt: skip
SHORT = "{timeout: 0.3}"  # too short to grasp anything, long enough for every part of a trial


@dc.dataclass(frozen=True)
class Work:
    """A program that writes results into the folder that it runs in.

    Attributes:
        name: of it.
        main: runs it with a seed; the same seed gives the same results.
        results: name → digest of every result in a folder, in the order in which they were made; raises for
            one that is not whole.
        replaces: whether another seed's results take the place of the earlier ones, one by one.
    """

    name: str
    main: Callable[[int], object]
    results: Callable[[Path], dict[str, str]]
    replaces: bool = True


def generate(seed: int) -> None:
    """A synthetic recording, and the robot's samples in their cache."""
    from geort_drake.hands.samples import robot_data

    script("synthesize_recording.py", ["play.npz", "--duration", "20", "--seed", str(seed)])
    robot_data(allegro(), 300, seed, cache=Path())


def generated(folder: Path) -> dict[str, str]:
    from geort_drake.gloves.recording import Recording

    found = {path.name: Recording.load(path).digest for path in _visible(folder, "play.npz")}
    for path in _visible(folder, "robot-data-*.npz"):
        with np.load(path) as arrays:
            found[path.name] = _digest(b"".join(arrays[name].tobytes() for name in sorted(arrays.files)))
    return found


def train(seed: int) -> None:
    """A checkpoint."""
    from geort_drake.evaluation import metrics
    from geort_drake.evaluation.pipeline import train_checkpoint
    from geort_drake.gloves.play import synthesize_play

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
    """Trials of two methods over three seeds, of which `seed` decides nothing: a benchmark goes on."""
    from geort_drake.evaluation import grasp_benchmark

    goal = _goal()
    argv = [
        "--output", ".", "--methods", "hold", "nearest_neighbour", "--objects", "cylinder",
        "--jobs", str(jobs),
        "--scenario_text", SHORT, "--trials", "2" if seed == 1 else "3", "--zero_latency",
    ]  # fmt: skip
    with (
        mock.patch.object(grasp_benchmark, "plan", lambda *_: goal),
        mock.patch("geort_drake.gloves.play.synthesize_play", lambda seed, side: play()),
    ):
        script("benchmark_grasping.py", argv)
    if jobs > 1:
        # A script's interpreter does it at its end; that of a forked process does not.
        get_reusable_executor().shutdown()


def benchmarked(folder: Path) -> dict[str, str]:
    from geort_drake.evaluation.grasp_benchmark import CONFIG, TRIALS, read_config
    from geort_drake.evaluation.trial_log import key_of, read_records

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
    """Trials with their recordings, as simulate_grasp.py writes them."""
    from geort_drake.gloves.human_hand import HumanHand
    from geort_drake.simulation.scenario import load_scenario
    from geort_drake.simulation.trial import run_trial

    person = HumanHand.fit(play())
    retarget = smooth_retargeter()
    retarget.joint_names = tuple(allegro().joint_names)
    for trial in range(2):
        scenario = load_scenario(text=SHORT)
        scenario.random_seed = 10 * seed + trial
        _, glove = run_trial(scenario, retarget, (person, _goal()), f"trial-{trial}.rrd")
        glove.save(f"trial-{trial}.glove.npz")


def recorded(folder: Path) -> dict[str, str]:
    from rerun.chunk import RrdReader

    from geort_drake.gloves.recording import Recording

    found = {path.name: Recording.load(path).digest for path in _visible(folder, "*.glove.npz")}
    for path in _visible(folder, "*.rrd"):
        # Equal recordings have an equal id, made of their contents, and chunks that differ in their own ids.
        reader = RrdReader(path)
        rows = Counter()
        for chunk in reader.stream():
            rows[chunk.entity_path] += chunk.to_record_batch().num_rows
        found[path.name] = f"{reader.recordings()[0].recording_id} {sorted(rows.items())}"
    return found


def _visible(folder: Path, pattern: str) -> list[Path]:
    return [path for path in sorted(folder.glob(pattern)) if not path.name.startswith(".")]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _goal() -> GraspGoal:
    """A grasp that no trial lasts long enough to try."""
    hand = allegro()
    tips = hand.fingertips(hand.default_position)
    inwards = np.tile([1.0, 0.0, 0.0], (len(tips), 1))
    X_OB, X_OB_before = RigidTransform([-0.1, 0.0, 0.05]), RigidTransform([-0.2, 0.0, 0.1])
    everyone = np.ones(len(tips), bool)
    return GraspGoal(
        tuple(hand.finger_names), everyone, X_OB, X_OB_before, tips, 0.03 * inwards, inwards, 0.0
    )


WORKS = {
    work.name: work
    for work in (
        Work("data generation", generate, generated),
        Work("training", train, trained),
        Work("benchmark", benchmark, benchmarked, replaces=False),
        Work("benchmark of two workers", functools.partial(benchmark, jobs=2), benchmarked, replaces=False),
        Work("recording", record, recorded),
    )
}

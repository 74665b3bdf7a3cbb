"""Programs that are killed at any moment, or find the disk full: what they leave, and how they go on.

Each work is a program with a folder of results. Its results are whole or absent, whatever happens.
"""

import dataclasses as dc
import hashlib
import json
import os
import re
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from pydrake.math import RigidTransform

from faults.child import Child, Ending, run, script
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


@dc.dataclass(frozen=True)
class Reference:
    """What a work gives when nothing happens to it.

    Attributes:
        folder: with the results of an earlier run, of another seed.
        earlier, later: results before and after the run.
        seconds: how long the run takes.
        events: how often it opens, renames, makes or removes something.
    """

    folder: Path
    earlier: dict[str, str]
    later: dict[str, str]
    seconds: float
    events: int


# -- the works


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


def benchmark(seed: int) -> None:
    """Trials of two methods over three seeds, of which `seed` decides nothing: a benchmark goes on."""
    from geort_drake.evaluation import grasp_benchmark

    goal = _goal()
    argv = [
        "--output", ".", "--methods", "hold", "nearest_neighbour", "--objects", "cylinder", "--jobs", "1",
        "--scenario_text", SHORT, "--trials", "2" if seed == 1 else "3", "--zero_latency",
    ]  # fmt: skip
    with (
        mock.patch.object(grasp_benchmark, "plan", lambda *_: goal),
        mock.patch("geort_drake.gloves.play.synthesize_play", lambda seed, side: play()),
    ):
        script("benchmark_grasping.py", argv)


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


WORKS = {
    work.name: work
    for work in (
        Work("data generation", generate, generated),
        Work("training", train, trained),
        Work("benchmark", benchmark, benchmarked, replaces=False),
        Work("recording", record, recorded),
    )
}


# -- what is done to them


def reference(work: Work, folder: Path) -> Reference:
    """Runs a work twice, first with another seed, in a folder of its own."""
    room = folder / "reference"
    room.mkdir(parents=True)
    _ended_well(run(_work, (work.name, 1, None), room, folder / "beside"))
    earlier = work.results(room)
    shutil.copytree(room, folder / "earlier")
    ending = _ended_well(run(_work, (work.name, 0, -1), room, folder / "beside"))
    events = int((folder / "beside" / "events.txt").read_text())
    return Reference(folder / "earlier", earlier, work.results(room), ending.seconds, events)


def kill(work: Work, known: Reference, folder: Path, rng: np.random.Generator, by_clock: bool) -> list[str]:
    """Kills a run at a random moment, looks at what is left, and runs it again.

    Args:
        by_clock: at a time; otherwise at a moment between two things that it does to files.

    Returns:
        What is wrong; nothing, where no result was lost, half, or made twice.
    """
    room = folder / "room"
    shutil.copytree(known.folder, room)
    if by_clock:
        child = Child(_work, (work.name, 0, None), room, folder / "beside")
        time.sleep(float(rng.uniform(0.0, known.seconds)))
        child.kill()
    else:
        at = int(rng.integers(1, known.events + 1))
        ending = run(_work, (work.name, 0, at), room, folder / "beside")
        if ending.code != -signal.SIGKILL:
            return [f"was not killed at event {at}: {ending}"]
    wrong, left = _looked_at(work, known, room)
    ending = run(_work, (work.name, 0, None), room, folder / "beside")
    if ending.code != 0:
        return [*wrong, f"did not go on: {ending}"]
    after = work.results(room)
    if after != known.later:
        wrong.append("the results are others than without the kill")
    if not work.replaces and list(after.items())[: len(left)] != list(left.items()):
        wrong.append("a finished trial was made again")
    return wrong


def full_disk(work: Work, known: Reference, folder: Path, limit: int) -> list[str]:
    """Lets no file grow beyond `limit` bytes; then runs without the limit. What is wrong with that."""
    room = folder / "room"
    shutil.copytree(known.folder, room)
    ending = run(_work, (work.name, 0, None), room, folder / "beside", RLIMIT_FSIZE=limit)
    wrong, _ = _looked_at(work, known, room)
    wrong += unclear(ending, "File too large|is the disk full")
    wrong += [f"left {path.name}" for path in room.rglob(".*")]
    ending = run(_work, (work.name, 0, None), room, folder / "beside")
    if ending.code != 0 or work.results(room) != known.later:
        wrong.append(f"did not go on: {ending}")
    return wrong


def unclear(ending: Ending, reason: str) -> list[str]:
    """What is wrong with the end of a program that could not write: it should name a file and the reason."""
    wrong = []
    if (ending.code, ending.error) != (2, "OutputError"):
        wrong.append(f"ended with {ending.code} {ending.error}")
    if not re.search(f"cannot be written.*: ({reason})", ending.said) or "Traceback" in ending.said:
        wrong.append(f"said {ending.said[-500:]}")
    return wrong


def _looked_at(work: Work, known: Reference, room: Path) -> tuple[list[str], dict[str, str]]:
    """What is wrong with the results that a broken run left, and these."""
    wrong = []
    try:
        left = work.results(room)
    except Exception as error:
        return [f"half a result was left: {error}"], {}
    for name, digest in left.items():
        if digest not in (known.earlier.get(name), known.later.get(name)):
            wrong.append(f"{name} is neither the earlier nor the later one")
    wrong += [f"{name} was lost" for name in known.earlier if name not in left]
    return wrong, left


def _work(name: str, seed: int, die_at: int | None) -> object:
    """In the child: the work, which kills itself at a file event of that number (-1 counts them only)."""
    counted = 0
    if die_at is not None:
        folder = os.getcwd()

        def hook(event: str, arguments: tuple) -> None:
            nonlocal counted
            if _touches(event, arguments, folder):
                counted += 1
                if counted == die_at:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
    result = WORKS[name].main(seed)
    if die_at == -1:
        # Beside the room, as its caches are.
        Path(os.environ["XDG_CACHE_HOME"]).with_name("events.txt").write_text(str(counted))
    return result


def _touches(event: str, arguments: tuple, folder: str) -> bool:
    """Whether an audit event is about to change something in a folder."""
    if event == "open":
        path, mode, _ = arguments
        changes = isinstance(mode, str) and any(letter in mode for letter in "wax+")
        return changes and isinstance(path, str | os.PathLike) and _inside(path, folder)
    if event in ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "shutil.rmtree"):
        return isinstance(arguments[0], str | os.PathLike) and _inside(arguments[0], folder)
    return event == "ctypes.dlsym" and arguments[1] == "renameat2"


def _inside(path: str | os.PathLike, folder: str) -> bool:
    return os.path.abspath(os.fspath(path)).startswith(folder)


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


def _ended_well(ending: Ending) -> Ending:
    if ending.code != 0:
        raise RuntimeError(f"a run without a fault ended with {ending}")
    return ending

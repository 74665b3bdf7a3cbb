"""Do the open-loop figures of a map predict what a person can do with it? Trials and their analysis.

python -m studies.predictors --output runs/predictors --tasks keys grasp --objects cylinder --budget 3600
python -m studies.predictors --output runs/predictors --report

Maps are 96 distortions of the universal map, whose causes are known, and others: methods, checkpoints,
distorted affine maps, and the universal map made for other people. Trials of distorted maps come first, seed
by seed, and each seed begins with a balanced half of the maps, so that every prefix is balanced; the same
command resumes.
"""

import argparse
import contextlib
import hashlib
import json
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from geort_drake.benchmark.config import TRIALS
from geort_drake.benchmark.folder import Benchmark, note_refused, open_benchmark, read_person
from geort_drake.benchmark.records import Record, TrialKey, TrialLog, keep_error, outcome_line
from geort_drake.benchmark.trials import Trial, plan_cases, simulate
from geort_drake.benchmark.workers import call_in_workers
from geort_drake.comparison.metrics import RobotSpace, evaluate_frames, robot_space
from geort_drake.comparison.retargeters import retargeter_of
from geort_drake.console import run_main, say, track
from geort_drake.files import finite_json, sha256_of, write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.population import sample_person
from geort_drake.people.recording import Recording
from geort_drake.retargeting.method import Retarget
from geort_drake.retargeting.retargeter import UniversalRetargeter, load_retargeter, shipped_map
from geort_drake.simulation.operators.intention import SERVO
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task, task_names
from studies.distorted_map import DistortedMap, Distortion, design, distortion_of, half
from studies.predictor_analysis import CRITERIA, POINTS, write_analysis

MAPS = "maps.json"
FRAMES = 12_000  # of the recording, on which open-loop figures are measured
OTHERS = 12  # people for whom the universal map is made, without its having seen the person who plays
# Of the untrained affine map, which is no candidate, and so no map's distorted twin.
WORSENED = {
    "affine_turned_20": Distortion(rotation=math.radians(20)),
    "affine_turned_40": Distortion(rotation=math.radians(40)),
    "affine_mixed_10": Distortion(cross_talk=0.1),
    "affine_mixed_25": Distortion(cross_talk=0.25),
    "affine_small": Distortion(reach=0.3),
    "affine_open": Distortion(gap=0.012),
}
METHODS = ("universal", "affine_ik", "vector_online", "dexpilot_online", "nearest_neighbour")


class Place(NamedTuple):
    """A task with one kind of person: its results file, its benchmark and its goals."""

    log: TrialLog
    benchmark: Benchmark
    goals: dict[str, list]


def make_maps(hand: HandModel, recording: Recording, methods: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Name → `map` and `digest` of what is made here, `levels` of designed maps, `latency` if given."""
    keypoints = hand.description.human_keypoints
    frames, p_HK = recording.fingertips(keypoints), recording.p_HK[recording.valid].astype(float)
    universal = load_retargeter(shipped_map(hand), hand)
    affine, _ = retargeter_of("affine_ik", hand, recording, 0)
    own = universal.for_person(p_HK)
    sources = sha256_of(Path(__file__).with_name("distorted_map.py")) + sha256_of(shipped_map(hand))

    def made(retarget: Retarget, *facts: Any) -> dict[str, Any]:
        text = repr((sources, recording.digest, *facts))
        return {"map": retarget, "digest": hashlib.sha256(text.encode()).hexdigest()}

    maps: dict[str, dict[str, Any]] = {}
    for number, (name, levels) in enumerate(design().items()):
        how = distortion_of(levels)
        distorted = DistortedMap(own, frames, keypoints, how, number)
        maps[name] = made(distorted, how, number) | {"levels": levels, "latency": how.latency}
    maps |= {name: {} for name in methods}
    for name, how in WORSENED.items():
        maps[name] = made(DistortedMap(affine, frames, keypoints, how, 0), how)
    for number in range(1, OTHERS + 1):
        person = sample_person(0, number).record(30.0, side=recording.side)
        maps[f"person_{number:02}"] = made(universal.for_person(person.p_HK.astype(float)), number)
    return maps


def open_loop(retarget: Retarget, hand: HandModel, recording: Recording, space: RobotSpace) -> dict:
    """The package's own metrics of a map on the person's recording."""
    frames = recording.fingertips(hand.description.human_keypoints)[:FRAMES]
    if isinstance(retarget, UniversalRetargeter):
        retarget = retarget.for_person(recording.p_HK[recording.valid].astype(float))
    settled = retarget.settled_map(frames) if hasattr(retarget, "settled_map") else None
    if callable(reset := getattr(retarget, "reset", None)):
        reset()
    metrics, _ = evaluate_frames(retarget, hand, frames, recording.rate_hz, 0, space, settled)
    return finite_json(metrics)


def observed(trial: Trial) -> Record:
    """`simulate`, and the memory of the worker after it, MB, with the worker's number."""
    record = simulate(trial)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return record | {"worker": os.getpid(), "worker_mb": pages * os.sysconf("SC_PAGE_SIZE") / 1e6}


def run(arguments: argparse.Namespace) -> None:
    """Runs unfinished trials until the budget is spent."""
    started = time.monotonic()
    description = load_hand(arguments.hand)
    hand = HandModel(description)
    recording, notes = read_person(arguments.recording, description.side, 0)
    names = {name: Path(name).name for name in arguments.methods}
    maps = make_maps(hand, recording, list(names.values()))
    made = {name: (each["map"], each["digest"]) for name, each in maps.items() if "map" in each}
    latencies = {name: each["latency"] for name, each in maps.items() if "latency" in each}
    with contextlib.ExitStack() as stack:
        places = []
        for task in map(find_task, arguments.tasks):
            goals: dict[str, list] | None = None  # the same for all kinds of people
            for kind in sorted(task.kinds, key=lambda kind: kind != SERVO):
                scenario = load_scenario(*task.scenario, hand=arguments.hand)
                scenario.kind = kind
                cases = [case for case in arguments.objects if case in task.cases()] or task.cases()
                folder = arguments.output / task.name / kind
                log = stack.enter_context(TrialLog(folder / TRIALS))
                benchmark = open_benchmark(
                    *(folder, scenario, recording, arguments.methods, cases, arguments.trials),
                    notes=notes,
                    latencies=latencies,
                    made=made,
                )
                latencies |= {name: latency for name, (_, latency) in benchmark.methods.items()}
                if goals is None:
                    found = dict(plan_cases(benchmark.scenario_text, cases, arguments.jobs, "loky"))
                    refused = {name: each for name, each in found.items() if isinstance(each, str)}
                    goals = {name: each for name, each in found.items() if not isinstance(each, str)}
                note_refused(benchmark, refused)
                places.append(Place(log, benchmark, goals))
        note(arguments.output / MAPS, maps, places[0].benchmark)
        queue = order(places, list(maps), half(design()), arguments.trials)
        say(f"{len(queue)} trials are unfinished")
        in_time = (each for each in queue if time.monotonic() - started < arguments.budget)
        handed: list[tuple[Place, TrialKey]] = []

        def trials() -> Iterator[tuple[Trial]]:
            for place, key in in_time:
                handed.append((place, key))
                yield (place.benchmark.trial(key, place.goals[key.object]),)

        records = call_in_workers(observed, trials(), arguments.jobs, "loky", ordered=True)
        for number, record in enumerate(track("simulating", records, len(queue), outcome_line)):
            place = handed[number][0]
            place.log.append(keep_error(place.log.path.parent, record))
        measure(arguments.output / MAPS, places[0].benchmark, recording)


def order(
    places: Sequence[Place], maps: Sequence[str], first: Sequence[str], trials: int
) -> list[tuple[Place, TrialKey]]:
    """The unfinished trials: those of designed maps seed by seed, and then of the others.

    Each seed begins with the maps `first`; otherwise maps are in random order.
    """
    by_map: dict[tuple, list[tuple[Place, TrialKey]]] = {}
    designed = design()
    for place in places:
        for key in place.log.unfinished(place.benchmark.keys(maps, place.goals, trials)):
            drawn = np.random.default_rng([key.seed, *key.method.encode()]).random()
            rank = key.method not in designed, key.seed, key.method not in first, drawn, key.method
            by_map.setdefault(rank, []).append((place, key))
    return [each for rank in sorted(by_map) for each in by_map[rank]]


def note(path: Path, maps: Mapping[str, dict], benchmark: Benchmark) -> None:
    """Writes what is known of the maps; open-loop figures of the same maps are kept."""
    known = json.loads(path.read_text()) if path.exists() else {}
    for name, each in maps.items():
        digest = benchmark.config["methods"][name]["weights_sha256"]
        if known.get(name, {"digest": ""})["digest"] != digest:
            latency = benchmark.methods[name][1]
            known[name] = {
                "digest": digest, "levels": each.get("levels"), "latency": latency, "figures": None
            }  # fmt: skip
    write_text(path, json.dumps(known, indent=1) + "\n")


def measure(path: Path, benchmark: Benchmark, recording: Recording) -> None:
    """Adds the open-loop figures of maps that have none yet."""
    known, space = json.loads(path.read_text()), robot_space(benchmark.hand)
    for name, each in known.items():
        if each["figures"] is None:
            each["figures"] = open_loop(benchmark.methods[name][0], benchmark.hand, recording, space)
            write_text(path, json.dumps(known, indent=1) + "\n")


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Draws the effects on the score, one panel a task and one color a kind of person."""
    import matplotlib.pyplot as plt

    tasks = list(dict.fromkeys(name.split()[0] for name in result["cells"]))
    places = np.arange(len(CRITERIA))[::-1]
    figure, axes = plt.subplots(
        1, len(tasks), sharex=True, sharey=True, squeeze=False, figsize=(9, 3.4), dpi=120
    )
    for axis, task in zip(axes[0], tasks, strict=True):
        axis.axvspan(-POINTS, POINTS, color="0.92")
        axis.axvline(0.0, color="0.6", linewidth=0.8)
        cells = {name.split()[1]: cell for name, cell in result["cells"].items() if name.split()[0] == task}
        for number, (kind, cell) in enumerate(cells.items()):
            effects = [cell["criteria"][criterion.label]["points"] for criterion in CRITERIA]
            middle = np.array([effect["effect"] for effect in effects])
            margin = np.array([[e["effect"] - e["low"], e["high"] - e["effect"]] for e in effects]).T
            at = places + 0.25 * (1 - number)
            axis.errorbar(middle, at, xerr=margin, fmt="o", markersize=4, capsize=2, label=kind)
        axis.set_title(task, fontsize=9)
        axis.tick_params(labelsize=8)
    axes[0][0].set_yticks(places, [criterion.label.removeprefix("log ") for criterion in CRITERIA])
    figure.supxlabel("effect of spoiling the criterion, points of score", fontsize=8)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="lower left", fontsize=8, frameon=False)
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--output", type=Path, default=Path("runs/predictors"), help="folder of the trials and the analysis")
    add("--tasks", nargs="+", default=task_names(), choices=task_names(), help="tasks to try")
    add("--objects", nargs="+", default=[], help="cases of tasks that have several (default: all)")
    add("--methods", nargs="+", default=METHODS, help="other maps: methods, checkpoints and maps")
    add("--hand", default="allegro_right", help="name or file of a hand description")
    add("--recording", type=Path, help="of the person (default: synthetic play)")
    add("--trials", type=int, default=8, help="seeds of each map, task and kind of person")
    add("--jobs", type=int, default=1, help="simultaneous trials")
    add("--budget", type=float, default=math.inf, help="time after which no trial begins, s")
    add("--report", action="store_true", help="run nothing, only analyse the trials in --output")
    add("--figure", type=Path, help="where to draw the effects")
    arguments = parser.parse_args(argv)
    if not arguments.report:
        run(arguments)
    result = write_analysis(arguments.output, arguments.output / MAPS)
    if arguments.figure:
        draw(result, arguments.figure)
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))

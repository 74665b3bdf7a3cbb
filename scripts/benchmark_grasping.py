"""Compares retargeting methods by grasping: every method with every object, over paired seeds.

Each method gets the same simulated person, objects, placements and noise. What is finished is kept, so an
interrupted benchmark goes on with the same command, and methods, objects and trials can be added.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake.cli.console import console, progress_bar, run_main, warn
from geort_drake.cli.options import (
    METHOD_SUMMARIES,
    add_json_option,
    add_scenario_options,
    at_least,
    command,
    make_parser,
    method_help,
    scenario_of,
    write_json,
)
from geort_drake.errors import BenchmarkError, UnknownNameError
from geort_drake.files import require_writable
from geort_drake.people.recording import SIDES

# The first one is what the others are compared with.
METHODS = tuple(METHOD_SUMMARIES)
# Those that need no training but that of `make grasp`.
QUICK = {
    "methods": ("geort_coupled", "vector_online", "dexpilot_online", "nearest_neighbour", "hold"),
    "objects": ("cylinder", "sphere", "cube"),
    "trials": 2,
}
EPILOG = f"""\
{method_help(METHODS)}
The folder given by --output holds trials.jsonl (one line per trial, as it finishes), summary.json,
report.html and report.md. docs/benchmark.md says what is measured. The exit status is 1 when a trial
raised an error.
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("--output", type=Path, default=Path("runs/benchmark"), help="folder for the results")
    add(
        "--methods",
        nargs="+",
        metavar="NAME",
        help="of those below, or directories of checkpoints; the first is the reference (default: all)",
    )
    add("--objects", nargs="+", metavar="NAME", help="what to grasp (default: every object)")
    add(
        "--trials",
        type=at_least(1),
        help="trials per method and object, each with its own seed (default: 30)",
    )
    add("--quick", action="store_true", help="a small benchmark of two to five minutes on two cores")
    add(
        "--jobs",
        type=at_least(1),
        default=os.cpu_count() or 1,
        help="trials at a time (default: the number of processors)",
    )
    add("--backend", default="loky", choices=["loky", "ray"], help="processes here, or a Ray cluster")
    add("--zero_latency", action="store_true", help="let every method answer at once")
    add("--recording", type=Path, help="the person's glove recording (default: synthetic play)")
    add(
        "--sensitivity",
        nargs="*",
        metavar="NAME=V1,V2",
        help="run the trials also with one assumption changed: delay (ms), gain (1/s), and factors on "
        "noise, stiffness and friction; a NAME alone takes its usual values, no NAME takes all",
    )
    add("--side", choices=SIDES, help="side of the recorded hand (default: the robot hand's)")
    add("--seed", type=at_least(0), default=0, help="seed of training and synthetic play")
    add(
        "--rrd",
        nargs="+",
        metavar=("METHOD", "OBJECT SEED CONDITION"),
        help="simulate one finished trial of --output again, check it, and write its Rerun recording; "
        "CONDITION is one of --sensitivity, such as delay=100, and may be left out",
    )
    add("--report", action="store_true", help="only write the report of --output again")
    add_json_option(parser, "the summary")
    add_scenario_options(parser)
    arguments = parser.parse_args(argv)
    if arguments.rrd and len(arguments.rrd) not in (3, 4):
        parser.error(f"--rrd: wants METHOD OBJECT SEED [CONDITION], not {' '.join(arguments.rrd)}")
    if arguments.rrd and not arguments.rrd[2].isdecimal():
        parser.error(f"--rrd: SEED must be a whole number, not {arguments.rrd[2]}")
    chosen = QUICK if arguments.quick else {"methods": METHODS, "objects": None, "trials": 30}
    for name, default in chosen.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
    require_writable(arguments.output, directory=True)
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.benchmark.report import write_report

    if arguments.report:
        return finish(arguments, write_report(arguments.output))
    if arguments.rrd:
        method, thing, seed, *condition = arguments.rrd
        return watch(arguments.output, method, thing, int(seed), *condition)
    run(arguments)
    return finish(arguments, write_report(arguments.output))


def run(arguments: argparse.Namespace) -> None:
    """Runs what is left of the benchmark."""
    from geort_drake.benchmark.config import TRIALS
    from geort_drake.benchmark.folder import keep_error, open_benchmark
    from geort_drake.benchmark.methods import names_of
    from geort_drake.benchmark.sensitivity import PARAMETERS, make_conditions, parse_values
    from geort_drake.benchmark.trial_log import TrialLog, key_of
    from geort_drake.benchmark.workers import require_workers
    from geort_drake.hands.description import load_hand
    from geort_drake.simulation.scenario import object_names

    # What is wrong with the request is found before anything is computed or written.
    names = names_of(arguments.methods)
    objects = list(dict.fromkeys(arguments.objects or object_names()))
    for name in objects:
        if name not in object_names():
            raise UnknownNameError("object", name, object_names())
    scenario = scenario_of(arguments)
    side = arguments.side or load_hand(scenario.hand).side
    conditions = {}
    if arguments.sensitivity is not None:
        usual = {name: parameter.values for name, parameter in PARAMETERS.items()}
        conditions = make_conditions(scenario, parse_values(arguments.sensitivity, usual))
    recording, notes = read_person(arguments.recording, side, arguments.seed)
    with TrialLog(arguments.output / TRIALS) as log:
        if log.torn:
            console.print("The last trial was not written to its end; it is repeated.")
        benchmark = open_benchmark(
            arguments.output,
            scenario,
            recording,
            arguments.methods,
            objects,
            arguments.trials,
            arguments.seed,
            arguments.zero_latency,
            notes,
            conditions,
        )
        keys = benchmark.keys(names, objects, arguments.trials)
        finished = log.finished
        left = [key for key in keys if key not in finished]
        console.print(f"{len(keys)} trials, {len(keys) - len(left)} of them finished before")
        if not left:
            return
        jobs, backend = arguments.jobs, arguments.backend
        require_workers(min(jobs, len(left)), backend)
        with progress_bar() as progress:
            wanted = [name for name in objects if any(key.object == name for key in left)]
            goals = {}
            task = progress.add_task("planning", total=len(wanted), note="")
            for name, goal in benchmark.goals(wanted, min(jobs, len(wanted)), backend):
                goals[name] = goal
                progress.update(task, advance=1, note=name)
            progress.update(task, note="")
            task = progress.add_task("grasping", total=len(left), note="")
            for record in benchmark.run(left, goals, min(jobs, len(left)), backend):
                log.append(keep_error(arguments.output, record))
                outcome = "error" if "error" in record else record["outcome"]
                progress.update(task, advance=1, note=f"{key_of(record)}: {outcome}")


def read_person(path: Path | None, side: str, seed: int):
    """The recording of the person who teleoperates, and what the configuration says of it."""
    from geort_drake.people.play import synthesize_play
    from geort_drake.people.readers import read_recording

    if path is None:
        return synthesize_play(seed=seed, side=side), {"recording": None, "side": side}
    return read_recording(path, side, training=True), {"recording": str(path.resolve()), "side": side}


def watch(folder: Path, method: str, thing: str, seed: int, condition: str = "") -> int:
    """Simulates a finished trial again, with a recording; 1 when it did not come out the same."""
    from geort_drake.benchmark.config import METHODS as KEPT
    from geort_drake.benchmark.config import SCENARIO, TRIALS, read_config
    from geort_drake.benchmark.folder import open_benchmark
    from geort_drake.benchmark.report import rerun_path, write_report
    from geort_drake.benchmark.sensitivity import PARAMETERS, make_conditions, parse_values
    from geort_drake.benchmark.trial import simulate
    from geort_drake.benchmark.trial_log import TrialKey, key_of, read_records
    from geort_drake.benchmark.trial_sources import code_digest
    from geort_drake.simulation.scenario import load_scenario

    config = read_config(folder)
    key = TrialKey(method, thing, seed, condition)
    records = {key_of(record): record for record in read_records(folder / TRIALS)}
    if key not in records:
        alike = [other for other in records if other.condition == condition] or list(records)
        named = [other.words for other in alike if other.object == thing] or [other.words for other in alike]
        raise UnknownNameError("finished trial", key.words, named)
    notes, settings = config["notes"], config["settings"]
    recording, _ = read_person(
        Path(notes["recording"]) if notes.get("recording") else None,
        notes.get("side", "right"),
        settings["training_seed"],
    )
    if settings["code_sha256"] != code_digest():
        warn("the trials' code has changed since; this one may come out otherwise")
    scenario, conditions = load_scenario(folder / SCENARIO, "Resolved"), {}
    if condition:
        usual = {name: parameter.values for name, parameter in PARAMETERS.items()}
        conditions = make_conditions(scenario, parse_values([condition], usual))
    kept = folder / KEPT / method
    with progress_bar() as progress:
        task = progress.add_task("simulating", total=None, note=str(key))
        benchmark = open_benchmark(
            folder,
            scenario,
            recording,
            [str(kept) if kept.is_dir() else method],
            [thing],
            1,
            settings["training_seed"],
            settings["latency"] == "zero",
            conditions=conditions,
            any_code=True,
        )
        ((_, goal),) = benchmark.goals([thing], 1, "loky")
        path = folder / rerun_path(key)
        path.parent.mkdir(exist_ok=True)
        record = simulate(*benchmark.arguments(key, goal), path)
        progress.update(task, total=1, completed=1)
    if "error" in record:
        console.print(record["error"], markup=False)
        return 1
    differing = [name for name in record if name != "wall_time" and record[name] != records[key].get(name)]
    if differing:
        raise BenchmarkError(
            f"{folder / TRIALS}: this time the trial came out otherwise in {', '.join(differing)}; "
            "was it run with other code, or on another kind of machine? "
            f"The recording is of this time: {path}"
        )
    write_report(folder)  # which now links the recording
    console.print(f"The same outcome: {record['outcome']}", markup=False)
    console.print(f"Watch it: {command('rerun', path)}", markup=False, soft_wrap=True)
    return 0


def finish(arguments: argparse.Namespace, summary: dict) -> int:
    """Prints what came out; the exit status."""
    folder = arguments.output
    console.print(results_table(summary))
    errors = summary["errors"]
    if errors:
        warn(f"{errors} trials raised an error: see {folder / 'errors'}")
    write_json(arguments.json, summary)
    console.print(f"Report: {folder / 'report.html'} (a browser shows it)", markup=False, soft_wrap=True)
    return 1 if errors else 0


def results_table(summary: dict) -> Table:
    """One row a method."""
    table = Table(title="Grasps")
    for heading in ("method", "at once", "95 %", "success", "mean time", "points"):
        table.add_column(heading, justify="left" if heading == "method" else "right", no_wrap=True)
    for name, entry in summary["methods"].items():
        of = entry["overall"]
        once, success = of["one_time_success"], of["success"]
        if not once["trials"]:
            table.add_row(name, *["–"] * 5)
            continue
        against = summary["differences"].get(name, {}).get("overall", {}).get("one_time_success", {})
        table.add_row(
            name,
            f"{once['successes']} of {once['trials']}",
            f"{100 * once['low']:.0f}–{100 * once['high']:.0f} %",
            f"{100 * success['rate']:.0f} %",
            f"{of['completion_time_s']['restricted_mean']['mean']:.1f} s",
            "–" if against.get("mean") is None else f"{100 * against['mean']:+.0f}",
        )
    table.caption = (
        "at once: lifted and held at the first closing, and in points against the first method; "
        "mean time: failures count as the timeout"
    )
    return table


if __name__ == "__main__":
    run_main(main)

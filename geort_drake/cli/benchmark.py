"""Compare retargeting methods by grasping in simulation.

Every method grasps every object with the same seeds: the same simulated person, placements and noise. The
same command resumes an interrupted benchmark, and adds methods, objects and trials to a finished one.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from geort_drake.cli.options import (
    CommandParser,
    at_least,
    finish,
    method_help,
    methods_for,
    scenario_of,
    view,
    write_json,
)
from geort_drake.errors import UnknownNameError, UsageError

# Methods that need no training.
QUICK = {
    "methods": ("universal", "vector_online", "dexpilot_online", "nearest_neighbour", "hold"),
    "objects": ("cylinder", "sphere", "cube"),
    "trials": 2,
}
EPILOG = f"""\
{method_help()}
Writes trials.jsonl (one line per finished trial), summary.json, report.html and report.md to --output.

Exit codes: 0 success; 1 a trial raised an error; 2 the input is invalid.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_output("runs/benchmark")
    methods = (
        "methods listed below, checkpoints, maps or Python files; the first is the reference (default: all)"
    )
    add("--methods", nargs="+", metavar="NAME", help=methods)
    add("--objects", nargs="+", metavar="NAME", help="objects to grasp (default: all)")
    add("--trials", type=at_least(1), help="trials per method and object (default: 30)")
    trainings = "trainings of each trained method, with successive seeds; every one does all trials"
    add("--trainings", type=at_least(1), default=1, help=trainings)
    add("--quick", action="store_true", help="small benchmark that takes two to five minutes on two cores")
    parser.add_workers()
    add("--zero-latency", action="store_true", help="do not simulate the methods' latencies")
    add("--recording", type=Path, help="recording of the person's hand (default: synthetic play)")
    add(
        "--operator",
        type=Path,
        metavar="RECORDING",
        help="recording of the person who operates, such as another session or person (default: --recording)",
    )
    assumptions = (
        "repeat the trials with one assumption changed: delay, gain, noise, touch, tracker, donning, "
        "dropouts, person, stiffness, friction or modulus; NAME alone uses its default values, no "
        "NAME uses all"
    )
    add("--sensitivity", nargs="*", metavar="NAME=V1,V2", help=assumptions)
    parser.add_side()
    parser.add_seed("training and synthetic play")
    add(
        "--rrd",
        nargs="+",
        metavar=("METHOD", "OBJECT SEED CONDITION"),
        help="repeat a finished trial of --output, check it, and write its Rerun recording; CONDITION, such "
        "as delay=100, selects a trial of --sensitivity",
    )
    add("--report", action="store_true", help="only rewrite the report in --output")
    parser.add_json("the summary")
    parser.add_scenario()


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.benchmark.report import write_grasp_report

    if arguments.rrd:
        if len(arguments.rrd) not in (3, 4):
            raise UsageError(f"--rrd: give METHOD OBJECT SEED [CONDITION], not {' '.join(arguments.rrd)}")
        method, thing, seed, *condition = arguments.rrd
        if not seed.isdecimal():
            raise UsageError(f"--rrd: SEED must be a whole number, not {seed}")
    if arguments.rrd and not arguments.report:
        return repeat(arguments.output, method, thing, int(seed), *condition)
    chosen = QUICK if arguments.quick else {"methods": None, "objects": None, "trials": 30}
    for name, default in chosen.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
    if not arguments.report:
        run_unfinished(arguments)
    return report(arguments, write_grasp_report(arguments.output))


def run_unfinished(arguments: argparse.Namespace) -> None:
    """Runs the unfinished trials of the benchmark."""
    from geort_drake.benchmark import folder
    from geort_drake.benchmark.conditions import ASSUMPTIONS, make_conditions, parse_values
    from geort_drake.benchmark.config import TRIALS
    from geort_drake.benchmark.records import TrialLog, outcome_line
    from geort_drake.benchmark.trials import plan_grasps, run_trials
    from geort_drake.benchmark.workers import require_workers
    from geort_drake.comparison.retargeters import names_of
    from geort_drake.console import say, track, warn
    from geort_drake.hands.description import load_hand
    from geort_drake.simulation.scenario import object_names

    # Everything wrong with the request is found before anything is computed or written.
    scenario = scenario_of(arguments)
    arguments.methods = arguments.methods or methods_for(scenario.hand)
    names = names_of(arguments.methods, arguments.trainings)
    objects = list(dict.fromkeys(arguments.objects or object_names()))
    for name in objects:
        if name not in object_names():
            raise UnknownNameError("object", name, object_names())
    side = arguments.side or load_hand(scenario.hand).side
    conditions = {}
    if arguments.sensitivity is not None:
        conditions = make_conditions(scenario, parse_values(arguments.sensitivity, ASSUMPTIONS), ASSUMPTIONS)
    recording, notes = folder.read_person(arguments.recording, side, arguments.seed)
    operator = None
    if arguments.operator:
        operator, its_notes = folder.read_person(arguments.operator, side, arguments.seed)
        notes["operator"] = its_notes["recording"]
    with TrialLog(arguments.output / TRIALS) as log:
        if log.torn:
            say("The last trial was not written completely and will be repeated.")
        benchmark = folder.open_benchmark(
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
            operator=operator,
            trainings=arguments.trainings,
        )
        keys = benchmark.keys(names, objects, arguments.trials)
        left = log.unfinished(keys)
        say(f"{len(keys)} trials, {len(keys) - len(left)} already finished")
        if not left:
            return
        jobs, backend = min(arguments.jobs, len(left)), arguments.backend
        require_workers(jobs, backend)
        planned = [name for name in objects if any(key.object == name for key in left)]
        plans = plan_grasps(benchmark.scenario_text, planned, min(jobs, len(planned)), backend)
        found = dict(track("planning", plans, len(planned), lambda each: each[0]))
        refused = {name: reason for name, reason in found.items() if isinstance(reason, str)}
        goals = {name: plans for name, plans in found.items() if not isinstance(plans, str)}
        for message in refused.values():
            warn(f"left out: {message}")
        folder.note_refused(benchmark, refused)
        left = [key for key in left if key.object not in refused]
        trials = (benchmark.trial(key, goals[key.object]) for key in left)
        for _ in track("grasping", run_trials(log, trials, jobs, backend), len(left), outcome_line):
            pass


def repeat(folder: Path, method: str, thing: str, seed: int, condition: str = "") -> int:
    """Simulates a finished trial again and records it; raises BenchmarkError if the outcome differs."""
    from geort_drake.benchmark.folder import code_has_changed, repeat_trial
    from geort_drake.benchmark.records import TrialKey
    from geort_drake.benchmark.report import write_grasp_report
    from geort_drake.console import progress_bar, say, warn

    if code_has_changed(folder):
        warn("the simulation code has changed since this trial; the outcome may differ")
    with progress_bar() as display, display.spinner("simulating"):
        record, path = repeat_trial(folder, TrialKey(method, thing, seed, condition))
    if "error" in record:
        say(record["error"])
        return 1
    write_grasp_report(folder)  # now with a link to the recording
    finish({"The same outcome": record["outcome"]}, view(path))
    return 0


def report(arguments: argparse.Namespace, summary: dict) -> int:
    """Prints the summary; returns the exit code."""
    from geort_drake.console import print_table, warn

    folder, errors = arguments.output, summary["errors"]
    headings = ("method", "at once", "95 %", "success", "by tips", "mean time", "points")
    caption = (
        "at once: lifted and held at the first closing, and in points against the first method; by tips: "
        "nothing else touched the held object; "
        "mean time: failures count as the timeout"
    )
    print_table(headings, _rows(summary), "Grasps", caption)
    if summary["refused"]:
        warn(f"objects left out, as the hand cannot grasp them: {', '.join(summary['refused'])}")
    for name, entry in summary["methods"].items():
        if faults := entry["overall"]["faults"]:
            counted = ", ".join(f"{number} {kind}" for kind, number in faults.items())
            warn(f"faulty answers of {name}, for which the joints hold or stay at their limits: {counted}")
    if errors:
        warn(f"{errors} trials raised an error: see {folder / 'errors'}")
    write_json(arguments.json, summary)
    finish({"Report": f"{folder / 'report.html'} (open it in a browser)"})
    return 1 if errors else 0


def _rows(summary: dict) -> Iterator[list[str]]:
    """One row a method."""
    for name, entry in summary["methods"].items():
        of = entry["overall"]
        once, success = of["one_time_success"], of["success"]
        if not once["trials"]:
            yield [name, *["–"] * 6]
            continue
        against = summary["differences"].get(name, {}).get("overall", {}).get("one_time_success", {})
        yield [
            name,
            f"{once['successes']} of {once['trials']}",
            f"{100 * once['low']:.0f}–{100 * once['high']:.0f} %",
            f"{100 * success['rate']:.0f} %",
            f"{100 * of['tip_success']['rate']:.0f} %",
            f"{of['completion_time_s']['restricted_mean']['mean']:.1f} s",
            "–" if against.get("mean") is None else f"{100 * against['mean']:+.0f}",
        ]

"""Compare retargeting methods by tasks in simulation, such as grasps.

Every method does every task with the same objects, people and seeds: the same placements and noise. The same
command resumes an interrupted benchmark, and adds methods, objects, people and trials to a finished one.
"""

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.cli.options import (
    CommandParser,
    at_least,
    finish,
    methods_for,
    scenario_of,
    view,
    write_json,
)
from geort_drake.errors import UnknownNameError, UsageError
from geort_drake.simulation.tasks import task_names

if TYPE_CHECKING:
    from geort_drake.benchmark.run import Benchmark, Variant
    from geort_drake.simulation.scenario import Scenario

# Methods that need no training.
QUICK = {
    "methods": ("universal", "anyteleop", "dexpilot", "hold"),
    "objects": ("cylinder", "sphere", "cube"),
    "trials": 2,
}
EPILOG = """\
{methods}
Writes trials.jsonl (one row per finished trial) and report.md to --output.

Exit codes: 0 success; 1 a trial raised an error; 2 the input is invalid.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_output("runs/benchmark", "trials.jsonl")
    methods = (
        "methods listed below, checkpoints, maps or Python files; the first is the reference (default: all)"
    )
    add("--tasks", nargs="+", metavar="NAME", help=f"tasks: {', '.join(task_names())} (default: grasp)")
    kinds = "kinds of simulated people: servo, mimicry, adaptive (default: the scenario's; with --tasks, all)"
    add("--kinds", nargs="+", metavar="NAME", help=kinds)
    add("--methods", nargs="+", metavar="NAME", help=methods)
    add("--objects", nargs="+", metavar="NAME", help="objects to grasp (default: all)")
    persons = "people of the population, by number; 0 has the hand of --recording (default: the scenario's)"
    add("--persons", nargs="+", type=at_least(0), metavar="N", help=persons)
    add("--trials", type=at_least(1), help="trials per method, object and person (default: 30)")
    trainings = "number of trainings of each trained method, with successive seeds; each does all trials"
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
    varied = (
        "repeat the trials with one field of the scenario changed, such as operator.visual_delay=0,0.1,0.3"
    )
    add("--vary", nargs="+", default=(), metavar="FIELD=V1,V2", help=varied)
    parser.add_side()
    parser.add_seed("training and synthetic play")
    add(
        "--rrd",
        nargs="+",
        metavar=("METHOD", "OBJECT SEED"),
        help="repeat a finished trial of --output and write its Rerun recording; --tasks, --kinds, --persons "
        "and --vary select one of several",
    )
    submit = "add a method to the benchmark in --output, with its people, objects, seeds and settings"
    add("--submit", metavar="METHOD", help=submit)
    add("--report", action="store_true", help="only rewrite the report in --output")
    parser.add_json("the figures")
    parser.add_scenario()


def run(arguments: argparse.Namespace) -> int:
    if arguments.rrd:
        return repeat(arguments)
    if arguments.submit:
        for name in ("methods", "objects", "trials", "persons", "quick", "recording", "operator", "vary"):
            if getattr(arguments, name):
                raise UsageError(f"--submit runs one method as --output states; leave out --{name}")
        simulate(*stored_benchmark(arguments.output, [arguments.submit]), arguments)
    elif not arguments.report:
        simulate(*new_benchmark(arguments), arguments)
    return report(arguments)


def new_benchmark(arguments: argparse.Namespace) -> "tuple[Benchmark, list[str]]":
    """Opens the benchmark that the options describe; returns it with the names of their methods.

    Checks the whole request before anything is computed or written.
    """
    from geort_drake import HandModel
    from geort_drake.benchmark.run import Benchmark, Settings
    from geort_drake.benchmark.workers import join_cluster
    from geort_drake.hands.description import load_hand
    from geort_drake.methods import names_of
    from geort_drake.simulation.tasks import find_task

    scenarios = scenarios_of(arguments)
    first = next(iter(scenarios.values()))
    chosen = QUICK if arguments.quick else {}
    methods = arguments.methods or chosen.get("methods") or methods_for(first.hand)
    objects = list(arguments.objects or chosen.get("objects") or ())
    known = dict.fromkeys(
        itertools.chain.from_iterable(find_task(variant.task).cases() for variant in scenarios)
    )
    for name in objects:
        if name not in known and not arguments.quick:
            raise UnknownNameError("object", name, known)
    names = names_of(methods, HandModel(first.hand))
    if arguments.backend == "ray":
        join_cluster(arguments.jobs)
    recording, operator = (
        None if path is None else str(path.resolve()) for path in (arguments.recording, arguments.operator)
    )
    settings = Settings(
        recording,
        operator,
        arguments.side or load_hand(first.hand).side,
        arguments.seed,
        arguments.zero_latency,
        arguments.persons or [first.person],
        objects,
        arguments.trials or chosen.get("trials") or 30,
        arguments.trainings,
    )
    return Benchmark(arguments.output, settings, scenarios, names), list(names)


def stored_benchmark(folder: Path, methods: Sequence[str]) -> "tuple[Benchmark, list[str]]":
    """Opens a folder's benchmark as its settings state, with some methods, and returns both.

    Raises:
        BenchmarkError: the folder contains no benchmark.
    """
    from geort_drake import HandModel
    from geort_drake.benchmark.run import Benchmark, read_scenarios, read_settings
    from geort_drake.methods import names_of

    settings, scenarios = read_settings(folder), read_scenarios(folder)
    known = {name: entry["source"] for name, entry in settings.methods.items()}
    hand = HandModel(next(iter(scenarios.values())).hand)
    names = {name: known[name] for name in methods if name in known}
    names |= names_of([name for name in methods if name not in known], hand)
    return Benchmark(folder, settings, scenarios, names), list(names)


def scenarios_of(arguments: argparse.Namespace) -> "dict[Variant, Scenario]":
    """Returns the scenarios of the requested tasks and kinds of people, and of --vary.

    Raises:
        UnknownNameError: there is no such task or kind.
        ScenarioError: a scenario's text does not fit a task.
    """
    import copy

    from geort_drake import load_scenario
    from geort_drake.benchmark.run import Variant, vary
    from geort_drake.console import warn
    from geort_drake.simulation.scenario_files import check_scenario
    from geort_drake.simulation.tasks import find_task

    if arguments.tasks:
        bases = [
            load_scenario(text=arguments.scenario_text, hand=arguments.hand, task=find_task(name).name)
            for name in arguments.tasks
        ]
    else:
        bases = [scenario_of(arguments)]
    known = list(dict.fromkeys(kind for base in bases for kind in find_task(base.task).kinds))
    for kind in arguments.kinds or ():
        if kind not in known:
            raise UnknownNameError("kind of person for these tasks", kind, known)
    scenarios: dict[Variant, Scenario] = {}
    for base in bases:
        kinds = arguments.kinds or (known if arguments.tasks else [base.kind])
        kinds = [kind for kind in kinds if kind in find_task(base.task).kinds]
        if not kinds:
            warn(f"left out: {base.task}, which has people of other kinds only")
        for kind in kinds:
            scenario = copy.deepcopy(base)
            scenario.kind = kind
            check_scenario(scenario)
            scenarios[Variant(base.task, kind)] = scenario
            for condition, changed in vary(scenario, arguments.vary).items():
                scenarios[Variant(base.task, kind, condition)] = changed
    return scenarios


def simulate(benchmark: "Benchmark", methods: Sequence[str], arguments: argparse.Namespace) -> None:
    """Runs the unfinished trials of some methods; plans all cases before the first trial."""
    from geort_drake.benchmark.log import TrialLog, key_of
    from geort_drake.console import say, track, warn

    settings, jobs, backend = benchmark.settings, arguments.jobs, arguments.backend
    new = not arguments.submit
    objects = arguments.objects or (QUICK["objects"] if arguments.quick else ())
    with TrialLog(benchmark.folder) as log:
        keys = benchmark.keys(
            methods,
            objects if new else settings.objects,
            (arguments.persons if new else None) or settings.persons,
            (arguments.trials or (QUICK["trials"] if arguments.quick else 30)) if new else settings.trials,
        )
        left = log.unfinished(keys)
        say(f"trials: {len(keys)}, already finished: {len(keys) - len(left)}")
        if not left:
            return
        cases = len({(key[2:5], key.object) for key in left})
        for _ in track("planning", benchmark.plan(left, jobs, backend), cases, str):
            pass
        for case, reason in settings.refused.items():
            warn(f"left out: {case}: {reason}")
        left = [key for key in left if not benchmark.is_refused(key)]
        rows = benchmark.run(log, left, jobs, backend)
        for _ in track("simulating", rows, len(left), lambda row: f"{key_of(row)}: {_outcome(row)}"):
            pass


def _outcome(row: dict) -> str:
    return "error" if "error" in row else row["outcome"]


def report(arguments: argparse.Namespace) -> int:
    """Writes and prints the report; returns the exit code."""
    from geort_drake.benchmark.report import REPORT, write_report
    from geort_drake.console import print_table, warn

    written = write_report(arguments.output)
    rows = [
        [task, condition or kind, row["method"], str(row["trials"]), row["success"].text(),
         row["time"].text("{:.1f}", 1.0), row["difference"].text("{:+.0f}")]
        for (task, kind, condition), figures in written.tables.items()
        for row in figures.to_dict("records")
    ]  # fmt: skip
    headings = ("task", "person", "method", "trials", "success, %", "time, s", "to first")
    caption = "with 95 % intervals; time: failures count as the timeout; to first: success minus the first's"
    print_table(headings, rows, "Benchmark", caption, text=("person", "method"))
    if written.errors:
        warn(f"trials that raised an error: {written.errors}; see report.md")
    write_json(arguments.json, written.to_json())
    finish({"Report": arguments.output / REPORT})
    return 1 if written.errors else 0


def repeat(arguments: argparse.Namespace) -> int:
    """Simulates a finished trial again and records it."""
    from geort_drake.benchmark.log import TRIALS, key_of, read_rows
    from geort_drake.console import progress_bar, say

    if len(arguments.rrd) != 3 or not arguments.rrd[2].isdecimal():
        raise UsageError(f"--rrd: give METHOD OBJECT SEED, not {' '.join(arguments.rrd)}")
    method, case, seed = arguments.rrd[0], arguments.rrd[1], int(arguments.rrd[2])
    keys = [key_of(row) for row in read_rows(arguments.output / TRIALS)]
    wanted = {"tasks": "task", "kinds": "kind", "persons": "person", "vary": "condition"}
    found = [
        key
        for key in keys
        if (key.method, key.object, key.seed) == (method, case, seed)
        and all(getattr(key, field) in (getattr(arguments, name) or [getattr(key, field)])
                for name, field in wanted.items())
    ]  # fmt: skip
    if len(found) != 1:
        listed = found or [key for key in keys if key.object == case] or keys
        what = "trial; several have this method, object and seed" if found else "finished trial"
        raise UnknownNameError(what, " ".join(arguments.rrd), map(str, listed))
    benchmark, _ = stored_benchmark(arguments.output, [method])
    with progress_bar() as display, display.spinner("simulating"):
        row, path = benchmark.repeat(found[0])
    if "error" in row:
        say(row["traceback"])
        return 1
    finish({"Outcome": row["outcome"]}, view(path))
    return 0

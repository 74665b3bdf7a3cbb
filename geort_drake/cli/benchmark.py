"""Compare retargeting methods by tasks in simulation, such as grasps.

Every method grasps every object, or does another task, with the same seeds: the same simulated person,
placements and noise. The same command resumes an interrupted benchmark, and adds methods, objects and trials
to a finished one.
"""

import argparse
import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.cli.benchmark_tables import report, report_tasks
from geort_drake.cli.options import CommandParser, at_least, finish, methods_for, scenario_of, view
from geort_drake.errors import UnknownNameError, UsageError
from geort_drake.simulation.tasks import task_names

if TYPE_CHECKING:
    from geort_drake.simulation.scenario import Scenario
    from geort_drake.simulation.task import Task

# Methods that need no training.
QUICK = {
    "methods": ("universal", "vector_online", "dexpilot_online", "hold"),
    "objects": ("cylinder", "sphere", "cube"),
    "trials": 2,
}
EPILOG = """\
{methods}
Writes trials.jsonl (one line per finished trial), summary.json and report.md to --output.

Exit codes: 0 success; 1 a trial raised an error; 2 the input is invalid.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_output("runs/benchmark", "trials.jsonl")
    methods = (
        "methods listed below, checkpoints, maps or Python files; the first is the reference (default: all)"
    )
    names = ", ".join(task_names())
    tasks = f"tasks, each in a folder of --output: {names} (default: the scenario's, directly in --output)"
    add("--tasks", nargs="+", metavar="NAME", help=tasks)
    kinds = "kinds of simulated people, where a task has several: servo, mimicry, adaptive (default: all)"
    add("--kinds", nargs="+", metavar="NAME", help=kinds)
    add("--methods", nargs="+", metavar="NAME", help=methods)
    add("--objects", nargs="+", metavar="NAME", help="objects to grasp (default: all)")
    add("--trials", type=at_least(1), help="trials per method and object (default: 30)")
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
    assumptions = (
        "repeat the trials with one assumption changed: delay, gain, noise, touch, tracker, donning, "
        "dropouts, person, stiffness, friction or modulus; a NAME alone takes its default values; without "
        "NAME, all are changed in turn"
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
    submit = "add a method to the benchmark in --output, with its people, objects, seeds and settings"
    add("--submit", metavar="METHOD", help=submit)
    add("--report", action="store_true", help="only rewrite the report in --output")
    parser.add_json("the summary")
    parser.add_scenario()


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.benchmark.tasks import write_summary, write_task_report

    if arguments.rrd:
        if len(arguments.rrd) not in (3, 4):
            raise UsageError(f"--rrd: give METHOD OBJECT SEED [CONDITION], not {' '.join(arguments.rrd)}")
        method, object_name, seed, *condition = arguments.rrd
        if not seed.isdecimal():
            raise UsageError(f"--rrd: SEED must be a whole number, not {seed}")
    if arguments.rrd and not arguments.report:
        return repeat(arguments.output, method, object_name, int(seed), *condition)
    if arguments.submit:
        for name in ("methods", "objects", "trials", "quick", "recording", "operator", "report"):
            if getattr(arguments, name):
                raise UsageError(f"--submit runs one method as --output states; leave out --{name}")
        return submit(arguments)
    chosen = QUICK if arguments.quick else {"methods": None, "objects": None, "trials": 30}
    for name, default in chosen.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
    several = arguments.tasks or arguments.kinds
    if not arguments.report:
        run_unfinished(
            arguments, tasks_of(arguments) if several else {arguments.output: scenario_of(arguments)}
        )
    summary = write_summary(arguments.output) if several else write_task_report(arguments.output)
    return report_tasks(arguments, summary) if "tasks" in summary else report(arguments, summary)


def submit(arguments: argparse.Namespace) -> int:
    """Runs a further method under the settings of the benchmark in --output; returns the exit code.

    Raises:
        BenchmarkError: the folder contains no benchmark.
    """
    from geort_drake import load_scenario
    from geort_drake.benchmark.config import CONFIG, SCENARIO, read_config
    from geort_drake.benchmark.report import write_grasp_report
    from geort_drake.benchmark.tasks import write_summary

    folders = [path.parent for path in sorted(arguments.output.glob(f"*/*/{CONFIG}"))]
    several = bool(folders) and not (arguments.output / CONFIG).exists()
    configs = {path: read_config(path) for path in (folders if several else [arguments.output])}
    config = next(iter(configs.values()))
    notes = config["notes"]
    arguments.methods = [arguments.submit]
    arguments.objects = [name for each in configs.values() for name in each["objects"]]
    arguments.trials = config["trials"]
    arguments.seed = config["settings"]["training_seed"]
    arguments.zero_latency = config["settings"]["latency"] == "zero"
    arguments.side = notes.get("side")
    for name in ("recording", "operator"):
        setattr(arguments, name, Path(notes[name]) if notes.get(name) else None)
    run_unfinished(arguments, {path: load_scenario(path / SCENARIO, "Resolved") for path in configs})
    if several:
        return report_tasks(arguments, write_summary(arguments.output))
    return report(arguments, write_grasp_report(arguments.output))


def tasks_of(arguments: argparse.Namespace) -> dict[Path, "Scenario"]:
    """Returns folder → scenario for each task and kind of person.

    Raises:
        UnknownNameError: there is no such task or kind.
        ScenarioError: a scenario's text does not fit a task.
    """
    from geort_drake import load_scenario
    from geort_drake.console import warn
    from geort_drake.simulation.scenario_files import check_scenario
    from geort_drake.simulation.tasks import find_task

    tasks = [find_task(name) for name in arguments.tasks or ["grasp"]]
    known = list(dict.fromkeys(kind for task in tasks for kind in task.kinds))
    for kind in arguments.kinds or ():
        if kind not in known:
            raise UnknownNameError("kind of person for these tasks", kind, known)
    scenarios = {}
    for task in tasks:
        kinds = [kind for kind in task.kinds if kind in (arguments.kinds or known)]
        if not kinds:
            warn(f"left out: {task.name}, which has people of the kinds {', '.join(task.kinds)} only")
        for kind in kinds:
            scenario = load_scenario(text=arguments.scenario_text, hand=arguments.hand, task=task.name)
            scenario.kind = kind
            check_scenario(scenario)
            scenarios[arguments.output / task.name / kind] = scenario
    return scenarios


def run_unfinished(arguments: argparse.Namespace, scenarios: "dict[Path, Scenario]") -> None:
    """Runs the unfinished trials of the benchmarks in folders; plans all cases before the first trial."""
    from geort_drake.benchmark import folder
    from geort_drake.benchmark.conditions import ASSUMPTIONS, make_conditions, parse_values
    from geort_drake.benchmark.config import TRIALS
    from geort_drake.benchmark.records import TrialLog, outcome_line
    from geort_drake.benchmark.trials import plan_cases, run_trials
    from geort_drake.benchmark.workers import require_backend, require_workers
    from geort_drake.comparison.retargeters import names_of
    from geort_drake.console import say, track, warn
    from geort_drake.hands.description import load_hand
    from geort_drake.simulation.tasks import find_task

    # Checks the whole request before anything is computed or written.
    first = next(iter(scenarios.values()))
    arguments.methods = arguments.methods or methods_for(first.hand)
    names = names_of(arguments.methods, arguments.trainings)
    require_backend(arguments.backend)
    cases = {path: cases_of(find_task(each.task), arguments.objects) for path, each in scenarios.items()}
    everything = [name for each in scenarios.values() for name in find_task(each.task).cases()]
    for name in arguments.objects or ():
        if name not in everything:
            raise UnknownNameError("object", name, dict.fromkeys(everything))
    side = arguments.side or load_hand(first.hand).side
    conditions: dict[Path, dict[str, Scenario]] = {path: {} for path in scenarios}
    if arguments.sensitivity is not None:
        values = parse_values(arguments.sensitivity, ASSUMPTIONS)
        conditions = {path: make_conditions(each, values, ASSUMPTIONS) for path, each in scenarios.items()}
    recording, notes = folder.read_person(arguments.recording, side, arguments.seed)
    operator = None
    if arguments.operator:
        operator, its_notes = folder.read_person(arguments.operator, side, arguments.seed)
        notes["operator"] = its_notes["recording"]
    with contextlib.ExitStack() as stack:
        ready: list[tuple[TrialLog, folder.Benchmark, list, dict]] = []
        latencies: dict[str, float] = {}
        for path, scenario in scenarios.items():
            log = stack.enter_context(TrialLog(path / TRIALS))
            if log.torn:
                say("The last trial was not written completely and will be repeated.")
            benchmark = folder.open_benchmark(
                path,
                scenario,
                recording,
                arguments.methods,
                cases[path],
                arguments.trials,
                arguments.seed,
                arguments.zero_latency,
                notes,
                conditions[path],
                operator=operator,
                trainings=arguments.trainings,
                latencies=latencies,
            )
            latencies |= {name: latency for name, (_, latency) in benchmark.methods.items()}
            keys = benchmark.keys(names, cases[path], arguments.trials)
            left = log.unfinished(keys)
            say(f"trials: {len(keys)}, already finished: {len(keys) - len(left)}")
            if not left:
                continue
            jobs, backend = min(arguments.jobs, len(left)), arguments.backend
            require_workers(jobs, backend)
            planned = [name for name in cases[path] if any(key.object == name for key in left)]
            plans = plan_cases(benchmark.scenario_text, planned, min(jobs, len(planned)), backend)
            found = dict(track("planning", plans, len(planned), lambda each: each[0]))
            refused = {name: reason for name, reason in found.items() if isinstance(reason, str)}
            for message in refused.values():
                warn(f"left out: {message}")
            folder.note_refused(benchmark, refused)
            ready.append((log, benchmark, [key for key in left if key.object not in refused], found))
        for log, benchmark, left, goals in ready:
            if not left:
                continue  # the hand can do none of the cases
            trials = (benchmark.trial(key, goals[key.object]) for key in left)
            records = run_trials(log, trials, min(arguments.jobs, len(left)), arguments.backend)
            for _ in track("simulating", records, len(left), outcome_line):
                pass


def cases_of(task: "Task", asked: Sequence[str] | None) -> list[str]:
    """Returns the requested cases that the task has, or all of its cases if it has none of those."""
    return [name for name in dict.fromkeys(asked or ()) if name in task.cases()] or task.cases()


def repeat(folder: Path, method: str, object_name: str, seed: int, condition: str = "") -> int:
    """Simulates a finished trial again and records it; raises BenchmarkError if the outcome differs."""
    from geort_drake.benchmark.folder import code_has_changed, repeat_trial
    from geort_drake.benchmark.records import TrialKey
    from geort_drake.benchmark.tasks import write_task_report
    from geort_drake.console import progress_bar, say, warn

    if code_has_changed(folder):
        warn("the simulation code has changed since this trial; the outcome may differ")
    with progress_bar() as display, display.spinner("simulating"):
        record, path = repeat_trial(folder, TrialKey(method, object_name, seed, condition))
    if "error" in record:
        say(record["error"])
        return 1
    write_task_report(folder)  # now with a link to the recording
    finish({"Same outcome": record["outcome"]}, view(path))
    return 0

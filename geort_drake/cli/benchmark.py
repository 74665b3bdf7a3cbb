"""The command that compares methods by tasks in simulation."""

import copy
import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from geort_drake.cli.base import (
    COUNT,
    SEED,
    Command,
    Json,
    ScenarioOptions,
    Seed,
    Side,
    finish,
    methods_epilog,
    options,
    require_output_folder,
    write_json,
)
from geort_drake.cli.simulate import DEFAULT_OBJECTS
from geort_drake.errors import UnknownNameError, UsageError
from geort_drake.simulation.tasks import task_names

if TYPE_CHECKING:
    from geort_drake.benchmark.run import Benchmark as TrialBenchmark
    from geort_drake.benchmark.run import Variant
    from geort_drake.simulation.scenario import Scenario

# Methods that need no training.
QUICK_METHODS = ("universal", "anyteleop", "dexpilot", "hold")
_TASKS = arg(metavar="NAME ...", help=f"tasks: {', '.join(task_names())} (default: grasp)")


@options
class Benchmark(Command, ScenarioOptions):
    """Compare retargeting methods by what simulated people do through them, such as grasps.

    Simulated people do every task through every method, with the same objects, people and seeds, and thus
    with the same placements and noise. The same command resumes an interrupted benchmark, and adds methods,
    objects, people and trials to a finished one. It writes trials.jsonl (one row per finished trial) and
    report.md to --output.

    Exit codes: 0 success; 1 a trial raised an error; 2 the input is invalid.
    """

    output: Annotated[Path, arg(metavar="DIR")] = Path("runs/benchmark")
    """folder for the results"""
    tasks: Annotated[tuple[str, ...], _TASKS] = ()
    kinds: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """kinds of simulated people: servo, mimicry, adaptive (default: the scenario's; with --tasks, all)"""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """methods listed above, maps or Python files; the first is the reference (default: all)"""
    objects: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """objects to grasp (default: all)"""
    persons: Annotated[tuple[int, ...], arg(metavar="N ..."), SEED] = ()
    """people of the population, by number; 0 has the hand of --recording (default: the scenario's)"""
    trials: Annotated[int | None, arg(metavar="N"), COUNT] = None
    """trials per method, object and person (default: 30)"""
    trainings: Annotated[int, arg(metavar="N"), COUNT] = 1
    """number of trainings of each trained method, with successive seeds; each does all trials"""
    quick: bool = False
    """small benchmark that takes two to five minutes on two cores"""
    jobs: Annotated[int | None, arg(metavar="N"), COUNT] = None
    """number of parallel trials (default: the number of processors)"""
    measure_latency: bool = False
    """simulate every method with the latency that is measured on this machine, instead of the scenario's"""
    recording: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of the person's hand (default: an average adult's)"""
    operator: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of the person who operates, such as another session or person (default: --recording)"""
    vary: Annotated[tuple[str, ...], arg(metavar="FIELD=V1,V2 ...")] = ()
    """repeat the trials with one field of the scenario changed, such as operator.visual_delay=0,0.1,0.3"""
    side: Side | None = None
    """side of the recorded hand (default: the robot hand's)"""
    seed: Seed = 0
    """seed of training, and of the play on which to train without a recording"""
    submit: Annotated[str | None, arg(metavar="METHOD")] = None
    """add a method to the benchmark in --output, with its people, objects, seeds and settings"""
    report: bool = False
    """only rewrite the report in --output"""
    json: Json = None

    epilog = staticmethod(methods_epilog)

    def run(self) -> int:
        require_output_folder(self.output, "trials.jsonl")
        if self.submit:
            for name in ("methods", "objects", "trials", "persons", "quick", "recording", "operator", "vary"):
                if getattr(self, name):
                    raise UsageError(f"--submit runs one method as --output states; leave out --{name}")
            self._simulate(*stored_benchmark(self.output, [self.submit]))
        elif not self.report:
            self._simulate(*self._open())
        return self._print_report()

    @property
    def _count(self) -> int:
        return self.trials or (2 if self.quick else 30)

    @property
    def _cases(self) -> list[str]:
        return list(self.objects or (DEFAULT_OBJECTS if self.quick else ()))

    def _open(self) -> "tuple[TrialBenchmark, list[str]]":
        """Opens the benchmark that the options describe; returns it with the names of their methods.

        Checks the whole request before anything is computed or written.
        """
        from geort_drake import Hand
        from geort_drake.benchmark.run import Benchmark, Settings
        from geort_drake.methods import methods_for, names_of
        from geort_drake.simulation.tasks import find_task

        scenarios = self._scenarios()
        first = next(iter(scenarios.values()))
        objects = self._cases
        known_cases = dict.fromkeys(
            itertools.chain.from_iterable(find_task(variant.task).cases() for variant in scenarios)
        )
        for name in objects:
            if name not in known_cases and not self.quick:
                raise UnknownNameError("object", name, known_cases)
        hand = Hand(first.hand)
        names = names_of(self.methods or (QUICK_METHODS if self.quick else methods_for(hand)), hand)
        recording, operator = (
            None if path is None else str(path.resolve()) for path in (self.recording, self.operator)
        )
        settings = Settings(
            recording=recording,
            operator=operator,
            side=self.side or hand.description.side,
            seed=self.seed,
            measure_latency=self.measure_latency,
            persons=list(self.persons) or [first.person],
            objects=objects,
            trials=self._count,
            trainings=self.trainings,
        )
        return Benchmark(self.output, settings, scenarios, names), list(names)

    def _scenarios(self) -> "dict[Variant, Scenario]":
        """Returns the scenarios of the requested tasks and kinds of people, and of --vary.

        Raises:
            UnknownNameError: there is no such task or kind.
            ScenarioError: a scenario's text does not fit a task.
        """
        from geort_drake import load_scenario
        from geort_drake.benchmark.run import Variant, vary
        from geort_drake.simulation.person.engine import KINDS
        from geort_drake.simulation.scenario_files import check_scenario
        from geort_drake.simulation.tasks import find_task

        if self.tasks:
            bases = [
                load_scenario(text=self.scenario_text, hand=self.hand, task=find_task(name).name)
                for name in self.tasks
            ]
        else:
            bases = [self.load_scenario()]
        scenarios: dict[Variant, Scenario] = {}
        for base in bases:
            for kind in self.kinds or (KINDS if self.tasks else [base.kind]):
                scenario = copy.deepcopy(base)
                scenario.kind = kind
                check_scenario(scenario)
                scenarios[Variant(base.task, kind)] = scenario
                for condition, variant in vary(scenario, self.vary).items():
                    scenarios[Variant(base.task, kind, condition)] = variant
        return scenarios

    def _simulate(self, benchmark: "TrialBenchmark", methods: Sequence[str]) -> None:
        """Runs the unfinished trials of some methods; plans all cases before the first trial."""
        from geort_drake.benchmark.log import TrialLog, key_of
        from geort_drake.console import say, track, warn

        settings, jobs = benchmark.settings, self.jobs or os.cpu_count() or 1
        is_new = not self.submit
        with TrialLog(benchmark.folder) as log:
            keys = benchmark.keys(
                methods,
                self._cases if is_new else settings.objects,
                (self.persons if is_new else None) or settings.persons,
                self._count if is_new else settings.trials,
            )
            unfinished = log.unfinished(keys)
            say(f"trials: {len(keys)}, already finished: {len(keys) - len(unfinished)}")
            if not unfinished:
                return
            cases = len({(key[2:5], key.object) for key in unfinished})
            for _ in track("planning", benchmark.plan(unfinished, jobs), cases, str):
                pass
            for case, reason in settings.refused.items():
                warn(f"left out: {case}: {reason}")
            unfinished = [key for key in unfinished if f"{key.task} {key.object}" not in settings.refused]
            rows = benchmark.run(log, unfinished, jobs)
            for _ in track(
                "simulating", rows, len(unfinished), lambda row: f"{key_of(row)}: {_outcome(row)}"
            ):
                pass

    def _print_report(self) -> int:
        """Writes and prints the report; returns the exit code."""
        from geort_drake.benchmark.report import REPORT, write_report
        from geort_drake.console import print_table, warn

        report = write_report(self.output)
        rows = [
            [task, condition or kind, row["method"], str(row["trials"]), row["success"].text(),
             row["time"].text("{:.1f}", 1.0), row["difference"].text("{:+.0f}")]
            for (task, kind, condition), figures in report.tables.items()
            for row in figures.to_dict("records")
        ]  # fmt: skip
        headings = ("task", "person", "method", "trials", "success, %", "time, s", "difference")
        caption = (
            "with 95 % intervals; time: a failure counts as the timeout; difference: success minus that of "
            "the first method"
        )
        print_table(headings, rows, "Benchmark", caption, text=("person", "method"))
        if report.errors:
            warn(f"trials that raised an error: {report.errors}; see report.md")
        write_json(self.json, report.to_json())
        finish({"Report": self.output / REPORT})
        return 1 if report.errors else 0


def stored_benchmark(folder: Path, methods: Sequence[str]) -> "tuple[TrialBenchmark, list[str]]":
    """Opens a folder's benchmark as its settings state, with some methods, and returns both.

    Raises:
        BenchmarkError, ScenarioError: the folder contains no benchmark.
    """
    from geort_drake import Hand
    from geort_drake.benchmark.run import Benchmark, read_scenarios, read_settings
    from geort_drake.methods import names_of

    settings, scenarios = read_settings(folder), read_scenarios(folder)
    sources = {name: entry["source"] for name, entry in settings.methods.items()}
    hand = Hand(next(iter(scenarios.values())).hand)
    names = {name: sources[name] for name in methods if name in sources}
    names |= names_of([name for name in methods if name not in sources], hand)
    return Benchmark(folder, settings, scenarios, names), list(names)


def _outcome(row: dict) -> str:
    return "error" if "error" in row else row["outcome"]

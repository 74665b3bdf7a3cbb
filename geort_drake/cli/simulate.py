"""Commands that simulate trials of a task, and write results and recordings."""

import contextlib
import copy
import dataclasses
import json as json_format
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from geort_drake.cli.base import (
    COUNT,
    Command,
    Json,
    ScenarioOptions,
    Seed,
    Side,
    command,
    finish,
    methods_epilog,
    options,
    require_output_folder,
    view,
    write_json,
)
from geort_drake.errors import ScenarioError
from geort_drake.resources import object_names
from geort_drake.simulation.tasks import task_names

if TYPE_CHECKING:
    from geort_drake import Recording
    from geort_drake.simulation.scenario import Scenario
    from geort_drake.simulation.task import TrialResult
    from geort_drake.simulation.trial import Trial, TrialBuilder

# Grasped if neither --objects nor the scenario names an object.
DEFAULT_OBJECTS = ("cylinder", "sphere", "cube")
_OBJECTS = (
    f"objects to grasp, of {', '.join(object_names())}, or cases of another task (default: the scenario's "
    f"object, or {' '.join(DEFAULT_OBJECTS)} if it has none; for other tasks, all cases)"
)


@options
class Grasp(Command, ScenarioOptions):
    """Let a simulated person grasp objects with a robot hand.

    Without arguments, the person grasps three objects with a Panda and an Allegro hand, through the universal
    map, and a table shows the outcomes. A method that needs training is first trained on the person's hand
    motion. The output folder gets results.json, the scenario, and for each trial a Rerun recording (.rrd) and
    the motion of the person's hand and wrist (.npz). They replace the files of an earlier run.
    """

    output: Annotated[Path, arg(metavar="DIR")] = Path("runs/grasp")
    """folder for the results"""
    objects: Annotated[tuple[str, ...], arg(metavar="NAME ...", help=_OBJECTS)] = ()
    trials: Annotated[int, arg(metavar="N"), COUNT] = 1
    """trials per object, each with its own seed"""
    recording: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of the person's hand (default: an average adult's)"""
    side: Side | None = None
    """side of the recorded hand (default: the robot hand's)"""
    retargeter: Annotated[str | None, arg(metavar="NAME")] = None
    """method listed above, map or Python file (default: universal if the hand has a map, else geort)"""
    device: Literal["cpu", "cuda"] = "cpu"
    """where to train"""
    seed: Seed = 0
    """seed of training, and of the play on which to train without a recording"""
    replay: Annotated[Path | None, arg(metavar="FILE")] = None
    """replay this recording, with its wrist poses, instead of the simulated person; a session is replayed
    with its own task, object and seed"""
    rerun: bool = True
    """write no Rerun recordings"""  # help of the flag --no-rerun
    json: Json = None

    epilog = staticmethod(methods_epilog)

    def _base(self) -> "Scenario":
        """Returns the scenario of the trials before their object and seed are chosen."""
        return self.load_scenario()

    def run(self) -> int:
        from geort_drake import Hand, __version__
        from geort_drake.console import say
        from geort_drake.export.episode import RESULTS
        from geort_drake.methods import default_method, is_own, names_of, resolve
        from geort_drake.retargeting.train import training_recording
        from geort_drake.simulation.trial import Trial, TrialBuilder

        # Checks the whole request before anything is computed or written.
        base, replay = self._request()
        scenarios = self.scenarios_of(base, replay)
        require_output_folder(self.output, RESULTS)
        hand = Hand(base.hand)
        method = self.retargeter or default_method(hand)
        names_of([method], hand)  # refuses an unusable one
        side = self.side or hand.description.side
        recording = training_recording(self.recording, side) if self.recording else None

        # Plans before training, because planning shows whether the robot can grasp the objects at all; but a
        # user's own method is examined at once.
        own = resolve(method, hand, recording) if is_own(method) else None
        builder = TrialBuilder(hand, recording)
        if replay is None:
            scenarios = _feasible(builder, scenarios)
        retarget, path = own or resolve(method, hand, recording, self.seed, self.device)
        person = str(self.recording or "an average adult")
        say(f"Person:     {person}")
        say(f"Retargeter: {_origin(method, retarget, path)}")
        session = replay.metadata if replay else {}
        properties = {"method": method, "hand": hand.description.name}
        if path is not None and (info := getattr(retarget, "info", None)) is not None:
            properties |= {"map": str(path), "method": info.get("method", method)}
        properties |= {f"session_{name}": json_format.dumps(value) for name, value in session.items()}
        report = {
            "version": __version__,
            "person": person,
            "recording_sha256": recording.digest if recording else None,
            "retargeter": str(path or method),
            "session": session,
        }
        trials = [
            Trial(scenario, retarget, replay) if replay else builder.trial(scenario, retarget)
            for scenario in scenarios
        ]
        results = self._simulate(trials, properties, report)
        self._print_results(results)
        write_json(self.json, report)
        finish({"Results": self.output / RESULTS}, view(self.output, "/*.rrd") if self.rerun else None)
        return 0

    def _simulate(
        self, trials: "Sequence[Trial]", properties: dict[str, str], report: dict[str, Any]
    ) -> "list[TrialResult]":
        """Simulates the trials, and writes their files and the `report`."""
        from geort_drake import run_trial
        from geort_drake.console import progress_bar
        from geort_drake.export.episode import RESULTS
        from geort_drake.files import locked
        from geort_drake.simulation.tasks import find_task

        results: list[TrialResult] = []
        with locked(self.output), progress_bar() as display:
            update = display.counter("simulating")
            for done, trial in enumerate(trials):
                scenario = trial.scenario
                stem = f"{find_task(scenario.task).case_of(scenario)}-{scenario.random_seed}"

                def show(t: float, done: int = done, stem: str = stem) -> None:
                    update(done, len(trials), f"{stem}: {t:.1f} s simulated")

                # The recording of an interrupted trial stays here, so that it never replaces a complete one.
                draft = self.output / "interrupted" / f"{stem}.rrd"
                draft.unlink(missing_ok=True)
                path = draft if self.rerun else None
                result, glove = run_trial(scenario, trial.retarget, trial.human, path, properties, show)
                if not results:
                    _replace_run(self.output, scenario)
                _keep_recording(draft, self.output)
                glove.save(self.output / f"{stem}.glove.npz")
                results.append(result)
                # Written after each trial, so that an interrupted run keeps the finished ones.
                report |= {
                    "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                    "successes": sum(result.success for result in results),
                    "trials": [result.to_json() for result in results],
                }
                write_json(self.output / RESULTS, report)
            update(len(trials), len(trials))
        return results

    def _print_results(self, results: "Sequence[TrialResult]") -> None:
        from geort_drake.console import print_table, say
        from geort_drake.simulation.tasks.grasp import explain

        grasps = all(result.task == "grasp" for result in results)
        rows = [_row(result) for result in results]
        if grasps:
            columns = ("object", "seed", "outcome", "held from", "attempts", "height", "force", "speed")
            caption = (
                "held from: start of the successful hold; height, force: largest; speed: times real time"
            )
        else:
            columns = ("case", "seed", "outcome", "done after", "attempts", "score", "force", "speed")
            caption = "force: largest; speed: times real time"
        title = "Grasps" if grasps else "Trials"
        print_table(columns, rows, title=title, caption=caption, text=("outcome",))
        successes = sum(result.success for result in results)
        say(f"{successes} of {len(results)} {'held' if grasps else 'succeeded'}")
        for result in results:
            if not result.success:
                where = f"; watch {result.object}-{result.seed}.rrd" if self.rerun else ""
                say(f"{result.object}, seed {result.seed}: {explain(result.outcome)}{where}")

    def scenarios_of(self, base: "Scenario", replay: "Recording | None" = None) -> "list[Scenario]":
        """Returns a scenario per trial, from `base`; a session sets its own object, seed and timeout."""
        from geort_drake.simulation.scenario_files import check_scenario, names_object
        from geort_drake.simulation.tasks import find_task
        from geort_drake.simulation.tasks.grasp import GraspSettings

        task = find_task(base.task)
        objects = self.objects or (DEFAULT_OBJECTS if base.task == "grasp" else task.cases())
        of_scenario = self.scenario_file, self.scenario_name, self.scenario_text
        if not self.objects and base.task == "grasp" and names_object(*of_scenario):
            objects = [base.object.name]
        facts = replay.metadata if replay else {}
        if replay and not self.objects and "object" in facts and facts.get("task", base.task) == base.task:
            objects = [facts["object"]]
            base.random_seed = int(facts.get("seed", base.random_seed))
            hold_time = getattr(task.settings_of(base), "hold_time", GraspSettings.hold_time)
            base.timeout = float(replay.t[-1] - replay.t[0]) + hold_time
        scenarios = []
        for name in objects:
            for trial in range(self.trials):
                scenario = copy.deepcopy(base)
                task.choose(scenario, name)
                scenario.random_seed = base.random_seed + trial
                check_scenario(scenario)
                scenarios.append(scenario)
        return scenarios

    def _request(self) -> "tuple[Scenario, Recording | None]":
        """Returns the scenario and the recording of --replay, which needs wrist poses to move the base.

        A session of another task uses that task's scenario, unless an option selects one.
        """
        from geort_drake import load_hand, load_scenario, read_recording
        from geort_drake.simulation.tasks import find_task

        base = self._base()
        name, path = self.scenario_name, self.replay
        if path is None:
            if base.fixed_base and find_task(base.task).objects:  # an object to go to
                raise ScenarioError(
                    f"scenario '{name}': the person cannot do the task '{base.task}' with a fixed base; "
                    "give a --replay"
                )
            return base, None
        replay = read_recording(path, self.side or load_hand(base.hand).side)
        task, is_chosen = replay.metadata.get("task", base.task), getattr(self, "task", None) is not None
        if task != base.task and not is_chosen and self.scenario_file is None and name == "Grasp":
            base = load_scenario(text=self.scenario_text, hand=self.hand, task=task)
        if base.fixed_base:
            return base, dataclasses.replace(replay, X_WH=None)  # the base cannot follow the wrist
        if replay.X_WH is None:
            raise ScenarioError(
                f"{path}: a replay needs wrist poses (X_WH); this recording has none; use "
                "--scenario-name Fixed to keep the hand in place"
            )
        return base, replay


_TASK_HELP = f"one of {', '.join(task_names())} (default: grasp, or that of the session to replay)"


@options
class Simulate(Grasp):
    """Let a simulated person do any task with a robot hand.

    The command does what `geort-drake grasp` does, for any task of the benchmark and any kind of simulated
    person.
    """

    task: Annotated[str | None, arg(metavar="NAME", help=_TASK_HELP)] = None
    kind: Literal["servo", "mimicry", "adaptive"] | None = None
    """kind of simulated person (default: the scenario's)"""
    output: Annotated[Path, arg(metavar="DIR")] = Path("runs/simulate")
    """folder for the results"""

    def _base(self) -> "Scenario":
        from geort_drake import load_scenario
        from geort_drake.simulation.scenario_files import check_scenario

        if self.scenario_file is None and self.scenario_name == "Grasp":
            base = load_scenario(text=self.scenario_text, hand=self.hand, task=self.task or "grasp")
        else:
            base = self.load_scenario()
        if self.kind is not None:
            base.kind = self.kind
            check_scenario(base)
        return base


def try_out(retargeter: Path, hand: str, recording: Path | None = None) -> str:
    """Formats a command that tries a retargeter: `grasp` if the hand can, else `explore`.

    Args:
        retargeter: the map's file.
        hand: name or description file.
        recording: recording on which the retargeter was trained.
    """
    from geort_drake import load_hand
    from geort_drake.simulation.plan.contacts import GRIPS, grip_of

    fingers = {*load_hand(hand).finger_names}
    graspable = any(fingers.issuperset(GRIPS[grip_of(name)]) for name in DEFAULT_OBJECTS)
    options = {"recording": recording, "hand": None if hand == "allegro_right" else hand}
    if graspable:
        return command("grasp", retargeter=retargeter, **options)
    return command("explore", methods=retargeter, **options)


def _feasible(builder: "TrialBuilder", scenarios: "Sequence[Scenario]") -> "list[Scenario]":
    """Returns the scenarios for which there are plans; leaves out, with a warning, those of other cases.

    Raises:
        ScenarioError: the hand can do none of the cases.
    """
    from geort_drake.console import track, warn
    from geort_drake.simulation.tasks import find_task

    cases = [find_task(scenario.task).case_of(scenario) for scenario in scenarios]
    names = list(dict.fromkeys(cases))
    first = dict(zip(reversed(cases), reversed(scenarios), strict=True))
    errors = {}
    for name in track("planning", names, len(names)):
        try:
            builder.plans(first[name])
        except ScenarioError as error:
            errors[name] = error
    if len(errors) == len(names):
        raise errors[names[0]]
    for reason in errors.values():
        warn(f"left out: {reason}")
    return [scenario for case, scenario in zip(cases, scenarios, strict=True) if case not in errors]


def _origin(method: str, retarget: Any, path: Path | None) -> str:
    """Returns where a retargeter comes from, for the user."""
    from geort_drake.own_method import OwnMethod
    from geort_drake.retargeting.universal import UniversalRetargeter

    if path is None:
        return f"{method} (needs no training)"
    if isinstance(retarget, OwnMethod):
        return f"{path} (own method)"
    return f"{path} (universal)" if isinstance(retarget, UniversalRetargeter) else str(path)


def _replace_run(folder: Path, scenario: "Scenario") -> None:
    """Removes an earlier run's results and files of trials, which had another scenario; writes the new one.

    It is the first trial's; object and seed of the others are in the results.
    """
    from geort_drake.export.episode import RESULTS, SCENARIO
    from geort_drake.files import write_text
    from geort_drake.simulation.scenario import dump_scenario

    results = folder / RESULTS
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # no results, or damaged ones
        names = {
            f"{trial['object']}-{trial['seed']}"
            for trial in json_format.loads(results.read_bytes())["trials"]
        }
        for path in (path for kind in (".rrd", ".parquet", ".glove.npz") for path in folder.glob(f"*{kind}")):
            if path.name.partition(".")[0] in names:
                path.unlink()
    results.unlink(missing_ok=True)
    write_text(folder / SCENARIO, dump_scenario(scenario))


def _keep_recording(draft: Path, folder: Path) -> None:
    """Moves a complete trial's recording and table to its folder; without them, removes an earlier run's."""
    for file in (draft, draft.with_suffix(".parquet")):
        target = folder / file.name
        target.unlink(missing_ok=True)
        if file.exists():
            file.replace(target)
    with contextlib.suppress(OSError):  # the folder may contain other files
        draft.parent.rmdir()


def _row(result: Any) -> tuple[str, ...]:
    return (
        result.object,
        str(result.seed),
        f"[{'green' if result.success else 'red'}]{result.outcome}[/]",
        "–" if result.completion_time is None else f"{result.completion_time:.1f} s",
        "–" if result.attempts is None else str(result.attempts),
        f"{100 * result.metrics['peak_height']:.0f} cm" if result.task == "grasp" else f"{result.score:.2f}",
        f"{result.peak_force:.0f} N",
        f"{result.simulated_time / result.wall_time:.1f} ×",
    )

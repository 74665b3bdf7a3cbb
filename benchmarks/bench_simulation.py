"""Times a grasp trial against real time: with everything, without recording, and each system's share.

python benchmarks/bench_simulation.py --json simulation.json

Several copies of the same trial are simulated in turns of a quarter of a simulated second. Speeds are per CPU
time of the thread, for each turn and in total. Rows:
  everything on   arm, hand, object, contact, operator, retargeting, inverse kinematics, monitor, recording
  no recording    the same without the Rerun recorder; the reference of the ratios
  half the step   everything on at half the time step, which changes the course of the trial
  replay          the recorded motion of hand and wrist in place of the simulated person, at both steps
  robot alone     the trial's joint targets from a Drake source, without any system in Python
Shares are from another simulation in which each Python system is timed without its calls of other systems and
without reading its ports, for which Drake computes poses and contacts that its next step uses, too. The time
of the timers is subtracted. The rest is Drake: dynamics, contact and the framework.
"""

import argparse
import inspect
import itertools
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, InputPort
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from rich.table import Table
from side_by_side import parse, write_json

from geort_drake.console import console, run_main
from geort_drake.hands.assembly import remove_visuals
from geort_drake.hands.description import load_hand
from geort_drake.hands.hand import Hand
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting.store import load_retargeter
from geort_drake.retargeting.train import cached_map
from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks.grasp import GraspPhase
from geort_drake.simulation.trial import run_trial
from geort_drake.simulation.world import ARM, HAND, add_placed_object, add_robot, finalize

TURN = 0.25  # simulated s
RECORDED, PLAIN, FINER = "everything on", "no recording", "everything on, half the step"
REPLAYED, REPLAYED_FINER, ROBOT = "replay", "replay, half the step", "robot alone"
MODELS = (ARM, HAND)


def main(argv: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], epilog=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    options.add_argument("--object", default="cylinder", help="object to grasp (default: %(default)s)")
    options.add_argument("--retargeter", type=Path, help="map (default: trained on synthetic play)")
    options.add_argument(
        "--seconds", type=float, default=25.0, help="longest simulated time, s (default: %(default)s)"
    )
    options.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parse(options, argv)
    make = Maker(arguments.object, arguments.retargeter)
    fine = Scenario().plant_config.time_step / 2
    with tempfile.TemporaryDirectory() as folder:
        paths = (Path(folder) / f"{number}.rrd" for number in itertools.count())
        session = make.session()
        trials: dict[str, Trial | RobotAlone] = {
            RECORDED: make(rerun_path=next(paths)),
            PLAIN: make(),
            FINER: make(fine, next(paths)),
            REPLAYED: make(rerun_path=next(paths), session=session),
            REPLAYED_FINER: make(fine, next(paths), session),
            ROBOT: make.robot_alone(),
        }
        _advance(trials, arguments.seconds)
        started = time.thread_time()
        trials[RECORDED].parts.recorder.close()
        writing = time.thread_time() - started
        for name in (FINER, REPLAYED, REPLAYED_FINER):
            trials[name].parts.recorder.close()
        # Last, because it changes the systems' classes.
        kinds = {type(system) for system in _systems(trials[RECORDED].parts.diagram)}
        shares = _shares(kinds, lambda: make(rerun_path=next(paths)), arguments.seconds)
    _report(trials, shares, writing, arguments.json)
    return 0


class Trial:
    """A trial that is advanced in turns."""

    def __init__(self, parts: TrialDiagram):
        self.parts = parts
        self.simulator = Simulator(parts.diagram)
        parts.initialize(self.simulator.get_mutable_context())
        # Per turn: simulated time, s, CPU time, s, and the phase of the grasp at its end.
        self.simulated: list[float] = []
        self.cpu: list[float] = []
        self.phases: list[str] = []

    def advance(self, until: float) -> None:
        """Simulates up to `until`, s, unless the trial is over."""
        root = self.simulator.get_context()
        if self.parts.stage.outcome(root).over:
            return
        before, started = root.get_time(), time.thread_time()
        self.simulator.AdvanceTo(until)  # the judge may end it earlier
        self.cpu.append(time.thread_time() - started)
        self.simulated.append(root.get_time() - before)
        self.phases.append(GraspPhase(self.parts.stage.outcome(root).phase).name)


class RobotAlone:
    """The robot and object of a trial, driven by Drake along recorded joint targets."""

    def __init__(self, scenario: Scenario, t: Sequence[float], targets: Mapping[str, Sequence[np.ndarray]]):
        """`t` (T,) are times, s; `targets` are the desired states (T, 2n) of each model at these times."""
        builder = DiagramBuilder()
        rng = np.random.default_rng(scenario.random_seed)
        description = load_hand(scenario.hand)
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        add_robot(plant, scenario, description)
        body, _, _ = add_placed_object(plant, scene_graph, scenario, description, rng)
        finalize(plant, scenario, description, body.model_instance())
        for name, states in targets.items():
            source = TrajectorySource(PiecewisePolynomial.ZeroOrderHold(t, np.transpose(states)))
            model = plant.GetModelInstanceByName(name)
            builder.Connect(
                builder.AddSystem(source).get_output_port(), plant.get_desired_state_input_port(model)
            )
        self._simulator, self._end = Simulator(builder.Build()), t[-1]
        remove_visuals(plant, scene_graph, self._simulator.get_mutable_context())
        self.simulated: list[float] = []
        self.cpu: list[float] = []
        self.phases = [""]

    def advance(self, until: float) -> None:
        """Simulates up to `until`, s, unless the targets are over."""
        before = self._simulator.get_context().get_time()
        if before < self._end:
            started = time.thread_time()
            self._simulator.AdvanceTo(min(until, self._end))
            self.cpu.append(time.thread_time() - started)
            self.simulated.append(min(until, self._end) - before)


class Maker:
    """Makes simulations of the same trial."""

    def __init__(self, object_name: str, retargeter: Path | None):
        self._object = object_name
        scenario, play = _scenario(object_name), synthesize_play(seed=0)
        description = load_hand(scenario.hand)
        hand = Hand(description)
        self._retarget = load_retargeter(retargeter, hand) if retargeter else cached_map(hand, play)[0]
        self._human = HumanHand.fit(play), GraspPlanner(scenario, description).plans(2)[0]

    def __call__(
        self, step: float | None = None, rerun_path: Path | None = None, session: Recording | None = None
    ) -> Trial:
        human = session or self._human
        return Trial(make_trial_diagram(_scenario(self._object, step), self._retarget, human, rerun_path))

    def session(self) -> Recording:
        """Returns the recording of the person's hand in the trial."""
        return run_trial(_scenario(self._object), self._retarget, self._human)[1]

    def robot_alone(self) -> RobotAlone:
        """Returns the trial's robot and object, with joint targets from a trial that it simulates first."""
        trial = self()
        plant, t = trial.parts.plant, []
        ports = {
            name: plant.get_desired_state_input_port(plant.GetModelInstanceByName(name)) for name in MODELS
        }
        targets: dict[str, list[np.ndarray]] = {name: [] for name in MODELS}

        def log(root: Context) -> EventStatus:
            if not t or root.get_time() > t[-1]:
                t.append(root.get_time())
                for name, port in ports.items():
                    targets[name].append(port.Eval(plant.GetMyContextFromRoot(root)).copy())
            return EventStatus.Succeeded()

        trial.simulator.set_monitor(log)
        trial.simulator.AdvanceTo(_scenario(self._object).timeout)
        return RobotAlone(_scenario(self._object), t, targets)


def _scenario(name: str, step: float | None = None) -> Scenario:
    plant_config = "" if step is None else f", plant_config: {{time_step: {step}}}"
    return load_scenario(text=f"{{object: {{name: {name}}}{plant_config}}}")


def _shares(kinds: set[type], make: Callable[[], Trial], seconds: float) -> dict[str, float]:
    """Returns each kind of system's share of the CPU time of a simulation, and Drake's, the rest."""
    _calibrate()
    spent: dict[str, float] = defaultdict(float)
    for kind in kinds:
        _time_callbacks(kind, spent)
    InputPort.Eval = _timed(InputPort.Eval, "read ports", spent)
    # Made only now, because systems declare their callbacks when they are made.
    trial = make()
    _advance({"timed": trial}, seconds)
    trial.parts.recorder.close()
    total = sum(trial.cpu) - spent.pop("timers")
    read = spent.pop("read ports") / total
    shares = {name: own / total for name, own in sorted(spent.items(), key=lambda item: -item[1])}
    return shares | {"Drake": 1 - sum(shares.values()), "of which for read ports": read}


def _systems(diagram: Diagram) -> Iterator:
    """Yields this package's systems in a diagram and its subdiagrams."""
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            yield from _systems(system)
        elif type(system).__module__.startswith("geort_drake."):
            yield system


_inner: list[float] = []
# CPU time that a timer adds inside and outside of the measured time, s; see `_calibrate`.
_cost = [0.0, 0.0]


def _time_callbacks(kind: type, spent: dict[str, float]) -> None:
    """Times a class's methods that take a context, without the time of other such methods in them."""
    for base in kind.__mro__:
        if base.__module__.startswith("geort_drake."):
            for name, function in list(vars(base).items()):
                if inspect.isfunction(function) and not hasattr(kind, f"_{name}_is_timed"):
                    if list(inspect.signature(function).parameters)[1:2] == ["context"]:
                        setattr(kind, name, _timed(function, kind.__name__, spent))
                        setattr(kind, f"_{name}_is_timed", True)


def _timed(function: Callable, name: str, spent: dict[str, float]) -> Callable:
    """Returns a function that adds its time, without that of timed functions in it, to `spent[name]`."""

    def wrapper(*args, **kwargs):
        _inner.append(0.0)
        started = time.thread_time()
        try:
            return function(*args, **kwargs)
        finally:
            whole = time.thread_time() - started - _cost[0]
            spent[name] += whole - _inner.pop()
            spent["timers"] += sum(_cost)
            if _inner:
                _inner[-1] += whole + sum(_cost)

    return wrapper


def _calibrate(count: int = 100_000) -> None:
    spent: dict[str, float] = defaultdict(float)
    empty = _timed(lambda: None, "empty", spent)
    started = time.thread_time()
    for _ in range(count):
        empty()
    whole = (time.thread_time() - started) / count
    _cost[:] = spent["empty"] / count, whole - spent["empty"] / count


def _advance(trials: Mapping[str, Trial | RobotAlone], seconds: float) -> None:
    for turn in range(1, round(seconds / TURN) + 1):
        for trial in trials.values():
            trial.advance(turn * TURN)


def _report(
    trials: Mapping[str, Trial | RobotAlone], shares: Mapping[str, float], writing: float, path: Path | None
) -> None:
    table = Table(title="simulated s per s of one core")
    ratio_heading = f"CPU over '{PLAIN}' (p5 – p95)"
    for heading in ("", "median", "p5 – p95", "in all", ratio_heading, "turns", "last phase"):
        table.add_column(heading, justify="right" if heading else "left")
    results = {}
    speeds = {name: np.divide(trial.simulated, trial.cpu) for name, trial in trials.items()}
    for name, trial in trials.items():
        both = min(len(speeds[name]), len(speeds[PLAIN]))
        ratio = speeds[PLAIN][:both] / speeds[name][:both]
        whole = sum(trial.simulated) / sum(trial.cpu)
        results[name] = {
            "speed": _spread(speeds[name]),
            "speed_in_all": whole,
            "ratio": _spread(ratio),
            "cpu_s": trial.cpu,
            "phases": trial.phases,
        }
        s, r = results[name]["speed"], results[name]["ratio"]
        table.add_row(
            name,
            f"{s['median']:.2f} ×",
            f"{s['p5']:.2f} – {s['p95']:.2f}",
            f"{whole:.2f} ×",
            f"{r['median']:.3f} ({r['p5']:.3f} – {r['p95']:.3f})",
            str(len(trial.cpu)),
            trial.phases[-1],
        )
    console.print(table)
    table = Table(title="share of the CPU time")
    table.add_column("system")
    table.add_column("share", justify="right")
    for name, share in shares.items():
        table.add_row(name, f"{100 * share:.1f} %")
    console.print(table)
    simulated = sum(trials[RECORDED].simulated)
    console.print(f"writing the recording of {simulated:g} s: {writing:.2f} s of CPU time")
    if path:
        write_json(path, title="simulation", results=results, shares=shares, writing_cpu_s=writing)


def _spread(values: np.ndarray) -> dict[str, float]:
    p5, median, p95 = np.percentile(values, [5, 50, 95])
    return {"median": float(median), "p5": float(p5), "p95": float(p95)}


if __name__ == "__main__":
    run_main(main)

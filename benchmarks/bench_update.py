"""Times one update of RetargetingSystem against the bare retargeting call in it, in turns.

python benchmarks/bench_update.py --json update.json

Every function gets the frames of the same motion in order, one per period. Rows:
  call          the bare retargeter on a whole hand; the reference of the ratios
  update        writing the input port, the system's update through Drake, and setting its new state
  and status    the same, and reading the status
  ports alone   `update` of a system that computes nothing, with ports and states of the same sizes
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem
from side_by_side import measure, parse, parser, report
from untrained import FINGERS, add_form_option, untrained

from geort_drake.console import run_main
from geort_drake.hands.hand import Hand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting.clouds import trained_points
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.retargeting_system import RetargetingSystem

PERIOD = 0.01


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    add_form_option(options)
    arguments = parse(options, argv)
    retarget = untrained(arguments.method)
    hands = synthesize_play(seed=0, duration_s=60.0, rate_hz=1 / PERIOD).p_HK.astype(float)
    keypoints = [FINGERS[name] for name in retarget.finger_names]
    retarget.trained_points = trained_points(hands[:, keypoints])
    robot = Hand("allegro_right")
    start = dict(zip(retarget.joint_names, retarget(hands[0]), strict=True))
    limits = JointLimits(retarget.lower, retarget.upper)
    system = RetargetingSystem(
        retarget, robot.plant, robot.instance, initial_positions=start, period=PERIOD, limits=limits
    )
    frames = itertools.cycle(list(hands))
    functions = {
        "call": lambda: retarget(next(frames)),
        "update": updates(system, hands),
        "and status": updates(system, hands, read="status"),
        "ports alone": updates(Idle(system), hands),
    }
    results = measure(functions, arguments.seconds)
    report(f"one update with {arguments.method}", results, "call", arguments.json)
    return 0


def updates(system: LeafSystem, hands: np.ndarray, read: str = "") -> Callable[[], object]:
    """Returns a function without arguments that updates the system with the next frame at each call.

    Then it evaluates the output port `read`, if given.
    """
    context = system.CreateDefaultContext()
    frames = itertools.cycle(list(hands.reshape(len(hands), -1)))
    steps = itertools.count()
    system.GetInputPort("valid").FixValue(context, [1.0])
    keypoints = system.GetInputPort("keypoints").FixValue(context, next(frames))
    output = system.GetOutputPort(read) if read else None

    def update() -> None:
        context.SetTime(next(steps) * PERIOD)
        keypoints.GetMutableData().get_mutable_value().SetFromVector(next(frames))
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
        if output is not None:
            output.Eval(context)

    return update


class Idle(LeafSystem):
    """A system with the input ports and states of another, whose update does nothing."""

    def __init__(self, other: LeafSystem):
        super().__init__()
        for name in ("keypoints", "valid"):
            self.DeclareVectorInputPort(name, other.GetInputPort(name).size())
        context = other.CreateDefaultContext()
        for group in range(context.num_discrete_state_groups()):
            self.DeclareDiscreteState(context.get_discrete_state(group).size())
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._update)

    def _update(self, context: Context, discrete_state) -> EventStatus:
        return EventStatus.Succeeded()


if __name__ == "__main__":
    run_main(main)

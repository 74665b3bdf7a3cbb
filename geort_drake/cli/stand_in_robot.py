"""Simulate a robot that is controlled like a real one, over ZeroMQ or LCM.

ADDRESS is that of `geort-drake live --robot`. Over ZeroMQ, it takes joint targets of any hand; over LCM, it
is a Panda with an Allegro hand. It holds its last command when no more arrive. Ctrl-C stops it.
"""

import argparse
import math

from geort_drake.cli.options import CommandParser, positive, scenario_of


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add(
        "--robot",
        default="zmq+tcp://127.0.0.1:5557",
        metavar="ADDRESS",
        help="zmq+tcp://HOST:PORT, lcm, or lcm+URL",
    )
    add("--duration", type=positive, default=math.inf, help="duration, s (default: endless)")
    add("--meshcat", action="store_true", help="show it in a browser on this machine")
    parser.add_scenario("{object: {name: sphere}}")


def run(arguments: argparse.Namespace) -> int:
    from pydrake.systems.analysis import Simulator

    from geort_drake.console import say, warn
    from geort_drake.live.robots import make_stand_in, open_meshcat
    from geort_drake.live.session import run_in_real_time, stopping

    scenario = scenario_of(arguments)
    diagram = make_stand_in(scenario, arguments.robot, open_meshcat() if arguments.meshcat else None)
    simulator = Simulator(diagram)
    simulator.Initialize()
    root = simulator.get_context()
    say(f"{scenario.hand} at {arguments.robot}; Ctrl-C stops it")
    with stopping() as stop:
        late = run_in_real_time(
            simulator, 0.02, lambda: not stop.is_set() and root.get_time() < arguments.duration
        )
    if late:
        warn(f"the simulation was slower than real time {late} times")
    return 0

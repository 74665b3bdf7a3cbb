"""Simulate a Panda with an Allegro hand, controlled over LCM like the real robots.

It follows PANDA_COMMAND and ALLEGRO_COMMAND, publishes PANDA_STATUS and ALLEGRO_STATUS, and holds its last
command when no more arrive. Ctrl-C stops it.
"""

import argparse
import math

from geort_drake.cli.options import CommandParser, positive, scenario_of


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("--lcm", default="lcm", metavar="ADDRESS", help="LCM bus: lcm, or lcm+URL")
    add("--duration", type=positive, default=math.inf, help="duration, s (default: endless)")
    add("--meshcat", action="store_true", help="show it in a browser on this machine")
    parser.add_scenario("{object: {name: sphere}}")


def run(arguments: argparse.Namespace) -> int:
    from pydrake.systems.analysis import Simulator

    from geort_drake.console import say, warn
    from geort_drake.live.robots import make_stand_in, open_meshcat
    from geort_drake.live.session import run_in_real_time, stopping
    from geort_drake.live.transports import split_address

    _, url = split_address(arguments.lcm, ["lcm"])
    scenario = scenario_of(arguments)
    diagram = make_stand_in(scenario, url, open_meshcat() if arguments.meshcat else None)
    simulator = Simulator(diagram)
    simulator.Initialize()
    root = simulator.get_context()
    say(f"{scenario.hand} on a Panda at {url}; Ctrl-C stops it")
    with stopping() as stop:
        late = run_in_real_time(
            simulator, 0.02, lambda: not stop.is_set() and root.get_time() < arguments.duration
        )
    if late:
        warn(f"the simulation was slower than real time {late} times")
    return 0

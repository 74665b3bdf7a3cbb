"""A simulated Panda with an Allegro hand that speaks LCM as the real ones do, for trying teleoperate.py.

It follows PANDA_COMMAND and ALLEGRO_COMMAND, publishes PANDA_STATUS and ALLEGRO_STATUS, and holds the last
command when no more come. Ctrl-C stops it.
"""

import argparse
import math
from collections.abc import Sequence

from geort_drake.cli.console import console, run_main, warn
from geort_drake.cli.options import add_scenario_options, make_parser, scenario_of


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("--lcm", default="lcm", metavar="ADDRESS", help="the bus: lcm, or lcm+URL")
    add("--duration", type=float, default=math.inf, help="stop after so many seconds (default: never)")
    add("--meshcat", action="store_true", help="show it in a browser on this machine")
    add_scenario_options(parser, "{object: {name: sphere}}")
    arguments = parser.parse_args(argv)
    if not arguments.duration > 0:
        parser.error(f"--duration must be positive, not {arguments.duration}")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from pydrake.systems.analysis import Simulator

    from geort_drake.live.real_time import run_in_real_time, stopping
    from geort_drake.live.simulated_robot import show
    from geort_drake.live.stand_in import make_stand_in
    from geort_drake.live.transports import split_address

    _, url = split_address(arguments.lcm, ())
    scenario = scenario_of(arguments)
    diagram = make_stand_in(scenario, url, show() if arguments.meshcat else None)
    simulator = Simulator(diagram)
    simulator.Initialize()
    root = simulator.get_context()
    console.print(f"{scenario.hand} on a Panda at {url}; Ctrl-C stops it", soft_wrap=True)
    with stopping() as stop:
        late = run_in_real_time(
            simulator, 0.02, lambda: not stop.is_set() and root.get_time() < arguments.duration
        )
    if late:
        warn(f"the simulation was late {late} times")
    return 0


if __name__ == "__main__":
    run_main(main)

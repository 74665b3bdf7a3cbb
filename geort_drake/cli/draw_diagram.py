"""Draw the block diagram of a scenario.

The picture shows systems, connected ports, and what flows between them, as they are simulated. Drawing needs
Graphviz's `dot`.
"""

import argparse

from geort_drake.cli.options import CommandParser, finish, output_file, scenario_of


def add_arguments(parser: CommandParser) -> None:
    parser.add_argument("--output", type=output_file(".svg"), default="diagram.svg", help="picture to write")
    parser.add_scenario()


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.files import write_text
    from geort_drake.simulation.drawing import draw_scenario

    write_text(arguments.output, draw_scenario(scenario_of(arguments)))
    finish({"Diagram": f"{arguments.output} (open it in a browser)"})
    return 0

"""Train the universal map of a robot hand on synthetic people.

geort-drake pretrain --hand my_hand.yaml --output my_hand.safetensors
"""

import argparse
from dataclasses import replace

from geort_drake.cli.grasp import try_out
from geort_drake.cli.options import CommandParser, at_least, finish, output_file

EPILOG = """\
Training takes about half an hour on two cores. geort_drake.load_retargeter(FILE) loads the map, which works
for any person. The same seed gives the same weights bit for bit, with the same package versions and the same
kind of processor.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    parser.add_hand()
    add("--output", type=output_file(".safetensors"), required=True, metavar="FILE", help="map to write")
    add("--people", type=at_least(1), default=800, metavar="N", help="number of people in the population")
    parser.add_seed("population and training")
    add("--device", default="cpu", choices=["cpu", "cuda"], help="where to train; a GPU is hardly faster")
    setting = "change a setting; repeatable; an unknown NAME lists all settings"
    add("--set", action="append", default=[], metavar="NAME=VALUE", help=setting)


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import load_hand
    from geort_drake.comparison.pretrain import pretrain
    from geort_drake.console import print_table
    from geort_drake.retargeting.methods.coupled import UNIVERSAL_CONFIG
    from geort_drake.settings import parse_settings

    description = load_hand(arguments.hand)
    config = replace(UNIVERSAL_CONFIG, **parse_settings(arguments.set, UNIVERSAL_CONFIG, "pretrain"))
    figures = pretrain(
        description,
        arguments.output,
        config,
        arguments.people,
        arguments.seed,
        arguments.device,
        not arguments.quiet,
    )
    rows = [(name.replace("_", " "), f"{value:.4f}") for name, value in figures.items()]
    print_table(("figure", "value"), rows, f"{description.name}, seed {arguments.seed}")
    finish({"Map": arguments.output}, try_out(arguments.output, arguments.hand))
    return 0

"""Replay recorded teleoperation sessions with the object changed at random.

Sessions are glove recordings with wrist poses: those that `geort-drake grasp` keeps of its trials, or your
own. Every trial draws the object's place, yaw, mass or friction anew, up to the given size. An interrupted
evaluation continues with the same command.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.cli.options import (
    add_json_option,
    add_scenario_options,
    add_side_option,
    add_worker_options,
    at_least,
    finish,
    output_folder,
    scenario_of,
    write_json,
)

if TYPE_CHECKING:
    from rich.table import Table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("sessions", nargs="+", type=Path, metavar="SESSION", help="recordings with wrist poses (.npz)")
    add("--retargeter", type=Path, required=True, help="directory of the checkpoint to replay through")
    add("--object", help="what was grasped (default: as noted in the session)")
    add(
        "--perturb",
        nargs="+",
        default=(),
        metavar="NAME=S1,S2",
        help="largest changes to try: position (mm), yaw (°), and fractions of mass and friction "
        "(default: all four with their usual sizes)",
    )
    add("--trials", type=at_least(1), default=20, help="draws per session and size")
    add_worker_options(parser)
    add("--output", type=output_folder, default="runs/replay", help="folder for the results")
    add_side_option(parser)
    add_json_option(parser, "the summary")
    add_scenario_options(parser, "{retargeting: {latency: 0.01}}")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.benchmark.conditions import PERTURBATIONS, parse_values
    from geort_drake.benchmark.config import TRIALS
    from geort_drake.benchmark.records import TrialLog, outcome_line
    from geort_drake.benchmark.replay import Replay
    from geort_drake.benchmark.report import MARKDOWN, write_replay_report
    from geort_drake.benchmark.trials import run_trials
    from geort_drake.console import console, say, track, warn

    replay = Replay(
        scenario_of(arguments),
        arguments.sessions,
        arguments.side,
        arguments.object,
        arguments.retargeter,
        parse_values(arguments.perturb, PERTURBATIONS),
        arguments.trials,
    )
    with TrialLog(arguments.output / TRIALS) as log:
        replay.open(arguments.output)
        keys = replay.keys()
        left = log.unfinished(keys)
        say(f"{len(keys)} trials, {len(keys) - len(left)} of them finished before")
        if left:
            jobs = min(arguments.jobs, len(left))
            records = run_trials(log, map(replay.trial, left), jobs, arguments.backend)
            for _ in track("replaying", records, len(left), outcome_line):
                pass
    summary = write_replay_report(arguments.output)
    console.print(_table(summary))
    if summary["errors"]:
        warn(f"{summary['errors']} trials raised an error: see {arguments.output}/errors")
    write_json(arguments.json, summary)
    finish({"Report": arguments.output / MARKDOWN})
    return 1 if summary["errors"] else 0


def _table(summary: dict) -> "Table":
    """One row a perturbation and size."""
    from rich.table import Table

    table = Table(title="Replayed sessions")
    for heading in ("change", "size", "success", "95 %"):
        table.add_column(heading, justify="left" if heading == "change" else "right", no_wrap=True)
    for panel in summary["perturbations"].values():
        for condition in panel["conditions"]:
            (share,) = condition["methods"].values()
            table.add_row(
                panel["label"],
                f"{condition['value']:g}",
                f"{share['successes']} of {share['trials']}",
                f"{100 * share['low']:.0f}–{100 * share['high']:.0f} %",
            )
    return table

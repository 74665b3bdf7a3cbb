"""Replay recorded sessions with random changes of the object.

Sessions are recordings with wrist poses: those that `geort-drake grasp` writes, or your own. Each trial
changes the object's position, yaw, mass or friction at random, up to the given size. The same command resumes
an interrupted run.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from geort_drake.cli.options import CommandParser, at_least, finish, scenario_of, write_json


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("sessions", nargs="+", type=Path, metavar="SESSION", help="recordings with wrist poses (.npz)")
    add("--retargeter", type=Path, help="checkpoint or map (default: the hand's universal map)")
    add("--object", help="object that was grasped (default: as stated in the session)")
    changes = "largest changes: position (mm), yaw (°), mass and friction (fractions); default: all of these"
    add("--perturb", nargs="+", default=(), metavar="NAME=S1,S2", help=changes)
    add("--trials", type=at_least(1), default=20, help="trials per session and size")
    parser.add_workers()
    parser.add_output("runs/replay", "trials.jsonl")
    parser.add_side()
    parser.add_json("the summary")
    parser.add_scenario("{retargeting: {latency: 0.01}}")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.benchmark.conditions import PERTURBATIONS, parse_values
    from geort_drake.benchmark.config import TRIALS
    from geort_drake.benchmark.records import TrialLog, outcome_line
    from geort_drake.benchmark.replay import Replay
    from geort_drake.benchmark.report import MARKDOWN, write_replay_report
    from geort_drake.benchmark.trials import run_trials
    from geort_drake.benchmark.workers import require_backend
    from geort_drake.console import print_table, say, track, warn

    replay = Replay(
        scenario_of(arguments),
        arguments.sessions,
        arguments.side,
        arguments.object,
        arguments.retargeter,
        parse_values(arguments.perturb, PERTURBATIONS),
        arguments.trials,
    )
    require_backend(arguments.backend)
    with TrialLog(arguments.output / TRIALS) as log:
        replay.open(arguments.output)
        keys = replay.keys()
        left = log.unfinished(keys)
        say(f"trials: {len(keys)}, already finished: {len(keys) - len(left)}")
        if left:
            jobs = min(arguments.jobs, len(left))
            records = run_trials(log, map(replay.trial, left), jobs, arguments.backend)
            for _ in track("replaying", records, len(left), outcome_line):
                pass
    summary = write_replay_report(arguments.output)
    print_table(("change", "size", "success", "95 %"), _rows(summary), "Replayed sessions")
    if summary["errors"]:
        warn(f"trials that raised an error: {summary['errors']}; see {arguments.output}/errors")
    write_json(arguments.json, summary)
    finish({"Report": arguments.output / MARKDOWN})
    return 1 if summary["errors"] else 0


def _rows(summary: dict) -> Iterator[tuple[str, ...]]:
    """Yields a row per perturbation and size."""
    for panel in summary["perturbations"].values():
        for condition in panel["conditions"]:
            (share,) = condition["methods"].values()
            yield (
                panel["label"],
                f"{condition['value']:g}",
                f"{share['successes']} of {share['trials']}",
                f"{100 * share['low']:.0f}–{100 * share['high']:.0f} %",
            )

"""Replays recorded sessions of teleoperation while the object is not quite as it was.

Sessions are glove recordings with wrist poses: those that simulate_grasp.py keeps of its trials, or your own.
Every trial draws place, yaw, mass or friction of the object anew, up to the given size. What is finished is
kept, so an interrupted evaluation goes on with the same command.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from geort_drake.cli.console import console, progress_bar, run_main, warn
from geort_drake.cli.options import (
    add_json_option,
    add_scenario_options,
    at_least,
    make_parser,
    scenario_of,
    write_json,
)
from geort_drake.files import require_writable
from geort_drake.people.recording import SIDES


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("sessions", nargs="+", type=Path, metavar="SESSION", help="recordings with wrist poses (.npz)")
    add("--retargeter", type=Path, required=True, help="directory of the checkpoint to replay through")
    add("--object", help="what was grasped (default: what the session says)")
    add(
        "--perturb",
        nargs="+",
        default=(),
        metavar="NAME=S1,S2",
        help="largest changes to try: position (mm), yaw (°), and shares of mass and friction "
        "(default: all four with their usual sizes)",
    )
    add("--trials", type=at_least(1), default=20, help="draws per session and size")
    add(
        "--jobs",
        type=at_least(1),
        default=os.cpu_count() or 1,
        help="trials at a time (default: the number of processors)",
    )
    add("--backend", default="loky", choices=["loky", "ray"], help="processes here, or a Ray cluster")
    add("--output", type=Path, default=Path("runs/replay"), help="folder for the results")
    add("--side", choices=SIDES, help="side of the recorded hands (default: the robot hand's)")
    add_json_option(parser, "the summary")
    add_scenario_options(parser, "{retargeting: {latency: 0.01}}")
    arguments = parser.parse_args(argv)
    require_writable(arguments.output, directory=True)
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.benchmark.config import TRIALS
    from geort_drake.benchmark.folder import keep_error
    from geort_drake.benchmark.replay import PERTURBATIONS, REPORT, Replay, write_report
    from geort_drake.benchmark.sensitivity import parse_values
    from geort_drake.benchmark.trial_log import TrialLog, key_of

    usual = {name: perturbation.sizes for name, perturbation in PERTURBATIONS.items()}
    scenario = scenario_of(arguments)
    replay = Replay(
        scenario,
        arguments.sessions,
        arguments.side,
        arguments.object,
        arguments.retargeter,
        parse_values(arguments.perturb, usual),
        arguments.trials,
    )
    with TrialLog(arguments.output / TRIALS) as log:
        replay.open(arguments.output)
        keys = replay.keys()
        finished = log.finished
        left = [key for key in keys if key not in finished]
        console.print(f"{len(keys)} trials, {len(keys) - len(left)} of them finished before")
        with progress_bar() as progress:
            task = progress.add_task("replaying", total=len(left), note="")
            if left:
                for record in replay.run(left, min(arguments.jobs, len(left)), arguments.backend):
                    log.append(keep_error(arguments.output, record))
                    outcome = "error" if "error" in record else record["outcome"]
                    progress.update(task, advance=1, note=f"{key_of(record)}: {outcome}")
    summary = write_report(arguments.output)
    console.print(results_table(summary))
    if summary["errors"]:
        warn(f"{summary['errors']} trials raised an error: see {arguments.output}/errors")
    write_json(arguments.json, summary)
    console.print(f"Report: {arguments.output / REPORT}", markup=False, soft_wrap=True)
    return 1 if summary["errors"] else 0


def results_table(summary: dict) -> Table:
    """One row a perturbation and size."""
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


if __name__ == "__main__":
    run_main(main)

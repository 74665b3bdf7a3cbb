"""Prints the tables of `geort-drake benchmark`."""

import argparse
from collections.abc import Iterator

from geort_drake.cli.options import finish, write_json


def report(arguments: argparse.Namespace, summary: dict) -> int:
    """Prints the summary of grasps; returns the exit code."""
    from geort_drake.console import print_table, warn

    folder, errors = arguments.output, summary["errors"]
    # Narrow enough for 80 columns with the names of our methods; otherwise words would be cut.
    headings = ("method", "first\nattempt", "95 %", "success", "tip-only", "mean\ntime", "to\nfirst")
    caption = (
        "first attempt: lifted and held without a second attempt; tip-only: only fingertips touched the held "
        "object; mean time: failures count as the timeout; to first: difference of first-attempt success to "
        "the first method, %"
    )
    print_table(headings, _rows(summary), "Grasps", caption)
    if summary["refused"]:
        warn(f"objects left out, because the hand cannot grasp them: {', '.join(summary['refused'])}")
    for name, entry in summary["methods"].items():
        _warn_of_faults(name, entry["overall"]["faults"])
    if errors:
        warn(f"trials that raised an error: {errors}; see {folder / 'errors'}")
    write_json(arguments.json, summary)
    finish({"Report": folder / "report.md"})
    return 1 if errors else 0


def report_tasks(arguments: argparse.Namespace, summary: dict) -> int:
    """Prints the summary of tasks and kinds; returns the exit code."""
    from geort_drake.console import print_table, warn

    rows = []
    for task, kinds in summary["tasks"].items():
        for kind, figures in kinds.items():
            if figures["refused"]:
                warn(f"{task}, left out, as the hand cannot do it: {', '.join(figures['refused'])}")
            for method, result in figures["methods"].items():
                _warn_of_faults(f"{method} in {task} ({kind})", result["faults"])
                score, share = result["score"], result["success"]
                if share["trials"]:
                    bounds = "–" if score["low"] is None else f"{score['low']:.2f}–{score['high']:.2f}"
                    done = f"{share['successes']} of {share['trials']}"
                    rows.append([task, kind, method, f"{score['mean']:.2f}", bounds, done])
    caption = "score: from 0 to 1, mean with its 95 % interval"
    print_table(("task", "person", "method", "score", "95 %", "success"), rows, "Tasks", caption)
    if summary["errors"]:
        warn(f"trials that raised an error: {summary['errors']}; see errors/ in {arguments.output}/*/*")
    write_json(arguments.json, summary)
    finish({"Summary": f"{arguments.output / 'summary.json'}"})
    return 1 if summary["errors"] else 0


def _warn_of_faults(name: str, faults: dict) -> None:
    """Warns if a method's outputs were faulty; `faults` maps kinds of faults to numbers of outputs."""
    from geort_drake.console import warn

    if faults:
        counted = ", ".join(f"{number} {kind}" for kind, number in faults.items())
        warn(f"faulty outputs of {name}; the joints held, or stayed at their limits: {counted}")


def _rows(summary: dict) -> Iterator[list[str]]:
    """Yields a row per method."""
    for name, entry in summary["methods"].items():
        overall = entry["overall"]
        first_attempt, success = overall["first_attempt_success"], overall["success"]
        if not first_attempt["trials"]:
            yield [name, *["–"] * 6]
            continue
        difference = summary["differences"].get(name, {}).get("overall", {}).get("first_attempt_success", {})
        yield [
            name,
            f"{first_attempt['successes']} of {first_attempt['trials']}",
            f"{100 * first_attempt['low']:.0f}–{100 * first_attempt['high']:.0f} %",
            f"{100 * success['rate']:.0f} %",
            f"{100 * overall['tip_success']['rate']:.0f} %",
            f"{overall['completion_time_s']['restricted_mean']['mean']:.1f} s",
            "–" if difference.get("mean") is None else f"{100 * difference['mean']:+.0f}",
        ]

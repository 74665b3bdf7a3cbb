"""Shared by all sessions of `geort-drake live`: loading the map, messages and the report."""

from pathlib import Path
from typing import Any

from geort_drake.console import console, say, warn
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand
from geort_drake.live.robots import RobotLink
from geort_drake.live.teleoperation import Teleoperation
from geort_drake.methods import default_method, names_of, resolve
from geort_drake.retargeting.base import Retarget


def retargeter_of(name: str | None, description: HandDescription) -> tuple[Retarget, str]:
    """Returns the retargeter for a hand, and a few words for it.

    Args:
        name: name of a method, or path of a map or a Python file; None takes the hand's universal map, or one
            that is trained on synthetic play.

    Raises:
        GeortError: see `geort_drake.methods.names_of`.
    """
    hand = Hand(description)
    method = name or default_method(hand)
    names_of([method], hand)
    words = "universal map" if method == "universal" else f"map of {Path(method).name}"
    if name is None and method != "universal":
        say(f"no universal map is shipped for {description.name}; using a map trained on synthetic play")
        words = "map trained on synthetic play"
    return resolve(method, hand)[0], words


def print_keys(keys: str) -> None:
    console.print(f"{keys}Ctrl-C stops.")


def say_state(time: float, state: str) -> None:
    say(f"{time:8.2f} s  {state}")


def add_counts(summary: dict[str, Any], loop: Teleoperation, link: RobotLink | None) -> None:
    """Adds the counts of glove and robot to the summary of a session, for --json."""
    if (meter := loop.meter) is not None:
        glove = loop.glove
        summary["glove"] = {
            "received": glove.source.received,
            "refused": glove.source.refused,
            "last_refusal": glove.source.last_refusal or None,
            "late": glove.late,
        }
        summary["delay_s"] = meter.delay()
    if link:
        summary["robot"] = {"refused": link.bus.refused, "last_refusal": link.bus.last_refusal or None}


def print_summary(summary: dict) -> None:
    """Prints the summary in a few lines."""
    if (delay := summary.get("delay_s")) and delay["count"]:
        median, p99 = (f"{1e3 * delay[key]:.1f} ms" for key in ("median", "p99"))
        say(f"from keypoints to joint targets: median {median}, 99th percentile {p99}")
    if counts := summary.get("glove"):
        say(
            f"glove: {counts['received']} frames received, {counts['refused']} refused, {counts['late']} late"
        )
    for name in ("glove", "robot"):
        if reason := summary.get(name, {}).get("last_refusal"):
            warn(f"{name}: {summary[name]['refused']} messages were refused, the last: {reason}")
    if summary["late"]:
        warn(f"the loop was late {summary['late']} times")
    say("stopped; the robot holds its last command")

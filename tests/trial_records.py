"""Rows of a benchmark's trials, for tests of what is made of them; no tests."""

import json
from pathlib import Path

SUCCESS = Path(__file__).with_name("trial.json").read_text("utf-8")


def trial(method="hold", thing="cube", seed=0, time=5.0, attempts=1, **changes) -> dict:
    """The row of a trial that succeeded after `time` seconds; without a time, of one that failed."""
    row = json.loads(SUCCESS) | {"method": method, "object": thing, "seed": seed, "completion_time": time}
    row |= {"first_attempt": attempts == 1, "attempts": attempts, "drops": (attempts or 1) - 1}
    if time is None:
        row |= {"success": False, "outcome": "timeout: lift", "tip_success": False, "holding": {}}
        row |= {"first_attempt": False, "score": 0.0}
    return row | changes


def error(method="hold", thing="cube", seed=9, **changes) -> dict:
    """The row of a trial that raised."""
    key = {name: json.loads(SUCCESS)[name] for name in ("training", "task", "kind", "condition", "person")}
    return {**key, "method": method, "object": thing, "seed": seed, "error": "ValueError: no"} | changes

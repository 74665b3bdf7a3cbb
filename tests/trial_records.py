"""Lines of a grasp benchmark's results, for tests of what is made of them; no tests."""

import json
from pathlib import Path

SUCCESS = Path(__file__).with_name("trial.json").read_text("utf-8")


def trial(method="hold", thing="cube", seed=0, time=5.0, attempts=1, **changes) -> dict:
    """A line of a trial that succeeded after `time` seconds; without a time, of one that failed."""
    line = json.loads(SUCCESS) | {"method": method, "object": thing, "seed": seed, "completion_time": time}
    line |= {"first_attempt": attempts == 1, "attempts": attempts, "drops": (attempts or 1) - 1}
    if time is None:
        line |= {"success": False, "outcome": "timeout: lift", "tip_success": False, "holding": {}}
        line["first_attempt"] = False
    return line | changes


def error(method="hold", thing="cube", seed=9, **changes) -> dict:
    """A line of a trial that raised."""
    raised = {"error": "ValueError: no", "traceback": "a.txt"}
    return {"method": method, "object": thing, "seed": seed, **raised, **changes}

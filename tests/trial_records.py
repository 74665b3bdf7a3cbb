"""Lines of a grasp benchmark's results, for tests of what is made of them; no tests."""


def trial(method="hold", thing="cube", seed=0, time=5.0, attempts=1, **changes) -> dict:
    """A line of a trial that succeeded after `time` seconds; without a time, of one that failed."""
    success = time is not None
    return {
        "method": method,
        "object": thing,
        "seed": seed,
        "task": "grasp",
        "score": 0.0,
        "success": success,
        "outcome": "success" if success else "timeout: lift",
        "completion_time": time,
        "first_attempt": success and attempts == 1,
        "attempts": attempts,
        "simulated_time": 6.0,
        "tip_success": success,
        "holding": {"thumb": 2.0, "index": 2.0} if success else {},
        "phase_times": {"REACH": 0.0, "LIFT": 3.0},
        "phase_durations": {"REACH": 3.0, "LIFT": 1.0},
        "drops": (attempts or 1) - 1,
        "slip": 0.002,
        "peak_force": 4.0,
        "peak_height": 0.15,
        "operator_phase": None,
        "self_contact": 0.0,
        "wall_time": 2.0,
        **changes,
    }


def error(method="hold", thing="cube", seed=9, **changes) -> dict:
    """A line of a trial that raised."""
    raised = {"error": "ValueError: no", "traceback": "a.txt"}
    return {"method": method, "object": thing, "seed": seed, **raised, **changes}

"""The results file of the grasp benchmark, line by line."""

import json

import pytest

from geort_drake.benchmark.trial_log import TrialKey, TrialLog, read_records
from geort_drake.errors import BenchmarkError


def line(method="hold", thing="cylinder", seed=0) -> dict:
    """A line for the results file."""
    return {
        "method": method, "object": thing, "seed": seed, "error": "ValueError: no", "traceback": "a.txt",
    }  # fmt: skip


def result(seed=0, **changes) -> dict:
    """A line for the results file, of a trial that did not raise."""
    return {
        "method": "hold", "object": "cylinder", "seed": seed, "success": True, "outcome": "success",
        "completion_time": 4, "first_attempt": True, "attempts": 1, "simulated_time": 6.0,
        "phase_times": {"REACH": 0.0}, "phase_durations": {"REACH": 4.0}, "drops": 0, "slip": None,
        "peak_force": 1.5, "peak_height": 0.15, "operator_phase": None, "self_contact": 0.0,
        "wall_time": 2.0, **changes,
    }  # fmt: skip


def test_the_log_gives_back_what_was_written(tmp_path):
    """Lines are in the file at once, and there when it is opened again."""
    with TrialLog(tmp_path / "trials.jsonl") as log:
        log.append(line())
        assert read_records(tmp_path / "trials.jsonl") == [line()]
        log.append(line(seed=1))
    with TrialLog(tmp_path / "trials.jsonl") as log:
        assert log.records == [line(), line(seed=1)] and not log.torn


def test_a_torn_last_line_is_dropped_from_the_file(tmp_path):
    """Also one that lacks nothing but its end: the trial is repeated, and the next line stands alone."""
    path = tmp_path / "trials.jsonl"
    for torn in ('{"method": "ho', json.dumps(line(seed=1))):
        path.write_text(json.dumps(line()) + "\n" + torn)
        assert read_records(path) == [line()]
        with TrialLog(path) as log:
            assert log.torn and log.records == [line()]
            log.append(line(seed=2))
        assert path.read_text() == json.dumps(line()) + "\n" + json.dumps(line(seed=2)) + "\n"


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ('{"method": "ho', "line 2: not a trial's result"),
        ("[1, 2]", "line 2: not a trial's result"),
        ("", "line 2: not a trial's result"),
        ("\0\0\0", "line 2: not a trial's result"),
        ('{"method": "hold", "object": "cylinder"}', "line 2: not a trial's result.*seed"),
        ('{"method": [], "object": "cylinder", "seed": 1}', "line 2: not a trial's result"),
        (
            '{"method": "hold", "object": "cylinder", "seed": 1}',
            "line 2: not a trial's result: attempts, completion_time.* missing; mend or delete",
        ),
        (json.dumps(result(seed=1)) + "\n" + json.dumps(result(seed=1)), "line 3: a second result of hold"),
        (json.dumps(result(seed=1)) + "\n" + json.dumps(line(seed=1)), "line 3: a second result of hold"),
    ],
)
def test_a_corrupt_line_is_refused_by_file_and_number(tmp_path, bad, message):
    """And the file stays as it is."""
    path = tmp_path / "trials.jsonl"
    content = json.dumps(line()) + "\n" + bad + "\n" + json.dumps(line(seed=2)) + "\n"
    path.write_text(content)
    for read in (TrialLog, read_records):
        with pytest.raises(BenchmarkError, match=f"trials.jsonl, {message}"):
            read(path)
    assert path.read_text() == content


FAILED = {"success": False, "outcome": "timeout: touch", "completion_time": None, "first_attempt": False}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"completion_time": "4"}, 'completion_time must be a finite number or null, not "4"'),
        ({"slip": float("nan")}, "slip must be a finite number or null, not NaN"),
        ({"peak_force": float("inf")}, "peak_force must be a finite number, not Infinity"),
        ({"peak_force": 10**400}, "peak_force must be a finite number, not 10000"),
        ({"seed": "0"}, 'seed must be a whole number, not "0"'),
        ({"seed": True}, "seed must be a whole number, not true"),
        ({"object": None}, "object must be a text, not null"),
        ({"success": 1}, "success must be true or false, not 1"),
        ({"phase_durations": None}, "phase_durations must be an object, not null"),
        ({"phase_durations": {"REACH": []}}, r"phase_durations\.REACH must be a finite number, not \[\]"),
        ({"attempts": 1.5}, r"attempts must be a whole number or null, not 1\.5"),
        ({"error": "ValueError: no"}, "traceback missing"),
        ({"error": None, "traceback": "a.txt"}, "error must be a text, not null"),
        ({"condition": "delay"}, "condition must be NAME=NUMBER, not 'delay'"),
        ({"condition": "delay=nan"}, "condition must be NAME=NUMBER, not 'delay=nan'"),
        ({"outcome": "thrown: lift"}, "a trial with success cannot have the outcome 'thrown: lift'"),
        ({**FAILED, "outcome": "success"}, "a trial with no success cannot have the outcome 'success'"),
        (
            {"completion_time": None},
            r"the completion_time .* must be between 0 and .* 6\.0, not None",
        ),
        (
            {"completion_time": 7.0},
            r"the completion_time .* must be between 0 and .* 6\.0, not 7\.0",
        ),
        (
            {**FAILED, "completion_time": 4.0},
            r"the completion_time .* with no success must be null, not 4\.0",
        ),
        ({**FAILED, "first_attempt": True}, "first_attempt must not be true of a trial with no success"),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_by_its_field(tmp_path, changes, message):
    """With file and line, what was wanted and what was given."""
    path = tmp_path / "trials.jsonl"
    path.write_text(json.dumps(result()) + "\n" + json.dumps(result(**{"seed": 1, **changes})) + "\n")
    for read in (TrialLog, read_records):
        with pytest.raises(BenchmarkError, match=rf"trials\.jsonl, line 2: not a trial's result: {message}"):
            read(path)


@pytest.mark.parametrize("changes", [{}, FAILED, {"first_attempt": None, "attempts": None}, {"note": "x"}])
def test_every_way_to_end_is_read(tmp_path, changes):
    """Success, failure, a replay in which nobody decides; also with a field of a later version."""
    path = tmp_path / "trials.jsonl"
    path.write_text(json.dumps(result(**changes)) + "\n")
    assert read_records(path) == [result(**changes)]


def test_a_trial_that_raised_is_not_finished(tmp_path):
    """What comes of its repetition stands in its place, also where that raises again."""
    path = tmp_path / "trials.jsonl"
    with TrialLog(path) as log:
        for record in (line(), line(seed=1), result(seed=2), line(), result(seed=1)):
            log.append(record)
    with TrialLog(path) as log:
        assert log.records == [line(), result(seed=1), result(seed=2)]
        assert log.finished == {TrialKey("hold", "cylinder", 1), TrialKey("hold", "cylinder", 2)}


def test_two_processes_do_not_write_to_one_file(tmp_path):
    """The second one is turned away as long as the first has the file open."""
    path = tmp_path / "trials.jsonl"
    with TrialLog(path), pytest.raises(BenchmarkError, match="another process is writing"):
        TrialLog(path)
    TrialLog(path).close()

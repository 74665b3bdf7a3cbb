"""The results file of the grasp benchmark, line by line."""

import dataclasses as dc
import json

import pytest

from geort_drake.errors import BenchmarkError
from geort_drake.evaluation.trial_log import TrialKey, TrialLog, read_records
from geort_drake.simulation.trial import TrialResult


def line(method="hold", thing="cylinder", seed=0) -> dict:
    """A line for the results file."""
    return {"method": method, "object": thing, "seed": seed, "error": "ValueError: no"}


def result(seed=0) -> dict:
    """A line for the results file, of a trial that did not raise."""
    fields = {field.name: 0 for field in dc.fields(TrialResult)}
    return {**fields, "method": "hold", "object": "cylinder", "seed": seed}


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
            "line 2: attempts, completion_time.* missing",
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

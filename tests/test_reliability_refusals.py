"""Hostile inputs are refused with a named error and exit code 2, in time, and nothing is written."""

import pytest
from faults.hostile import CASES, faults_of
from faults.mutations import fuzz


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_hostile_input_is_refused(case, tmp_path):
    """Without a traceback, within bounded time and memory."""
    assert faults_of(case, tmp_path) == []


def test_inputs_changed_at_random_are_read_or_refused(tmp_path):
    """For every reader; nothing else happens."""
    result = fuzz(200, 1, tmp_path / "fuzz")
    assert result["failures"] == []
    assert result["inputs"] == 200 and len(result["tried"]) > 25

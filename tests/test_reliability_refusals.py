"""Malformed inputs are refused by name, with exit code 2, in time, and nothing is written."""

from collections import Counter

import pytest
from faults.corpus import CASES
from faults.mutations import fuzz
from faults.refusals import faults_of


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_malformed_input_is_refused(case, tmp_path):
    """The named error, no traceback, a bounded time and memory; see `faults_of`."""
    assert faults_of(case, tmp_path) == []


def test_the_corpus_covers_every_kind_of_input():
    """At least 80, and each name once."""
    assert len(CASES) >= 80
    assert max(Counter(map(str, CASES)).values()) == 1
    assert {case.kind for case in CASES} == {
        "recording", "checkpoint", "scenario", "hand", "command", "message",
    }  # fmt: skip


def test_inputs_changed_at_random_are_read_or_refused(tmp_path):
    """Of every kind; with nothing but what was to be read, or an error of ours."""
    result = fuzz(200, 1, tmp_path / "fuzz")
    assert result["failures"] == []
    assert result["inputs"] == 200 and len(result["tried"]) > 25

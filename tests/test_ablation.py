"""The tables of a sweep against numbers that are known."""

import pytest

from geort_drake.comparison.ablation import ablation


def run_of(method, changed, value, seed, motion, closed):
    """A run that is known by two figures; everything else is the same in all runs."""
    pinch = None if closed is None else {"closed": closed, "too_deep": 0.0, "false": None}
    figures = {
        "motion_preservation": motion, "motion_preservation_track": None, "cross_talk": 0.1,
        "coverage": {"10mm": 0.5}, "coverage_context_averaged": {"10mm": 0.4}, "flatness": 0.05,
        "gain_p95_p5": 6.0, "pinch": pinch, "self_collision": 0.01,
    }  # fmt: skip
    return {"method": method, "changed": changed, "value": value, "seed": seed, "metrics": figures}


RUNS = [
    run_of("geort", None, None, 0, 0.90, 0.80),
    run_of("geort", None, None, 1, 0.94, 0.90),
    run_of("geort", "pinch_weight", 0.0, 0, 0.95, 0.30),
    run_of("geort", "pinch_weight", 0.0, 1, 0.97, 0.50),
    run_of("geort", "pinch_weight", 4.0, 1, 0.92, 0.95),
    run_of("geort", "pinch_weight", 1.0, 0, 0.91, None),
    {"method": "geort", "changed": "flatness_weight", "value": 0.0, "seed": 0, "error": "TrainingError: no"},
    run_of("linear_offline", None, None, 0, 0.8, 0.5),
]
GROUND = {"hand": "allegro_right", "recording": "hand.npy", "settings": {"steps": 100}}


@pytest.fixture
def tables():
    """Heading → first cell of a row → its other cells by column."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    text = ablation({"ground": GROUND, "runs": RUNS})
    assert "allegro_right, hand.npy; settings of all runs: steps = 100." in text
    for section in text.split("## ")[1:]:
        lines = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("|")]
        head, rule, *rows = lines
        assert {len(line) for line in lines} == {len(head)} and all(set(cell) <= {"-", ":"} for cell in rule)
        found[section.splitlines()[0]] = {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}
    return found


def test_rows_are_criteria_and_cells_are_changes_of_the_same_seed(tables):
    """Differences are taken seed by seed, so that their spread is not that of the seeds."""
    removed = tables["geort: each criterion removed"]
    assert list(removed) == ["default", "`pinch_weight` = 0", "`flatness_weight` = 0"]
    assert removed["default"]["motion preservation"] == "0.920 ± 0.028"
    row = removed["`pinch_weight` = 0"]
    assert row["seeds"] == "0, 1"
    assert row["motion preservation"] == "+0.040 ± 0.014"
    assert row["pinches closed"] == "-45.0% ± 7.1%"
    assert row["cross-talk"] == "+0.00 ± 0.00"
    assert row["along recorded steps"] == row["false pinches"] == "–"


def test_runs_that_failed_or_lack_a_seed_say_so(tables):
    """A run is compared with the default of its own seed; one that failed has no figures."""
    assert set(tables["geort: each criterion removed"]["`flatness_weight` = 0"].values()) == {"none", "–"}
    others = tables["geort: other weights"]
    assert list(others) == ["default", "`pinch_weight` = 1", "`pinch_weight` = 4"]
    assert others["`pinch_weight` = 4"]["seeds"] == "1"
    assert others["`pinch_weight` = 4"]["motion preservation"] == "-0.020"
    assert others["`pinch_weight` = 1"]["pinches closed"] == "–"


def test_a_method_without_changes_has_no_table(tables):
    """There is nothing to compare."""
    assert not any(heading.startswith("linear_offline") for heading in tables)

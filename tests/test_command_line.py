"""What the scripts' command lines share."""

import argparse
from pathlib import Path

import pytest

from geort_drake.command_line import (
    add_scenario_options,
    at_least,
    check_outputs,
    make_parser,
    positive,
    scenario_of,
)
from geort_drake.errors import OutputError


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "many", "", "nan"])
def test_a_count_that_is_none_is_refused(text):
    """Too low, or no whole number."""
    with pytest.raises(argparse.ArgumentTypeError, match=rf"must be .*, not '?{text}'?$"):
        at_least(1)(text)
    assert (at_least(1)("1"), at_least(0)("0")) == (1, 0)


@pytest.mark.parametrize("text", ["0", "-0.5", "inf", "nan", "long", ""])
def test_a_measure_that_is_none_is_refused(text):
    """Not positive, not finite, or no number."""
    with pytest.raises(argparse.ArgumentTypeError, match=rf"must be .*, not '?{text}'?$"):
        positive(text)
    assert positive("1e-3") == 0.001


def test_the_options_of_a_scenario_choose_and_change_it(tmp_path):
    """Without any, it is the package's; the hand and the text given take the place of the file's."""
    parser = make_parser("What it does.\n\n  as it is laid out")
    add_scenario_options(parser, "{timeout: 7}")
    assert "\n  as it is laid out\n" in parser.format_help()
    usual = scenario_of(parser.parse_args([]))
    changed = scenario_of(parser.parse_args(["--hand", "allegro_left", "--scenario_text", "{timeout: 7}"]))
    assert (usual.hand, changed.hand) == ("allegro_right", "allegro_left")
    assert usual.timeout != changed.timeout == 7


def test_outputs_are_checked_before_the_work(tmp_path, capsys):
    """An option that is not given is none; of the others name and place must do."""
    parser = make_parser(None)
    check_outputs(parser, (None, ".rrd"), (tmp_path / "new" / "a.npz", ".npz"))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(SystemExit):
        check_outputs(parser, (tmp_path / "a.npy", ".npz"))
    assert "the name must end with .npz" in capsys.readouterr().err
    with pytest.raises(OutputError, match="not a directory"):
        check_outputs(parser, (Path("/dev/null/a.npz"), ".npz"))

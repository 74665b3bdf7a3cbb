"""What every script says on stderr, and its exit code."""

import warnings

import pytest

from geort_drake.cli.console import run_main
from geort_drake.errors import RecordingError


def test_a_warning_is_printed_as_its_text_alone(capsys):
    """Nothing of the code it was raised in, nothing of it taken for markup; the run goes on."""

    def main(_):
        warnings.simplefilter("always")
        warnings.warn("joint [0] has moved little", stacklevel=1)
        print("done")

    shown = warnings.showwarning
    with pytest.raises(SystemExit) as exit:
        run_main(main)
    said = capsys.readouterr()
    assert exit.value.code == 0 and said.out == "done\n"
    assert said.err == "warning: joint [0] has moved little\n"
    assert warnings.showwarning is shown


def test_an_error_that_the_user_can_correct_ends_with_2(capsys):
    """Its text alone, after what was warned of before."""

    def main(_):
        warnings.warn("few frames", RuntimeWarning, stacklevel=1)
        raise RecordingError("hand.npy: no frames")

    with pytest.raises(SystemExit) as exit:
        run_main(main)
    assert exit.value.code == 2
    assert capsys.readouterr().err == "warning: few frames\nerror: hand.npy: no frames\n"

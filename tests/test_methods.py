"""The list of retargeting methods."""

import pytest
from light_training import train_lightly

from geort_drake.retargeting import methods
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter

MODULE = """
from geort_drake.retargeting.method import TrainedMethod
from geort_drake.retargeting.methods.linear_offline import LinearConfig, train_linear_offline
from geort_drake.retargeting.numpy_retargeter import Retargeter

METHODS = (TrainedMethod("mine", "of a newcomer", LinearConfig, train_linear_offline, Retargeter),)
"""


@pytest.mark.usefixtures("light_evaluation")
def test_one_module_adds_a_method(tmp_path, play, monkeypatch):
    """It is listed, trained, stored and loaded under its name."""
    (tmp_path / "newcomer.py").write_text(MODULE)
    monkeypatch.setattr(methods, "__path__", [*methods.__path__, str(tmp_path)])
    methods.all_methods.cache_clear()
    try:
        assert methods.trained_method("mine").summary == "of a newcomer"
        path = train_lightly("allegro_right", play, tmp_path / "map", "mine")
        assert load_checkpoint(path).config["method"] == "mine"
        assert load_retargeter(path)(play.p_HK[:3]).shape == (3, 16)
    finally:
        methods.all_methods.cache_clear()

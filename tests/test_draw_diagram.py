"""A scenario's block diagram is drawn with Drake's Graphviz description."""

import shutil

import pytest
from grasp_setup import scenario_with

from geort_drake.cli import run_command
from geort_drake.cli.draw_diagram import graphviz_text
from geort_drake.errors import GeortError


def test_the_picture_names_systems_and_ports():
    """Those of the scenario's diagram."""
    text = graphviz_text(scenario_with("cylinder"))
    for name in ("operator", "retargeting", "wrist_to_arm", "scene_view", "keypoints"):
        assert name in text


@pytest.mark.skipif(shutil.which("dot") is None, reason="Graphviz is not installed")
def test_the_picture_is_written(tmp_path):
    path = tmp_path / "diagram.svg"
    assert run_command("draw-diagram", ["--output", str(path)]) == 0
    assert "<svg" in path.read_text(encoding="utf-8")


def test_without_graphviz_the_message_says_what_to_install(tmp_path, monkeypatch):
    """Nothing is written."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(GeortError, match=r"Graphviz.*install"):
        run_command("draw-diagram", ["--output", str(tmp_path / "diagram.svg")])
    assert list(tmp_path.iterdir()) == []

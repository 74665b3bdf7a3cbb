"""The drawn diagram shows every system and connected port, and the one in the docs is up to date."""

import re
import shutil
from pathlib import Path

import pytest

from geort_drake.cli import run_command
from geort_drake.errors import GeortError

ROOT = Path(__file__).resolve().parents[1]

needs_dot = pytest.mark.skipif(shutil.which("dot") is None, reason="Graphviz is not installed")


def words(svg: Path) -> list[str]:
    """Every text in a picture."""
    return sorted(re.findall(r"<text[^>]*>([^<]*)</text>", svg.read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("diagram") / "diagram.svg"
    assert run_command("draw-diagram", ["--output", str(path)]) == 0
    return path


@needs_dot
def test_the_picture_names_systems_ports_and_sizes(drawn):
    """Systems, their kinds, their connected ports, and what flows are in the picture."""
    texts = words(drawn)
    for system in ("operator", "retargeting", "action correction", "wrist to arm", "plant", "scene graph"):
        assert system in texts
    for system in ("scene view", "grasp monitor", "glove recorder", "rerun recorder"):
        assert system in texts
    joined = " ".join(texts)
    for port in ("keypoints", "wrist_pose", "arm_desired_state", "hand_desired_state", "contact_results"):
        assert port in joined
    # 21 keypoints of 3 numbers; 16 joints' positions and velocities; 7 of the arm.
    for size in ("63", "32", "14"):
        assert size in joined.split()


@needs_dot
def test_the_picture_tells_nothing_of_where_or_when_it_was_drawn(drawn):
    """No path, no version and no date, so that redrawing changes nothing."""
    text = drawn.read_text(encoding="utf-8")
    assert "<!--" not in text
    assert str(ROOT) not in text and str(Path.home()) not in text and "/tmp" not in text
    assert text.lstrip().startswith("<?xml") and text.rstrip().endswith("</svg>")


@needs_dot
def test_the_picture_in_the_docs_is_up_to_date(drawn):
    """docs/diagram.svg holds the words of the present diagram; redraw it with draw-diagram."""
    assert words(ROOT / "docs" / "diagram.svg") == words(drawn)


@needs_dot
def test_the_delay_in_the_picture_is_the_scenarios(tmp_path):
    """What the scenario changes is in the picture."""
    path = tmp_path / "slow.svg"
    slow = ["--scenario-text", "{operator: {visual_delay: 0.3}}"]
    assert run_command("draw-diagram", ["--output", str(path), *slow]) == 0
    assert any("300 ms" in text for text in words(path))


def test_without_graphviz_the_message_says_what_to_install(tmp_path, monkeypatch):
    """Nothing is written."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(GeortError, match=r"Graphviz.*install"):
        run_command("draw-diagram", ["--output", str(tmp_path / "diagram.svg")])
    assert list(tmp_path.iterdir()) == []

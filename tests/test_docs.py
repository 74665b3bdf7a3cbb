"""Claims of README and docs: snippets run, commands and options exist, defaults are the code's."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from light_training import train_lightly
from pages import PAGES, ROOT, fences, lines_of, title
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from geort_drake import GloveReplay, rerun, synthesize_play
from geort_drake.people.checks import examine, verdict
from geort_drake.people.formats import FORMATS
from geort_drake.resources import models_dir

# -- snippets

SNIPPETS = [
    pytest.param(page, number, id=f"{title(page)}-{number}")
    for page in PAGES
    for number in range(len(fences(page, "python")))
]


@pytest.fixture(scope="module")
def desk(light_desk, play):
    """A folder with the files that snippets name: a checkpoint, recordings, a robot."""
    folder = light_desk
    play.save(folder / "hand.npz")
    np.save(folder / "hand.npy", play.p_HK)
    np.save(folder / "points.npy", 1000 * play.p_HK)
    shutil.copy(models_dir() / "sdf" / "allegro_right.sdf", folder / "hand.sdf")
    shutil.copy(models_dir() / "sdf" / "objects" / "sphere.sdf", folder / "robot.sdf")
    train_lightly("allegro_right", play, folder / "runs" / "allegro_right", "geort")
    return folder


def names_of_a_diagram() -> dict:
    """What the second snippet of the recorder's page takes from the reader's own diagram."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
    Parser(plant).AddModels("hand.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"), RigidTransform())
    plant.Finalize()
    replay = builder.AddSystem(GloveReplay(synthesize_play(0, duration_s=1.0)))

    def source(size):
        return builder.AddSystem(ConstantVectorSource(np.zeros(size))).get_output_port()

    return {
        "builder": builder, "plant": plant, "scene_graph": scene_graph,
        "command_port": source(2), "position_port": source(2),
        "phase_port": source(1), "targets_port": source(3),
        "keypoints_port": replay.GetOutputPort("keypoints"),
        "wrist_pose_port": replay.GetOutputPort("wrist_pose"),
        "valid_port": replay.GetOutputPort("valid"),
        "thumb_bodies": [plant.GetBodyByName("link_15")],
        "index_bodies": [plant.GetBodyByName("link_3")],
        **{name: getattr(rerun, name) for name in dir(rerun) if name.endswith("Spec")},
        "add_rerun_recorder": rerun.add_rerun_recorder,
    }  # fmt: skip


def reader_of_the_glove_page() -> dict:
    """The reader that the page registers, and a file for it."""
    play = synthesize_play(0, duration_s=12.0, rate_hz=60.0)
    wrist_last = np.roll(play.p_HK, -1, axis=1)
    np.savez("markers.npz", markers=1000 * wrist_last, time=play.t, side="right")
    given: dict = {"play": play}
    exec(fences(ROOT / "docs" / "how-to" / "add-a-glove-format.md", "python")[0], given)
    return given


# Snippets that continue the reader's own program, and what they find there.
GIVEN = {
    ("record-with-rerun.md", 1): names_of_a_diagram,
    ("add-a-glove-format.md", 1): reader_of_the_glove_page,
}


def run_snippet(page: Path, number: int) -> dict:
    """The snippet's names after it ran in this folder; formats that it registers are removed again."""
    given = GIVEN.get((page.name, number), dict)()
    code = compile(fences(page, "python")[number], f"{page.name}, snippet {number}", "exec")
    with mock.patch.dict(FORMATS):
        exec(code, given)
    return given


@pytest.mark.parametrize(("page", "number"), SNIPPETS)
def test_a_snippet_runs(page, number, desk, monkeypatch):
    """Every Python snippet runs as it stands, in a folder with the files it names."""
    monkeypatch.chdir(desk)
    recorder = run_snippet(page, number).get("recorder")
    if recorder is not None:
        recorder.close()


@pytest.mark.parametrize(("page", "number"), [("import-a-recording.md", 0), ("add-a-glove-format.md", 1)])
def test_a_glove_of_ones_own_is_read(page, number, desk, play, monkeypatch):
    """The pages' ways to read a file give the hand that is in it, in the wrist frame, m."""
    monkeypatch.chdir(desk)
    given = run_snippet(ROOT / "docs" / "how-to" / page, number)
    read = given["recording"]
    np.testing.assert_allclose(read.p_HK, given.get("play", play).p_HK, atol=1e-6)
    assert read.valid.all() and read.side == "right"
    assert "refused" not in verdict(examine(read)[1])


def test_the_diagram_of_the_docs_moves_the_hand(desk, monkeypatch):
    """The example writes a recording, and the plant follows the retargeter's targets."""
    monkeypatch.chdir(desk)
    given: dict = {}
    exec((ROOT / "examples" / "hand_in_a_diagram.py").read_text("utf-8"), given)
    assert (desk / "play.rrd").stat().st_size > 100_000
    root = given["simulator"].get_context()
    plant, model, retargeting = (given[name] for name in ("plant", "model", "retargeting"))
    q = plant.GetPositions(plant.GetMyContextFromRoot(root), model)
    context = retargeting.GetMyContextFromRoot(root)
    desired = retargeting.GetOutputPort("desired_state").Eval(context)[: len(given["actuated"])]
    measured = [q[plant.GetJointByName(name).position_start()] for name in given["actuated"]]
    start = [given["hand"].default_positions.get(name, 0.0) for name in given["actuated"]]
    assert np.abs(np.array(desired) - start).max() > 0.1
    assert np.abs(np.array(desired) - measured).max() < 0.1


# -- programs and make targets; commands are parsed by test_docs_commands.py


def shown(pattern: str) -> dict[str, str]:
    """Every documented command that begins so → the first page that shows it."""
    found: dict[str, str] = {}
    for page in PAGES:
        for line in lines_of(page):
            if re.match(pattern, line) and "COMMAND" not in line:
                found.setdefault(" ".join(line.split("  #")[0].split()), title(page))
    return found


@pytest.mark.parametrize("line", shown(r"(\w+=\w+ )?python \w+/"))
def test_a_program_and_its_options_exist(line):
    """Programs of the repository that pages name are there; they or their helpers know the options."""
    path, *words = line.split("python ")[1].split()
    assert (ROOT / path).is_file()
    text = "".join(each.read_text("utf-8") for each in (ROOT / path).parent.glob("*.py"))
    assert all(word in text for word in words if word.startswith("--"))


def test_every_make_target_and_link_of_the_readme_exists():
    """`make ...` commands also of the docs, whose links the strict build of the site checks."""
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    used = {line.split()[1] for line in shown(r"make \w")}
    assert used and used <= targets
    text = (ROOT / "README.md").read_text("utf-8")
    linked = [target for target in re.findall(r"\]\(([^)\s]+)\)", text) if not re.match(r"https?:|#", target)]
    assert [target for target in linked if not (ROOT / target).exists()] == []


# -- files, defaults, the site


def test_the_site_builds_and_asks_no_other_host(tmp_path):
    """`mkdocs build --strict`: no dead link, no orphan page; no script, style or font from elsewhere."""
    pytest.importorskip("mkdocs", reason="the docs extra is not installed")
    pytest.importorskip("mkdocstrings", reason="the docs extra is not installed")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr
    for page in tmp_path.rglob("*.html"):
        text = page.read_text("utf-8")
        fetched = re.findall(r'<(?:script|img|iframe)[^>]+src="?(https?:)?//', text)
        fetched += re.findall(r'<link[^>]+rel="?(?:stylesheet|preload)[^>]+href="?(https?:)?//', text)
        assert not fetched, page
        assert "{{" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL), page

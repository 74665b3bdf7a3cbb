"""What README and docs promise is there: snippets run, commands parse, links lead somewhere."""

import dataclasses
import re
import shlex
import shutil
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from script_modules import load_script

from geort_drake.comparison.train import train_checkpoint
from geort_drake.people.checks import examine, verdict
from geort_drake.people.formats import FORMATS
from geort_drake.people.play import synthesize_play
from geort_drake.rerun import recorder as rerun_recorder
from geort_drake.resources import models_dir
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.tasks.grasp.monitor import GraspMonitorConfig
from geort_drake.systems.glove_replay import GloveReplay

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    page
    for page in [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
    if page.name != "index.md"
]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUICK = {
    "steps": 5, "points": 16, "targets": 32, "pinches": 8, "frames": 8, "hidden": 8,
    "classifier_steps": 5, "refreshes": 0,
}  # fmt: skip


def fences(page: Path, *languages: str) -> list[str]:
    return [body for language, body in FENCE.findall(page.read_text("utf-8")) if language in languages]


SNIPPETS = [
    pytest.param(page, number, id=f"{page.name}-{number}")
    for page in PAGES
    for number in range(len(fences(page, "python")))
]


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with the files that the snippets speak of: a checkpoint, a recording, a robot."""
    folder = tmp_path_factory.mktemp("desk")
    play = synthesize_play(0, duration_s=60.0, rate_hz=30.0)
    play.save(folder / "hand.npz")
    shutil.copy(models_dir() / "sdf" / "allegro_right.sdf", folder / "hand.sdf")
    shutil.copy(models_dir() / "sdf" / "objects" / "sphere.sdf", folder / "robot.sdf")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
        train_checkpoint(
            "allegro_right", play, folder / "runs" / "allegro_right", "geort",
            show_progress=False, settings=QUICK, robot_samples=2000,
        )  # fmt: skip
    return folder


def names_of_the_rerun_page() -> dict:
    """What the second snippet of rerun.md takes from the reader's own diagram."""
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
        **{name: getattr(rerun_recorder, name) for name in dir(rerun_recorder) if name.endswith("Spec")},
        "add_rerun_recorder": rerun_recorder.add_rerun_recorder,
    }  # fmt: skip


def points_of_a_glove() -> dict:
    """The file that the first snippet of add_glove.md reads."""
    np.save("points.npy", 1000 * synthesize_play(0, duration_s=12.0, rate_hz=60.0).p_HK)
    return {}


def reader_of_the_gloves_page() -> dict:
    """The reader that the third snippet of add_glove.md registers, and a file for it."""
    play = synthesize_play(0, duration_s=12.0, rate_hz=60.0)
    wrist_last = np.roll(play.p_HK, -1, axis=1)
    np.savez("markers.npz", markers=1000 * wrist_last, time=play.t, side="right")
    given: dict = {"play": play}
    exec(fences(ROOT / "docs" / "add_glove.md", "python")[1], given)
    return given


# Snippets that go on where the reader's own program stops, and what they find there.
GIVEN = {
    ("rerun.md", 1): names_of_the_rerun_page,
    ("add_glove.md", 0): points_of_a_glove,
    ("add_glove.md", 2): reader_of_the_gloves_page,
}


@pytest.mark.parametrize(("page", "number"), SNIPPETS)
def test_a_snippet_runs(page, number, desk, monkeypatch):
    """Every Python snippet runs as it stands, in a folder with the files it names."""
    monkeypatch.chdir(desk)
    given = run_snippet(page, number)
    recorder = given.get("recorder")
    if recorder is not None:
        recorder.close()


def run_snippet(page: Path, number: int) -> dict:
    """Its names after it ran in this folder, without the formats of recordings that it adds."""
    given = GIVEN.get((page.name, number), dict)()
    code = compile(fences(page, "python")[number], f"{page.name}, snippet {number}", "exec")
    with mock.patch.dict(FORMATS):
        exec(code, given)
    return given


@pytest.mark.parametrize("number", [0, 2])
def test_the_page_of_gloves_reads_the_hand_that_a_file_holds(number, tmp_path, monkeypatch):
    """By a few lines and by a reader, in the wrist frame, m, and sound."""
    monkeypatch.chdir(tmp_path)
    read = run_snippet(ROOT / "docs" / "add_glove.md", number)["recording"]
    play = synthesize_play(0, duration_s=12.0, rate_hz=60.0)
    np.testing.assert_allclose(read.p_HK, play.p_HK, atol=1e-6)
    np.testing.assert_allclose(read.t, play.t, atol=1e-9)
    assert read.valid.all() and read.side == "right"
    assert "refused" not in verdict(examine(read)[1])
    if number == 2:
        assert (read.metadata["format"], read.metadata["rate_known"]) == ("my_glove", True)


def test_the_readmes_diagram_moves_the_hand(desk, monkeypatch):
    """The snippet's simulation writes a recording, and the plant follows the retargeter's targets."""
    monkeypatch.chdir(desk)
    body = (ROOT / "examples" / "hand_in_a_diagram.py").read_text("utf-8")
    given: dict = {}
    exec(compile(body, "hand_in_a_diagram.py", "exec"), given)
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


def commands() -> list:
    """Every call of a script in a fenced block or in inline code, with the page it is on."""
    found = []
    for page in PAGES:
        lines = [line for body in fences(page, "sh", "bash") for line in body.splitlines()]
        lines += re.findall(r"`((?:python )?scripts/\w+\.py[^`]*)`", page.read_text("utf-8"))
        found += [pytest.param(line, id=f"{page.name}: {line}") for line in lines if "scripts/" in line]
    return found


@pytest.mark.parametrize("line", commands())
def test_a_command_names_a_script_and_options_that_exist(line, capsys):
    """The script is there and its --help lists every option that the page uses."""
    words = shlex.split(line.replace("[", " ").replace("]", " "), comments=True)
    path = next(word for word in words if word.startswith("scripts/"))
    assert (ROOT / path).is_file()
    with pytest.raises(SystemExit):
        load_script(Path(path).name).main(["--help"])
    known = set(re.findall(r"--\w+", capsys.readouterr().out))
    assert {word.split("=")[0] for word in words if word.startswith("--")} <= known


def test_every_make_target_exists():
    """README's `make ...` commands are targets of the Makefile."""
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    text = (ROOT / "README.md").read_text("utf-8")
    used = set(re.findall(r"(?:^|`)make (\w+)", text, re.MULTILINE))
    assert used
    assert used <= targets


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_files_lead_somewhere(page):
    """Relative links and images exist, and so do the project's files that are named in code style."""
    text = page.read_text("utf-8")
    linked = [
        target.split("#")[0]
        for target in re.findall(r"\]\(([^)\s]+)\)", text)
        if not re.match(r"https?:|#", target)
    ]
    missing = [target for target in linked if not (page.parent / target).exists()]
    named = re.findall(
        r"`((?:geort_drake|models|diagrams|scripts|tests|docs)/[\w/]+(?:\.(?:py|yaml|sdf|md))?)[`:]", text
    )
    missing += [target for target in named if not (ROOT / target).exists()]
    assert missing == []


def test_the_documented_parameters_have_their_defaults():
    """The tables of grasping.md give the values that the code has."""
    text = (ROOT / "docs" / "grasping.md").read_text("utf-8")
    configs = {"operator": OperatorConfig(), "monitor": GraspMonitorConfig()}
    for name, config in configs.items():
        table = text.split(f"| field of `{name}` |")[1].split("\n\n")[0]
        rows = re.findall(r"^\| `(\w+)` \| ([^ |]+) \|", table, re.MULTILINE)
        assert len(rows) > 5
        defaults = dataclasses.asdict(config)
        assert {field: float(value) for field, value in rows} == {field: defaults[field] for field, _ in rows}

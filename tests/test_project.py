"""Dependencies, studies and benchmarks: versions agree, programs start, and studies judge known answers."""

import importlib
import tomllib
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
# They judge the sources or build the site.
TOOLS = {
    "build",
    "cogapp",
    "mypy",
    "ruff",
    "twine",
    "mkdocs",
    "mkdocs-material",
    "mkdocstrings",
    "latex2mathml",
}


def ranges() -> dict[str, Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = [text for extra in project["optional-dependencies"].values() for text in extra]
    wanted = [Requirement(text) for text in project["dependencies"] + extras]
    return {canonicalize_name(item.name): item for item in wanted if item.name != project["name"]}


def pins(file: str) -> dict[str, Version]:
    lines = (ROOT / file).read_text("utf-8").splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): Version(version) for name, version in pairs}


def test_the_oldest_versions_are_the_lower_bounds():
    """Each dependency has one, and it is what `make test-lowest` installs."""
    bounds = {
        name: next(Version(part.version) for part in item.specifier if part.operator in (">=", "=="))
        for name, item in ranges().items()
        if name not in TOOLS
    }
    assert pins("constraints-lowest.txt") == bounds


@pytest.mark.parametrize("name", ranges())
def test_the_newest_version_is_within_the_range(name):
    """Each dependency has one, and it is what `make test` installs."""
    assert pins("constraints.txt")[name] in ranges()[name].specifier


STUDIES = {path.stem for path in (ROOT / "studies").glob("*.py")} - {"affine_map"}
BENCHMARKS = {path.stem for path in (ROOT / "benchmarks").glob("bench_*.py")}
PROGRAMS = [*(f"studies.{name}" for name in STUDIES), *(f"benchmarks.{name}" for name in BENCHMARKS)]


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_a_program_starts_and_explains_itself(program, capsys, monkeypatch):
    """Everything it imports exists, and its help names its options."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    monkeypatch.syspath_prepend(ROOT / "studies")
    with pytest.raises(SystemExit) as stopped:
        importlib.import_module(program).main(["--help"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith("usage:")


def test_every_picture_of_the_docs_can_be_made_anew(monkeypatch):
    """By studies, but for drawings; and it is small enough to load at once."""
    monkeypatch.syspath_prepend(ROOT / "studies")
    pictures = importlib.import_module("studies.pictures")
    for image in (ROOT / "docs" / "images").iterdir():
        made = image.suffix == ".svg" or image.stem in {*pictures.PICTURES, *STUDIES, "live_film"} | {
            study.removeprefix("draw_") for study in STUDIES
        }
        assert made, f"{image} cannot be made anew"
        assert image.stat().st_size < (1_500_000 if image.suffix == ".webp" else 300_000)


def test_gates_tell_a_right_order_from_chance_and_from_a_reversed_one():
    """Ties count for neither."""
    ordering = importlib.import_module("studies.gates").ordering

    def of(*scores: float) -> dict:
        return ordering(
            [
                {"kind": "servo", "seed": seed, "amount": float(amount), "score": score}
                for seed in range(4)
                for amount, score in enumerate(scores)
            ],
            ["servo"],
            range(len(scores)),
        )

    right, reversed_, tied = of(1.0, 1.0, 0.8, 0.2), of(0.2, 0.5, 0.8, 1.0), of(1.0, 1.0, 1.0, 1.0)
    assert right["tau"] == pytest.approx(5 / 6, abs=1e-3) and right["p"] < 0.01 < right["p_reversed"]
    assert reversed_["tau"] == -1 and reversed_["p_reversed"] < 0.01
    assert tied["tau"] == 0 and tied["p"] == tied["p_reversed"] == 1


def test_worsened_maps_mix_turn_or_shrink_the_motion_of_fingers():
    gates = importlib.import_module("studies.gates")
    rest, moved = np.zeros((4, 3)), np.zeros((4, 3))
    moved[1] = 0.01, 0.0, 0.0  # the index finger, out of the palm

    def echo(p_HF):
        return p_HF

    echo.joint_names = ()
    mixed = gates.WorsenedMap(echo, rest, range(4), gates.MIXED, 0.5, 0)(moved)
    np.testing.assert_allclose(mixed, [[0, 0, 0], moved[1], 0.25 * moved[1], 0.25 * moved[1]])
    turned = gates.WorsenedMap(echo, rest, range(4), gates.TURNED, 60.0, 0)(moved)
    assert turned[1, 0] == pytest.approx(0.005) and np.linalg.norm(turned[1]) == pytest.approx(0.01)
    np.testing.assert_allclose(turned[[0, 2, 3]], 0.0)
    shrunk = gates.WorsenedMap(echo, rest, range(4), gates.SHRUNK, 0.75, 0)(moved)
    np.testing.assert_allclose(shrunk, 0.25 * moved)

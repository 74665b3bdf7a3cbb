"""Studies and benchmarks start."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
STUDIES = {path.stem for path in (ROOT / "studies").glob("*.py")} - {
    *("affine_map", "distorted_map", "guided_fuzzing", "predictor_analysis")
}
BENCHMARKS = {path.stem for path in (ROOT / "benchmarks").glob("bench_*.py")}
PROGRAMS = [*(f"studies.{name}" for name in STUDIES), *(f"benchmarks.{name}" for name in BENCHMARKS)]


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_a_program_starts_and_explains_itself(program, capsys, monkeypatch):
    """Everything it imports exists, and its help names its options."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    with pytest.raises(SystemExit) as stopped:
        importlib.import_module(program).main(["--help"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith("usage:")


def test_every_picture_of_the_docs_can_be_made_anew():
    """By studies, but for drawings; and it is small enough to load at once."""
    pictures = importlib.import_module("studies.pictures")
    for image in (ROOT / "docs" / "images").iterdir():
        made = image.suffix == ".svg" or image.stem in {*pictures.PICTURES, *STUDIES, "live_film"}
        assert made, f"{image} cannot be made anew"
        assert image.stat().st_size < (1_500_000 if image.suffix == ".webp" else 300_000)

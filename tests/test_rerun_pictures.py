"""The docs' pictures: what is recorded for them, checked, and cut to size."""

import re
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def pictures():
    from studies import pictures

    return pictures


def test_every_picture_of_the_docs_can_be_made_anew(pictures):
    """And it is small enough to load at once. That of the live page is a browser's."""
    for image in (ROOT / "docs" / "images").iterdir():
        assert image.stem in {*pictures.PICTURES, "live_page"}, f"{image} cannot be made anew"
        assert image.stat().st_size < (1_500_000 if image.suffix == ".webp" else 300_000)


def test_the_readme_begins_with_a_moving_picture(pictures):
    """It can be made anew, loads at once, and its frames are no more than a page needs."""
    (name, suffix), *_ = re.findall(
        r"\]\(docs/images/(\w+)\.(\w+)\)", (ROOT / "README.md").read_text("utf-8")
    )
    assert pictures.PICTURES[name].moves
    path = ROOT / "docs" / "images" / f"{name}.{suffix}"
    assert path.stat().st_size < 1_500_000
    with Image.open(path) as film:
        assert film.n_frames > 20
        film.load()
        assert film.info["duration"] >= 1000 / 12

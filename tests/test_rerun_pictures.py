"""The docs' pictures: what is recorded for them, checked, and cut to size."""

import contextlib
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from script_modules import load_script

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def pictures():
    return load_script("../studies/pictures.py")


def test_every_picture_of_the_docs_can_be_made_anew(pictures):
    """And it is small enough to load at once."""
    for image in (ROOT / "docs" / "images").iterdir():
        assert image.stem in pictures.PICTURES, f"{image} cannot be made anew"
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


def test_a_film_shows_the_scene_from_beginning_to_end(pictures, tmp_path, monkeypatch):
    """One frame per instant, in order, of the part that matters."""
    asked = []

    class Camera:
        end = 1.0

        def take(self, time):
            asked.append(time)
            png = io.BytesIO()
            Image.new("RGB", pictures.SIZE, (round(200 * time), 0, 0)).save(png, "PNG")
            return png.getvalue()

    monkeypatch.setattr("geort_drake.rerun.screenshot.camera", lambda *_: contextlib.nullcontext(Camera()))
    pictures.film(tmp_path / "any.rrd", tmp_path / "any.webp")
    assert asked == [k / pictures.FILM_HZ for k in range(pictures.FILM_HZ)]
    width, height = pictures.SIZE
    left, top, right, bottom = pictures.FILM_PART
    shape = height * (bottom - top) / (width * (right - left))
    with Image.open(tmp_path / "any.webp") as film:
        assert film.n_frames == pictures.FILM_HZ
        assert film.size == (pictures.FILM_WIDTH, pytest.approx(pictures.FILM_WIDTH * shape, abs=1))
        for k in (0, 5):
            film.seek(k)
            shade = np.asarray(film.convert("RGB"))[..., 0]
            assert np.abs(shade.astype(int) - 200 * k / pictures.FILM_HZ).max() < 8

"""The docs' pictures: what is recorded for them, checked, and cut to size."""

import contextlib
import importlib.util
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun_world import World

from geort_drake.errors import GeortError
from geort_drake.systems import _rerun_screenshot

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def pictures():
    spec = importlib.util.spec_from_file_location("make_pictures", ROOT / "scripts" / "make_pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_picture_of_a_recording_has_a_caption(pictures):
    """What the page shows can be made anew, says what it is, and is small enough to load at once."""
    page = (ROOT / "docs" / "rerun.md").read_text("utf-8")
    shown = re.findall(r"\]\(images/(\w+)\.png\)\n\n(.)", page)
    assert shown
    for name, begins in shown:
        assert name in pictures.PICTURES
        assert begins == "*", f"{name} has no caption"
        assert (ROOT / "docs" / "images" / f"{name}.png").stat().st_size < 300_000


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


def test_the_docs_example_is_what_is_photographed(pictures):
    """One snippet of the page makes the recording, with models that come with Drake."""
    codes = [code for code in pictures.snippets(ROOT / "docs" / "rerun.md") if "objects.rrd" in code]
    assert len(codes) == 1
    assert "package://drake/" in codes[0]


def test_a_recording_is_verified_before_it_is_photographed(pictures, tmp_path):
    """Rerun's own tool has the say."""
    world = World().finalize().record(tmp_path / "good.rrd")
    with world.recorder:
        world.simulator.AdvanceTo(0.1)
    pictures.check(tmp_path / "good.rrd")
    (tmp_path / "bad.rrd").write_bytes((tmp_path / "good.rrd").read_bytes()[:5000])
    with pytest.raises(GeortError, match=r"bad.rrd: rerun rrd verify says"):
        pictures.check(tmp_path / "bad.rrd")


def test_a_photograph_is_without_the_viewers_frame(pictures, tmp_path, monkeypatch):
    """Menu and time controls are cut off; few colours make a small file."""
    asked = {}

    def viewer(_recording, picture, *, time, size):
        asked.update(time=time, size=size)
        shade = np.zeros((size[1], size[0], 3), np.uint8)
        shade[: pictures.TOP] = 255
        shade[-pictures.BOTTOM :] = 255
        shade[400, 700] = (10, 200, 30)
        Image.fromarray(shade).save(picture)

    monkeypatch.setattr(_rerun_screenshot, "take_screenshot", viewer)
    pictures.photograph(tmp_path / "any.rrd", tmp_path / "any.png", 2.5)
    assert asked == {"time": 2.5, "size": pictures.SIZE}
    with Image.open(tmp_path / "any.png") as picture:
        width, height = pictures.SIZE
        assert picture.size == (width, height - pictures.TOP - pictures.BOTTOM)
        pixels = np.asarray(picture.convert("RGB"))
    assert pixels[400 - pictures.TOP, 700].tolist() == [10, 200, 30]
    assert (pixels.reshape(-1, 3) != 0).any(axis=1).sum() == 1


def test_a_film_shows_the_scene_from_beginning_to_end(pictures, tmp_path, monkeypatch):
    """One frame per instant, in order, of the part that matters."""
    asked = []

    class Camera:
        end = 1.0

        def take(self, time, view):
            asked.append((time, view))
            png = io.BytesIO()
            Image.new("RGB", (100, 100), (round(200 * time), 0, 0)).save(png, "PNG")
            return png.getvalue()

    monkeypatch.setattr(_rerun_screenshot, "camera", lambda *_: contextlib.nullcontext(Camera()))
    pictures.film(tmp_path / "any.rrd", tmp_path / "any.webp")
    assert asked == [(k / pictures.FILM_HZ, "scene") for k in range(pictures.FILM_HZ)]
    with Image.open(tmp_path / "any.webp") as film:
        assert (film.n_frames, film.size) == (pictures.FILM_HZ, (73, 68))
        for k in (0, 5):
            film.seek(k)
            shade = np.asarray(film.convert("RGB"))[..., 0]
            assert np.abs(shade.astype(int) - 200 * k / pictures.FILM_HZ).max() < 8

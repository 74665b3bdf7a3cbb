"""The docs' pictures: what is recorded for them, checked, and cut to size."""

import contextlib
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun_world import World
from script_modules import load_script

from geort_drake.errors import GeortError

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

    monkeypatch.setattr("geort_drake.rerun.take_screenshot", viewer)
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


def test_one_picture_is_made_by_its_name(pictures, tmp_path, monkeypatch):
    """A drawing is made smaller and stays transparent; what two pictures show is recorded once."""
    made = []

    def draw(folder, _arguments):
        made.append(folder)
        Image.new("RGBA", (8, 6), (200, 10, 10, 0)).save(folder / "drawn.png")

    two = {name: pictures.Picture(draw, "drawn.png") for name in ("one", "two")}
    monkeypatch.setattr(pictures, "PICTURES", two)
    folders = ["--recordings", str(tmp_path / "recordings"), "--output", str(tmp_path / "images")]
    assert pictures.main(["--only", "two", *folders]) == 0
    assert [path.name for path in (tmp_path / "images").iterdir()] == ["two.png"]
    with Image.open(tmp_path / "images" / "two.png") as picture:
        assert (picture.size, picture.mode) == ((8, 6), "P")
        assert picture.convert("RGBA").getpixel((0, 0))[3] == 0
    pictures.main(folders)
    assert len(made) == 2
    with pytest.raises(SystemExit):
        pictures.main(["--only", "three", *folders])


@pytest.mark.slow
def test_the_other_recordings_are_made_of_nothing(pictures, tmp_path):
    """The hand, the capture protocol and a hand's model need neither a recording nor a checkpoint."""
    for name in ("hand", "capture", "add_hand"):
        picture = pictures.PICTURES[name]
        picture.record(tmp_path, None)
        pictures.check(tmp_path / picture.file)

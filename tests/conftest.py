"""Fixtures shared by the tests: seeded generators, and real recordings where they are at hand."""

import dataclasses
import functools
import gc
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pydrake.common.deprecation  # noqa: F401  (registers its warning class for the filters)
import pytest
from shared import FOLDER, synthesized

GLOVE_DIR = Path(__file__).resolve().parents[2] / "shared" / "glove"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--training-seed", type=int, default=0, help="seed of the tests that train")
    parser.addoption("--training-margin", type=float, default=1.0, help="margin of what trainings must reach")


def pytest_configure(config: pytest.Config) -> None:
    """Makes the folder of results that the processes of this run share, and keeps Matplotlib's cache."""
    # Tests give programs an empty cache, in which Matplotlib would list all fonts again, for seconds.
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    os.environ.setdefault("MPLCONFIGDIR", os.path.join(caches, "matplotlib"))
    if not hasattr(config, "workerinput"):
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="geort-drake-tests-")
        config.add_cleanup(lambda: shutil.rmtree(os.environ.pop(FOLDER), ignore_errors=True))


@pytest.fixture
def training_seed(request) -> int:
    return request.config.getoption("--training-seed")


@pytest.fixture
def reaches(request, record_property):
    """Asserts that a figure of a training is below its limit, by the margin of --training-margin.

    Weights depend on the seed and, after some steps, on the processor's kernels. `make test-kernels` runs the
    tests with several of both and a margin of two.
    """
    margin = request.config.getoption("--training-margin")

    def check(name: str, value: float, limit: float) -> None:
        record_property(name, float(limit / value) if value > 0 else float("inf"))
        assert value <= limit / margin, (
            f"{name}: {value:.3g} is not below {limit:g} by a factor of {margin:g}"
        )

    return check


def pytest_collection_finish() -> None:
    """Keeps what the modules have imported out of the collections of garbage that every trial makes."""
    gc.collect()
    gc.freeze()


def _recording_file(name: str) -> Path:
    path = GLOVE_DIR / name
    if not path.is_file():
        pytest.skip(f"the recording {name} is not at hand")
    return path


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20251121)


@pytest.fixture(scope="session")
def alex_npy() -> Path:
    """GeoRT's published recording: float64 (3498, 21, 3), metres, canonical wrist frame."""
    return _recording_file("human_alex.npy")


@pytest.fixture(scope="session")
def manus_npz() -> Path:
    """A raw MANUS recording: (5000, 25, 7) px py pz qw qx qy qz with Unix timestamps."""
    return _recording_file("manus_right_subject-000_run-010.npz")


@pytest.fixture(scope="session")
def play():
    """A minute of synthetic play at 30 Hz, a `Recording`."""
    return synthesized(0, 60.0, 30.0)


@pytest.fixture(scope="module")
def light_benchmark(play):
    """Benchmarks and grasps have a minute of play, few measured calls, and little free play."""
    from geort_drake import methods
    from geort_drake.retargeting import train
    from geort_drake.simulation import trial

    def shorter(seed: int, side: str):
        return dataclasses.replace(play, metadata=play.metadata | {"seed": seed, "side": side})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trial, "PLAY_DURATION", 2.0)
        patch.setattr(methods, "_PARTS", 1)
        patch.setattr(train, "synthesize_play", shorter)
        yield


def _lighten(patch: pytest.MonkeyPatch, cache: Path) -> None:
    """Gives evaluations few samples, so that they are quick and mean little, and trainings another cache."""
    from geort_drake.metrics import evaluation

    patch.setenv("XDG_CACHE_HOME", str(cache))
    patch.setattr(evaluation, "ROBOT_SAMPLES", 500)
    patch.setattr(evaluation, "ENGAGEMENTS", 2)
    for name in ("motion_preservation", "cross_talk", "flatness_and_gain"):
        patch.setattr(evaluation, name, functools.partial(getattr(evaluation, name), anchors=30))
    contexts = functools.partial(evaluation.average_over_context, contexts=2)
    patch.setattr(evaluation, "average_over_context", contexts)
    patch.setattr(evaluation, "call_times", functools.partial(evaluation.call_times, calls=10))


@pytest.fixture
def light_evaluation(tmp_path, monkeypatch):
    """An evaluation with few samples and a cache of its own, where the plumbing is what is tested."""
    _lighten(monkeypatch, tmp_path / "cache")


@pytest.fixture(scope="module")
def light_desk(tmp_path_factory):
    """The same for a whole module, and its folder."""
    with pytest.MonkeyPatch.context() as patch:
        _lighten(patch, tmp_path_factory.mktemp("cache"))
        yield tmp_path_factory.mktemp("desk")


# Models that several modules look at, loaded once; imported only where one is asked for.


@pytest.fixture(scope="session")
def allegro():
    """The right Allegro hand, a `Hand`."""
    return _hand("allegro_right")


@pytest.fixture
def allegro_copy(tmp_path):
    """A copy of the right Allegro's files, to change: its description as a dict, and what loads it."""
    import yaml

    from geort_drake.hands.description import load_hand
    from geort_drake.resources import models_dir

    shutil.copy(models_dir() / "sdf" / "allegro_right.sdf", tmp_path / "hand.sdf")
    facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text(encoding="utf-8"))
    facts["model"] = "hand.sdf"

    def load():
        (tmp_path / "hand.yaml").write_text(yaml.safe_dump(facts), encoding="utf-8")
        return load_hand(tmp_path / "hand.yaml")

    return facts, load


@pytest.fixture(scope="session")
def allegro_left():
    """The left Allegro hand, a `Hand`."""
    return _hand("allegro_left")


@pytest.fixture(scope="session")
def leap():
    """The right LEAP hand, a `Hand`."""
    return _hand("leap_right")


@pytest.fixture(scope="session")
def panda():
    """The Panda on the world's origin, a `Scene`."""
    from model_scene import Scene

    from geort_drake.resources import models_dir

    return Scene(models_dir() / "sdf" / "panda.sdf", welded=("panda_link0",))


def _hand(name: str):
    from geort_drake.hands.hand import Hand

    return Hand(name)

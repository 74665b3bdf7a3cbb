"""The cache of trained checkpoints: equal requests share one, and only what decides the weights counts."""

from pathlib import Path

import pytest
from light_training import train_lightly

from geort_drake import files
from geort_drake.comparison import train as comparison_train
from geort_drake.comparison.train import cached_checkpoint
from geort_drake.errors import UnknownNameError


@pytest.fixture
def trained(light_evaluation, monkeypatch):
    """A list that grows with every training; trainings are short."""
    runs = []

    def train(hand, recording, path, method, seed, device, settings):
        runs.append(method)
        return train_lightly(hand, recording, path, method, seed, **settings)

    monkeypatch.setattr(comparison_train, "train_checkpoint", train)
    return runs


def test_equal_requests_share_a_checkpoint(trained, play, monkeypatch):
    """Other settings, another method or other code do not."""

    def cached(method="linear_offline", **settings):
        return cached_checkpoint("allegro_right", play, method, settings=settings)

    paths = [cached(points=16), cached(points=16), cached(points=24), cached("geort", pinch_weight=0.5)]
    monkeypatch.setattr(comparison_train, "source_digest", lambda *subpackages: "other")
    paths.append(cached(points=16))
    assert paths[0] == paths[1]
    assert len(set(paths)) == len(trained) == 4
    with pytest.raises(UnknownNameError, match="setting of linear_offline 'speed'"):
        cached(speed=1)


def test_warnings_of_the_training_are_repeated(trained, play):
    """A checkpoint whose training stopped early is not handed out silently the second time."""
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="stopped being finite"):
            cached_checkpoint("allegro_right", play, "linear_offline", settings={"learning_rate": 1e30})
    assert len(trained) == 1


def test_the_key_survives_what_tests_and_calls_leave_behind(monkeypatch):
    """Compiling the call with numba writes into the package; the digest of the sources stays."""
    before = files.source_digest("retargeting")
    cache = Path(files.__file__).parent / "retargeting" / "__pycache__"
    cache.mkdir(exist_ok=True)
    left = cache / "compiled.test-1.py311.nbi"
    left.write_bytes(b"compiled")
    try:
        assert files.source_digest("retargeting") == before
    finally:
        left.unlink()

"""A map that was trained on one person, fitted to another."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics, toy_samples
from script_modules import SCRIPTS, load_script

from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.comparison.train import train_checkpoint
from geort_drake.errors import CheckpointError, RecordingError, TrainingError
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.checkpoint import load_checkpoint, save_checkpoint
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.refit import (
    FINE_TUNING,
    AffineMaps,
    _start_from,
    fine_tune,
    fit_affine,
    folded,
    refit,
)
from geort_drake.retargeting.methods.coupled.retargeter import CoupledRetargeter
from geort_drake.retargeting.methods.coupled.training import CoupledConfig, train_coupled
from geort_drake.retargeting.retargeter import Retargeter, load_retargeter
from geort_drake.retargeting.trained_space import TrainedSpace, trained_points
from geort_drake.retargeting.training.networks import RetargetingNetwork

NAMES = ("thumb", "index", "middle")
KEYPOINTS = (4, 8, 12)
SMALL = {"hidden": 8, "residual_hidden": 6, "points": 8, "targets": 8, "context_targets": 4, "pinches": 8,
         "frames": 8, "collisions": 8}  # fmt: skip


@pytest.fixture(scope="module")
def hand():
    return toy_kinematics(NAMES)


@pytest.fixture(scope="module")
def person(hand):
    """Fingertips of the person that was trained on: smooth motion, so that neighbours are near."""
    return toy_human(hand, frames=3000)


def space_of(p_HF):
    return TrainedSpace(trained_points(p_HF), KEYPOINTS)


def other(p_HF):
    """The same hand, larger and elsewhere: each axis of each finger in its own way."""
    stretch = np.array([[1.2, 0.9, 1.1], [1.1, 1.15, 0.95], [0.9, 1.1, 1.2]])
    return stretch * p_HF + np.array([[0.01, 0.02, -0.01], [0.0, 0.015, 0.01], [0.005, -0.01, 0.02]])


@pytest.mark.parametrize("kind", ["geort", "geort_coupled"])
def test_folding_is_calling_the_map_afterwards(hand, person, kind, rng):
    """For any affine maps the folded weights answer as the old ones do at the mapped fingertips."""
    network_type, retargeter_type, widths = {
        "geort": (RetargetingNetwork, Retargeter, (16,)),
        "geort_coupled": (CoupledNetwork, CoupledRetargeter, (16, 12)),
    }[kind]
    mean, scale = torch.tensor(person.mean(axis=0)), torch.tensor(person.std(axis=0))
    network = network_type(hand, mean, scale, *widths, torch.Generator().manual_seed(0))
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.5, generator=torch.Generator().manual_seed(1))
    maps = AffineMaps(
        np.eye(3) + 0.3 * rng.normal(size=(3, 3, 3)), 0.02 * rng.normal(size=(3, 3)), np.zeros(3)
    )
    given = NAMES, hand.joint_names, KEYPOINTS, hand.lower, hand.upper
    before = retargeter_type(network.arrays(), *given)
    after = retargeter_type(folded(network.arrays(), maps), *given)
    np.testing.assert_allclose(after(person[:50]), before(maps(person[:50])), atol=1e-9)


def test_the_map_between_two_people_is_found(person):
    """Of a hand that is the trained one, stretched and moved, every fingertip lands where it was trained."""
    person = person + np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.2, 0.0]])  # too far apart to pinch
    maps = fit_affine(space_of(person), other(person), NAMES)
    off = np.linalg.norm(maps(other(person)) - person, axis=-1)
    assert off.mean() < 0.003, off.mean(axis=0)
    assert (maps.miss < 0.003).all()
    stretched = np.array([np.diag(A) for A in maps.A])
    assert (stretched > 0.7).all()
    assert (stretched < 1.3).all()


def test_pinches_tie_the_fingers(person, rng, monkeypatch):
    """Where two tips of the new person meet, the map keeps them nearer to each other than without ties."""
    rows = rng.permutation(len(person))[:600]

    def pinching(p_HF):
        p_HF = p_HF.copy()
        p_HF[rows, 0] = p_HF[rows, 1] = 0.5 * (p_HF[rows, 0] + p_HF[rows, 1])
        return p_HF

    def apart():
        maps = fit_affine(space_of(pinching(person)), pinching(other(person)), NAMES)
        mapped = maps(pinching(other(person))[rows])
        return np.median(np.linalg.norm(mapped[:, 0] - mapped[:, 1], axis=1))

    tied = apart()
    monkeypatch.setattr("geort_drake.retargeting.methods.coupled.refit.PINCH_SHARE", 0.0)
    assert tied < 0.6 * apart()


def test_weights_are_taken_over_exactly(hand, person):
    """A network that starts from weights answers as they do, whatever its own normalisation is."""

    def network(mean, seed):
        generator = torch.Generator().manual_seed(seed)
        return CoupledNetwork(
            hand, torch.tensor(mean), torch.full((3, 3), 0.02 + 0.01 * seed), 16, 12, generator
        )

    old, new = network(person.mean(axis=0), 0), network(person.mean(axis=0) + 0.03, 1)
    for parameter in old.parameters():
        torch.nn.init.normal_(parameter, std=0.3, generator=torch.Generator().manual_seed(2))
    _start_from(new, old.arrays())
    p = torch.tensor(person[:20], dtype=torch.float32)
    torch.testing.assert_close(new(p), old(p), atol=1e-4, rtol=1e-4)


def test_fine_tuning_goes_down_the_losses(hand, person):
    """From the weights of one person, on the hands of another; equal seeds give equal weights."""
    config = CoupledConfig(**SMALL, steps=60, learning_rate=0.01, averaging=0.9)
    trained = train_coupled(person, hand, toy_samples(hand), dataclasses.replace(config, steps=150), seed=0)
    maps = fit_affine(space_of(person), other(person), NAMES)
    start = folded(trained.network.arrays(), maps)
    arrays, history = fine_tune(start, other(person), hand, toy_samples(hand), None, config, seed=0)
    again, _ = fine_tune(start, other(person), hand, toy_samples(hand), None, config, seed=0)
    assert np.mean([row["total"] for row in history[-10:]]) < np.mean([row["total"] for row in history[:5]])
    for name, array in arrays.items():
        assert array.shape == start[name].shape
        np.testing.assert_array_equal(array, again[name])
    assert not np.array_equal(arrays["weight1"], start["weight1"])


def test_weights_of_another_hand_are_refused(hand):
    """With the array's name and both shapes."""
    generator = torch.Generator().manual_seed(0)
    arrays = CoupledNetwork(hand, torch.zeros(3, 3), torch.ones(3, 3), 8, 6, generator).arrays()
    network = CoupledNetwork(toy_kinematics(NAMES[:2]), torch.zeros(2, 3), torch.ones(2, 3), 8, 6, generator)
    with pytest.raises(TrainingError, match=r"weight0 must be of shape \(2, 3, 8\), it is \(3, 3, 8\)"):
        _start_from(network, {**arrays, "columns": network.arrays()["columns"]})


def test_without_fine_tuning_only_the_reading_layers_change(hand, person):
    """`refit` with nothing to tune."""
    generator = torch.Generator().manual_seed(0)
    network = CoupledNetwork(hand, torch.zeros(3, 3), torch.ones(3, 3), 8, 6, generator)
    result = refit(network.arrays(), space_of(person), other(person), NAMES)
    changed = [
        name for name, array in network.arrays().items() if not np.array_equal(array, result.arrays[name])
    ]
    assert changed == ["weight0", "bias0", "residual_weight0", "residual_bias0"]
    assert result.history == []


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A quickly trained checkpoint of the Allegro hand."""
    folder = tmp_path_factory.mktemp("refit")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
        play = synthesize_play(0, 60.0, 30.0)
        settings = {**SMALL, "steps": 20}
        train_checkpoint(
            "allegro_right", play, folder / "old", show_progress=False, settings=settings, robot_samples=2000
        )
        yield folder


def test_the_script_writes_an_ordinary_checkpoint(trained):
    """It loads, answers, knows where the new person's fingertips were, and says where it came from."""
    hand = synthesize_play(5, 40.0, 30.0)
    hand = dataclasses.replace(hand, p_HK=1.1 * hand.p_HK)
    hand.save(trained / "hand.npz")
    arguments = [str(trained / "old"), str(trained / "hand.npz"), str(trained / "new"), "--steps", "10"]
    load_script("refit_retargeter.py").main(arguments)
    old, new = load_checkpoint(trained / "old"), load_checkpoint(trained / "new")
    retarget = load_retargeter(trained / "new")
    q = retarget(hand.p_HK[:30])
    assert np.isfinite(q).all()
    assert not np.allclose(q, load_retargeter(trained / "old")(hand.p_HK[:30]))
    assert retarget.trained_space.distances(hand.p_HK[100]).max() < 0.012
    assert new.provenance["refit"]["from_recording"] == old.provenance["recording"]
    assert new.provenance["recording"]["sha256"] == hand.digest
    assert json.loads((trained / "new" / "metrics.json").read_text())["recording_sha256"] == hand.digest
    assert new.config["joint_names"] == old.config["joint_names"]


def test_a_refit_wants_what_its_checkpoint_was_trained_for(trained, monkeypatch):
    """But for the descent itself, which starts from a map that nearly fits."""
    given = {}

    def tune(arrays, *, config, **_):
        given["config"] = config
        return arrays, []

    monkeypatch.setattr("geort_drake.comparison.refit.fine_tune", tune)
    refit_checkpoint(trained / "old", synthesize_play(5, 12.0, 30.0), trained / "again", steps=10)
    assert given["config"] == dataclasses.replace(FINE_TUNING, **SMALL, steps=10)


def test_a_checkpoint_that_does_not_know_its_places_is_refused(trained):
    """As those of version 0.1."""
    old = load_checkpoint(trained / "old")
    arrays = {name: array for name, array in old.arrays.items() if name != "trained_points"}
    save_checkpoint(
        trained / "blind", arrays, method="geort_coupled", hand=old.hand,
        human_keypoints=old.config["human_keypoints"], training={}, provenance={}, history=[],
    )  # fmt: skip
    synthesize_play(5, 12.0, 30.0).save(trained / "short.npz")
    with pytest.raises(CheckpointError, match="does not say where training saw"):
        load_script("refit_retargeter.py").main(
            [str(trained / "blind"), str(trained / "short.npz"), str(trained / "x")]
        )


def test_the_other_side_is_refused(trained):
    """A right robot hand does not learn from a left hand's recording."""
    left = synthesize_play(5, 12.0, 30.0, side="left")
    with pytest.raises(RecordingError, match="of a left hand, the robot's is a right hand"):
        refit_checkpoint(trained / "old", left, trained / "x")


def test_help_and_docs_give_the_steps_that_a_refit_takes(capsys):
    """The program's help holds the number, as reading it from the code would take a second of imports."""
    with pytest.raises(SystemExit):
        load_script("refit_retargeter.py").main(["--help"])
    assert f"(default: {FINE_TUNING.steps})" in " ".join(capsys.readouterr().out.split())
    assert f"for {FINE_TUNING.steps} more steps" in (SCRIPTS.parent / "docs" / "people.md").read_text()

"""Training settings given as text and in a hand's description."""

import dataclasses
import json

import pytest
import yaml

from geort_drake.cli import run_command
from geort_drake.comparison.train import training_config
from geort_drake.errors import GeortError, HandError
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.resources import models_dir
from geort_drake.retargeting.methods.geort import GeortConfig
from geort_drake.retargeting.methods.linear_offline import LinearConfig
from geort_drake.settings import parse_settings


@dataclasses.dataclass
class Config:
    steps: int = 10
    rate: float = 0.5
    exact: bool = True
    mode: str = "slow"
    extent: tuple = (1, 2)


def test_values_get_the_type_of_the_default():
    """Numbers, truth values and texts, also those with an equals sign; the last of a name counts."""
    texts = ["steps=20", "rate=1e-3", "exact=False", "mode=a=b", "steps=30"]
    assert parse_settings(texts, Config, "x") == {"steps": 30, "rate": 1e-3, "exact": False, "mode": "a=b"}
    assert parse_settings([], Config(), "x") == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("steps", "setting of the toy is given as NAME=VALUE, not as 'steps'"),
        ("steps=1.5", "must be int, not '1.5'"),
        ("exact=1", "must be true or false, not '1'"),
        ("extent=3", "unknown setting of the toy 'extent'; choose one of: exact, mode, rate, steps"),
    ],
)
def test_what_is_no_setting_is_refused(text, message):
    """Form, type and name, each with what was expected."""
    with pytest.raises(GeortError, match=message):
        parse_settings([text], Config, "the toy")


OWN = {"geort": {"steps": 6, "coverage_weight": 3.5}, "geort_coupled": {"closed_target": 0.99}}


@pytest.fixture
def described(tmp_path):
    """Writes a description of the Allegro with these settings, and returns its path."""

    def write(training):
        facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text())
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(facts | {"training": training}))
        return path

    return write


def test_they_replace_defaults_and_yield_to_explicit_settings(described):
    """Only of the named method, and with the type of the setting."""
    hand = load_hand(described(OWN))
    assert training_config("geort", hand=hand) == GeortConfig(steps=6, coverage_weight=3.5)
    assert isinstance(training_config("geort", hand=hand).steps, int)
    assert training_config("geort", {"steps": 9}, hand).steps == 9
    assert training_config("linear_offline", hand=hand) == LinearConfig()
    assert training_config("geort_coupled", hand=hand).closed_target == 0.99


def test_they_do_not_change_the_digest(described):
    """So a checkpoint fits the hand whatever its settings."""
    assert HandModel(load_hand(described(OWN))).digest == HandModel(load_hand("allegro_right")).digest


@pytest.mark.usefixtures("light_evaluation")
def test_training_uses_and_records_them(described, tmp_path):
    """The checkpoint's configuration holds them."""
    synthesize_play(5, 12.0, 30.0).save(tmp_path / "play.npz")
    hand = described({"linear_offline": {"steps": 6, "hidden": 9}})
    command = ["--hand", str(hand), "--recording", str(tmp_path / "play.npz"), "--method", "linear_offline"]
    rest = ["--robot_samples", "2000", "--set", "points=5", "--quiet"]
    assert run_command("train", [*command, *rest, "--output", str(tmp_path / "map")]) == 0
    training = json.loads((tmp_path / "map" / "config.json").read_text())["training"]
    assert (training["steps"], training["hidden"], training["points"]) == (6, 9, 5)


@pytest.mark.parametrize(
    ("training", "message"),
    [
        ({"geort_couple": {}}, "training: unknown retargeting method 'geort_couple'.*geort_coupled"),
        ({"geort": {"step": 1}}, "training: unknown setting of geort 'step'.*steps"),
        ({"geort": {"steps": 1.5}}, "training: setting steps of geort: must be int, not '1.5'"),
        ({"geort": {"coverage_weight": float("nan")}}, "training: .*coverage_weight must be"),
    ],
)
def test_bad_settings_are_refused_with_hand_and_field(described, training, message):
    """Before anything is trained."""
    with pytest.raises(HandError, match=f"hand 'allegro_right': {message}"):
        training_config("geort", hand=load_hand(described(training)))


def test_add_hand_checks_them(described):
    """For every method, when it checks a description."""
    run_command("add-hand", [str(described(OWN))])
    with pytest.raises(HandError, match="training: unknown setting of linear_offline 'closed_target'"):
        run_command("add-hand", [str(described({"linear_offline": {"closed_target": 0.9}}))])

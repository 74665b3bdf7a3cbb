"""Hands by name: their models, found or not, their maps, the order of their motors, and left hands."""

import dataclasses
import functools
import importlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from grasp_setup import stage_of
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake import (
    Hand,
    RetargetingSystem,
    add_hand_model,
    load_hand,
    load_retargeter,
    load_scenario,
    run_trial,
)
from geort_drake.cli import run_command
from geort_drake.errors import GeortError, HandError
from geort_drake.hands.assembly import HandInPlant
from geort_drake.hands.model_search import MODEL_FOLDERS, find_model
from geort_drake.people.synthetic.population import sample_person
from geort_drake.resources import hand_names, models_dir
from geort_drake.retargeting.base import kinematics_of
from geort_drake.retargeting.numpy_kinematics import MIRROR_TOLERANCE_M, match_joints
from geort_drake.retargeting.store import shipped_maps
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import TrialBuilder

SHARED_WUJI = Path(__file__).resolve().parents[2] / "shared" / "hands" / "wuji"
# The orders in which the makers' software takes angles, by the joints' names.
MOTORS = {
    "allegro_left": [f"joint_{number}" for number in range(16)],
    "leap_left": [f"joint_{number}" for number in range(16)],
    # PSYONIC: index, middle, ring, little, thumb flexor, thumb rotator.
    "ability_right": ["index_q1", "middle_q1", "ring_q1", "pinky_q1", "thumb_q2", "thumb_q1"],
    # Inspire: little, ring, middle, index, thumb bending, thumb rotation.
    "inspire_right": [
        *(f"{finger}_proximal_joint" for finger in ("pinky", "ring", "middle", "index")),
        "thumb_proximal_pitch_joint",
        "thumb_proximal_yaw_joint",
    ],
    "wuji_right": [f"right_finger{finger}_joint{joint}" for finger in range(1, 6) for joint in range(1, 5)],
}
LEFT_HANDS = [name for name in sorted(shipped_maps()) if name.endswith("_left")]


@pytest.fixture(scope="module")
def hands():
    """Loads hands by name, with the shared models; skips where a model is missing."""
    patch = pytest.MonkeyPatch()
    patch.setenv(MODEL_FOLDERS, str(SHARED_WUJI))

    @functools.cache
    def load(name: str) -> Hand:
        try:
            find_model(load_hand(name))
        except HandError as error:
            pytest.skip(str(error))
        return Hand(name)

    yield load
    patch.undo()


@pytest.mark.parametrize("name", hand_names())
def test_a_description_says_where_its_model_is_and_under_which_licence(name):
    hand = load_hand(name)
    assert hand.side in name
    if not hand.model.startswith("package://geort_drake/"):
        source = hand.source
        assert source.get and source.published and source.licence and len(source.sha256) == 64


@pytest.mark.parametrize("name", sorted(MOTORS.keys() & shipped_maps().keys()))
def test_angles_are_told_in_the_order_of_the_makers_software(name):
    retarget = load_retargeter(name)
    assert [retarget.joint_names[column] for column in retarget.motor_columns] == MOTORS[name]


@pytest.mark.parametrize("name", sorted(shipped_maps()))
def test_a_map_has_the_joints_and_limits_of_the_hands_model(name, hands):
    hand = hands(name)
    retarget = load_retargeter(name, hand)  # a warning about the model is an error in tests
    np.testing.assert_array_equal(retarget.lower, hand.lower)
    np.testing.assert_array_equal(retarget.upper, hand.upper)


@pytest.mark.parametrize("name", LEFT_HANDS)
def test_a_left_hands_map_moves_the_mirror_image_of_the_right_hands_fingertips(name, hands):
    left, right = hands(name), hands(name.replace("left", "right"))
    assert match_joints(right.kinematics(), kinematics_of(left)) is not None
    p_HK = sample_person(7, 0).record(2.0, 30.0).p_HK
    tips = [
        np.array([1.0, sign, 1.0]) * hand.fingertips(load_retargeter(hand.description.name)(p_HK))
        for hand, sign in ((left, -1.0), (right, 1.0))
    ]
    np.testing.assert_allclose(*tips, atol=MIRROR_TOLERANCE_M)


def test_a_hand_with_another_range_is_no_mirror_image(allegro, allegro_left):
    left = kinematics_of(allegro_left)
    assert match_joints(allegro.kinematics(), left) is not None
    assert match_joints(allegro.kinematics(), dataclasses.replace(left, upper=left.upper + 0.1)) is None


def published_hand(tmp_path: Path, sha256: str = "") -> Path:
    """Writes a description of the right Allegro hand whose model is in a package."""
    facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text("utf-8"))
    facts["model"] = "package://some_hands/hand.sdf"
    facts["source"] = {"get": "pip install some-hands", "published": "some-hands 1.0", "sha256": sha256}
    path = tmp_path / "hand.yaml"
    path.write_text(yaml.safe_dump(facts))
    return path


def test_a_missing_model_is_named_with_the_command_that_gets_it(tmp_path):
    description = load_hand(published_hand(tmp_path))
    with pytest.raises(HandError, match=r"some-hands 1\.0.*pip install some-hands.*GEORT_DRAKE_MODELS"):
        Hand(description)


@pytest.mark.parametrize("place", ["package", "some_hands", "some-hands", "."])
def test_a_model_is_found_in_a_package_or_a_folder_of_the_users(place, tmp_path, monkeypatch):
    folder = tmp_path / ("some_hands" if place == "package" else place)
    folder.mkdir(exist_ok=True)
    (folder / "hand.sdf").write_bytes(find_model(load_hand("allegro_right")).read_bytes())
    if place == "package":
        monkeypatch.syspath_prepend(tmp_path)
        importlib.invalidate_caches()
    else:
        monkeypatch.setenv(MODEL_FOLDERS, str(tmp_path))
    description = load_hand(published_hand(tmp_path))
    assert find_model(description) == folder / "hand.sdf"
    assert Hand(description).joint_names == Hand("allegro_right").joint_names


def test_another_version_of_a_model_causes_a_warning(tmp_path, monkeypatch):
    monkeypatch.setenv(MODEL_FOLDERS, str(tmp_path))
    (tmp_path / "hand.sdf").write_bytes(find_model(load_hand("allegro_right")).read_bytes())
    with pytest.warns(RuntimeWarning, match="differs from some-hands 1.0"):
        Hand(published_hand(tmp_path, "0" * 64))


@pytest.mark.slow
def test_a_training_has_two_stages_and_makes_the_map_of_the_mirror_image(tmp_path, monkeypatch):
    people = np.stack([sample_person(7, number).record(10.0, 30.0).p_HK for number in range(2)])
    monkeypatch.setattr("geort_drake.people.synthetic.population.sample_population", lambda *_: people)
    settings = ("steps=4", "people=2", "robot_samples=500", "people_per_batch=2", "moved=4", "anchors=20")
    command = ["--universal", "--hand", "leap_right", "--output", str(tmp_path / "leap_right.safetensors")]
    command += ["--quiet", *(word for each in settings for word in ("--set", each))]
    assert run_command("train", command) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"leap_right.safetensors", "leap_left.safetensors"}
    retarget = load_retargeter(tmp_path / "leap_left.safetensors", Hand("leap_left"))
    assert retarget.info["config"]["steps"] == 1 and retarget.info["first_config"]["steps"] == 4


@pytest.mark.parametrize("hand", ["my_hand.yaml", "allegro"])
def test_a_training_for_a_missing_hand_ends_at_once(hand, tmp_path, monkeypatch):
    """Before minutes are spent on synthetic people."""
    monkeypatch.setattr("geort_drake.people.synthetic.population.sample_population", pytest.fail)
    with pytest.raises(GeortError, match=hand):
        run_command("train", ["--universal", "--hand", hand, "--output", str(tmp_path / "map.safetensors")])


@pytest.mark.parametrize("name", sorted(shipped_maps()))
def test_a_shipped_map_fits_its_hand_in_a_diagram(name, hands):
    """Joints that others follow have narrower limits in the map than in the model."""
    hands(name)
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    model = add_hand_model(plant, name)
    plant.Finalize()
    RetargetingSystem(load_retargeter(name), plant, model)


def test_fingertip_meshes_of_a_trial_are_coarse(hands):
    """Wuji's have up to 1,053 vertices, some of which nearly coincide."""
    description, builder = hands("wuji_right").description, DiagramBuilder()
    stage = stage_of(builder, load_scenario(hand="wuji_right"), description)
    inspector = builder.GetSubsystemByName("scene_graph").model_inspector()
    tips = HandInPlant(stage.plant, description, stage.hand).tip_geometries(inspector)
    assert all(inspector.GetShape(tip).GetConvexHull().num_vertices() < 200 for tip in tips)


@pytest.mark.slow
def test_a_hand_whose_fingertips_are_meshes_holds_the_cube(hands):
    """Published meshes have triangles with hardly any area, at which Drake ended the trial."""
    hand = hands("wuji_right")
    scenario = load_scenario(hand="wuji_right", text="{kind: servo}")
    find_task("grasp").choose(scenario, "cube")
    trial = TrialBuilder(hand).trial(scenario, load_retargeter("wuji_right", hand))
    result, _ = run_trial(scenario, trial.retarget, trial.human)
    assert result.success

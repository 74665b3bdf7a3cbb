"""Files give back the map that was saved, and are refused where they are damaged or for another hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from faults.sound import TIPS, map_file, play, smooth_arrays

from geort_drake import load_retargeter
from geort_drake.errors import GeortError, MapError
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.clouds import trained_points
from geort_drake.retargeting.mlp import MlpRetargeter
from geort_drake.retargeting.store import shipped_maps


def test_a_file_gives_the_map_back(tmp_path, allegro, rng):
    """Same outputs, names and trained points after saving and loading; an earlier file is replaced."""
    map_file(tmp_path, history=[{"step": 1}, {"step": 2}])
    path = map_file(tmp_path, metrics={"coverage": 0.5})
    p, loaded = rng.normal(0.05, 0.05, (50, 4, 3)), load_retargeter(path, allegro)
    names = allegro.finger_names, allegro.joint_names
    arrays = {name: array.astype(np.float32) for name, array in smooth_arrays().items()}
    saved = MlpRetargeter(*names, TIPS, allegro.lower, allegro.upper, arrays)
    np.testing.assert_array_equal(loaded(p), saved(p))
    assert (list(loaded.finger_names), list(loaded.joint_names)) == tuple(map(list, names))
    assert loaded.robot_hands == ("allegro_right",)
    assert loaded.info["metrics"] == {"coverage": 0.5} and loaded.info["history"] == [
        {"step": 0, "total": 1.0}
    ]
    expected = trained_points(play().p_HK[:, list(TIPS)].astype(float))
    np.testing.assert_array_equal(loaded.trained_points, expected)
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.safetensors"]


def test_a_flipped_byte_in_the_header_and_a_short_file_are_refused(tmp_path):
    path = map_file(tmp_path)
    whole = path.read_bytes()
    for contents, message in (
        (whole[:-9], "not a safetensors file"),
        (whole.replace(b'\\"format\\": 2', b'\\"format\\": 7'), "format is 7"),
        (whole.replace(b"bias0", b"biasX"), "'bias0' is missing"),
        (whole.replace(b"geort_drake", b"other_drake", 1), "not a map of geort-drake"),
    ):
        assert contents != whole
        path.write_bytes(contents)
        with pytest.raises(MapError, match=rf"map\.safetensors.*{message}"):
            load_retargeter(path)


def test_a_map_for_another_hand_is_refused_and_for_another_version_causes_a_warning(tmp_path, allegro):
    """Joints and fingers must agree; the message has both sides."""
    path = map_file(tmp_path)
    facts = {name: getattr(allegro, name) for name in ("finger_names", "joint_names", "digest")}
    other = SimpleNamespace(**facts | {"joint_names": ["a", "b"]})
    with pytest.raises(MapError, match=r"another hand \(allegro_right\).*joint_12.*expected a, b"):
        load_retargeter(path, other)
    namesake = SimpleNamespace(**facts, description=SimpleNamespace(name="allegro_left"))
    with pytest.raises(MapError, match="is for allegro_right, not for the robot hand allegro_left"):
        load_retargeter(path, namesake)
    with pytest.warns(RuntimeWarning, match="another version of the hand's model"):
        load_retargeter(path, SimpleNamespace(**facts | {"digest": "def"}))


def test_a_failed_save_leaves_the_earlier_file(tmp_path, allegro):
    """NaN is no JSON, and a method without weights has nothing to save."""
    path = map_file(tmp_path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        map_file(tmp_path, metrics={"coverage": float("nan")})
    with pytest.raises(GeortError, match="a Hold has no weights"):
        METHODS["hold"].fit(allegro).save(path)
    assert path.read_bytes() == before and [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_shipped_maps_load_by_the_name_of_their_hand(allegro, leap):
    """An unknown name lists the choices, and so does a method for a hand without one."""
    for hand in (allegro, leap):
        name = hand.description.name
        retarget = load_retargeter(name, hand)
        assert name in retarget.robot_hands and list(retarget.joint_names) == list(hand.joint_names)
        assert METHODS["universal"].fit(hand).robot_hands == retarget.robot_hands
    with pytest.raises(MapError, match=r"no such map.*allegro_right"):
        load_retargeter("allegro_middle")
    other = SimpleNamespace(description=SimpleNamespace(name="claw"))
    with pytest.raises(MapError, match=f"shipped for claw, only for {', '.join(shipped_maps())}"):
        METHODS["universal"].fit(other)

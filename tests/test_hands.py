"""Hand descriptions, the exact hand model, and the sampled robot data."""

import dataclasses as dc
import shutil

import numpy as np
import pytest
import torch
import yaml
from model_scene import SHIPPED_HANDS
from scipy.optimize import minimize

from geort_drake.errors import HandError, UnknownNameError
from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.description import HandDescription, hand_names, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.hands.samples import robot_data
from geort_drake.resources import models_dir
from geort_drake.retargeting.baselines.numpy_kinematics import NumpyKinematics


@pytest.fixture(scope="module")
def allegro() -> HandModel:
    return HandModel(load_hand("allegro_right"))


@pytest.fixture
def copied(tmp_path):
    """A copy of the Allegro's description and model: (description as a dict, function that loads it)."""
    shutil.copy(models_dir() / "sdf" / "allegro_right.sdf", tmp_path / "hand.sdf")
    facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text(encoding="utf-8"))
    facts["model"] = "hand.sdf"

    def load() -> HandDescription:
        (tmp_path / "hand.yaml").write_text(yaml.safe_dump(facts), encoding="utf-8")
        return load_hand(tmp_path / "hand.yaml")

    return facts, load


def _uniform(hand: HandModel, rng, count: int) -> np.ndarray:
    return rng.uniform(hand.lower, hand.upper, (count, len(hand.joint_names)))


def test_fingers_come_thumb_first_and_joints_finger_by_finger():
    """The order of q is the description's, whatever order the plant has."""
    hand = load_hand("allegro_right")
    assert hand.finger_names == ["thumb", "index", "middle", "ring"]
    assert hand.joint_names == [f"joint_{i}" for i in (12, 13, 14, 15, *range(12))]
    assert [finger.human_keypoint for finger in hand.fingers] == [4, 8, 12, 16]


def test_hands_are_known_by_the_names_of_their_files(monkeypatch, tmp_path):
    """Those that come along, and one that a user puts beside them."""
    assert set(SHIPPED_HANDS) <= set(hand_names())
    (tmp_path / "hands").mkdir()
    text = (models_dir() / "hands" / "leap_right.yaml").read_text(encoding="utf-8")
    (tmp_path / "hands" / "mine.yaml").write_text(text.replace("name: leap_right", "name: mine"))
    monkeypatch.setattr("geort_drake.hands.description.models_dir", lambda: tmp_path)
    assert hand_names() == ["mine"]
    assert load_hand("mine").name == "mine"


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_every_shipped_hand_builds(name):
    """Each description that comes along agrees with its model and starts free of collision."""
    hand = HandModel(load_hand(name))
    assert hand.description.name == name
    assert not hand.collides(hand.default_position)
    assert len(hand.kinematics().fingers) == len(hand.finger_names)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_every_thumb_can_pinch_with_every_finger(name):
    """Some posture brings each pair of tips to where their spheres meet, and nothing else into contact."""
    hand = HandModel(load_hand(name))
    kinematics = NumpyKinematics.of(hand.kinematics())
    thumb, *others = hand.description.fingers
    rng = np.random.default_rng(0)
    for number, finger in enumerate(others, start=1):
        moved = [hand.joint_names.index(joint) for joint in (*thumb.joints, *finger.joints)]
        q = np.tile(hand.default_position, (3000, 1))
        q[:, moved] = rng.uniform(hand.lower[moved], hand.upper[moved], (len(q), len(moved)))
        apart = _pair_distance(kinematics, q, number)
        pinches = [_pinch(kinematics, start, moved, number) for start in q[np.argsort(apart)[:8]]]
        closed = [p for p in pinches if _pair_distance(kinematics, p[None], number) < 2 * hand.tip_radius]
        assert any(not hand.collides_beyond_tips(p) for p in closed), finger.name


def _pair_distance(kinematics: NumpyKinematics, q: np.ndarray, number: int) -> np.ndarray:
    p_BF = kinematics.fingertips(q)
    return np.linalg.norm(p_BF[:, 0] - p_BF[:, number], axis=1)


def _pinch(kinematics: NumpyKinematics, q: np.ndarray, moved: list[int], number: int) -> np.ndarray:
    """q with the thumb's and a finger's tip brought to nine tenths of the distance at which they touch."""

    def cost(x):
        trial = q.copy()
        trial[moved] = x
        p_BF, J = kinematics.fingertips_and_jacobians(trial[None])
        v = p_BF[0, 0] - p_BF[0, number]
        distance = np.linalg.norm(v)
        excess = distance - 1.8 * kinematics.tip_radius
        slope = (v / distance) @ (J[0, 0] - J[0, number])[:, moved]
        return 1e4 * excess**2, 2e4 * excess * slope

    bounds = list(zip(kinematics.lower[moved], kinematics.upper[moved], strict=True))
    pinched = q.copy()
    pinched[moved] = minimize(cost, q[moved], jac=True, bounds=bounds, method="L-BFGS-B").x
    return pinched


def test_a_left_hand_is_described_as_its_right_one():
    """But for name, model, side and mount, the descriptions of the Allegro's two hands are the same."""
    right, left = (dc.asdict(load_hand(f"allegro_{side}")) for side in ("right", "left"))
    for facts, side in ((right, "right"), (left, "left")):
        assert facts.pop("side") == side
        assert facts.pop("name").endswith(f"_{side}") and facts.pop("model").endswith(f"_{side}.sdf")
        facts.pop("mount")
        for finger in facts["fingers"]:
            finger["tip_point"] = np.abs(finger["tip_point"]).tolist()
    assert left == right


def test_a_mirrored_left_hand_is_the_right_one(allegro, rng):
    """In the mirror, kinematics, wrist and collision shapes of a left hand are those of the right one."""
    left = HandModel(load_hand("allegro_left"))
    q = torch.tensor(_uniform(allegro, rng, 20))
    ours, theirs = left.kinematics().mirrored(), allegro.kinematics()
    torch.testing.assert_close(ours.fingertips(q), theirs.fingertips(q), rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.p_BW, theirs.p_BW, atol=1e-12)
    ours, theirs = collision_shapes(left).mirrored(), collision_shapes(allegro)
    for field in ("joint", "half", "radius", "pairs"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    np.testing.assert_allclose(ours.X_JS, theirs.X_JS, atol=1e-12)


def test_the_mount_is_the_wrist_and_not_part_of_the_hand(copied):
    """It says where the wrist is, may be left out, and does not make another hand of it."""
    facts, load = copied
    mounted = HandModel(load())
    np.testing.assert_allclose(mounted.p_BW, [0, 0, -0.095], atol=1e-12)
    del facts["mount"]
    bare = HandModel(load())
    np.testing.assert_array_equal(bare.p_BW, np.zeros(3))
    assert bare.digest == mounted.digest


def test_unknown_hand_lists_the_choices():
    """A name that stands for nothing is answered with the names that do."""
    with pytest.raises(UnknownNameError, match=r"unknown hand 'alegro'.*allegro_right"):
        load_hand("alegro")


def test_torch_kinematics_agree_with_drake(allegro, rng):
    """The chains read off the plant give Drake's fingertips to 1e-9 m."""
    q = _uniform(allegro, rng, 300)
    tips = allegro.kinematics().fingertips(torch.tensor(q))
    np.testing.assert_allclose(tips.numpy(), allegro.fingertips(q), atol=1e-9)


def test_kinematics_survive_an_offset_base_and_welded_links(copied, rng, tmp_path):
    """A base frame away from its link and a tip on a welded link change nothing in the agreement."""
    facts, load = copied
    sdf = tmp_path / "hand.sdf"
    extra = """
    <frame name="tilted_base" attached_to="base_link"><pose>0.01 -0.02 0.03 0.3 -0.2 0.5</pose></frame>
    <link name="nail">
      <pose relative_to="index_tip">0.001 0.002 0.003 0.1 0.2 0.3</pose>
      <inertial><mass>0.001</mass></inertial>
    </link>
    <joint name="nail_weld" type="fixed"><parent>link_3</parent><child>nail</child></joint>
  </model>"""
    sdf.write_text(sdf.read_text(encoding="utf-8").replace("  </model>", extra), encoding="utf-8")
    facts["base_frame"] = "tilted_base"
    facts["fingers"][1].update(tip_link="nail", tip_point=[0.004, -0.003, 0.002])
    hand = HandModel(load())
    q = _uniform(hand, rng, 50)
    tips = hand.kinematics().fingertips(torch.tensor(q))
    np.testing.assert_allclose(tips.numpy(), hand.fingertips(q), atol=1e-9)


def test_moving_a_joint_moves_only_its_finger(allegro):
    """Joint names, limits and fingertips refer to the same fingers."""
    q = allegro.default_position
    for finger_number, finger in enumerate(allegro.description.fingers):
        for joint in finger.joints:
            moved = q.copy()
            moved[allegro.joint_names.index(joint)] += 0.1
            shift = np.linalg.norm(allegro.fingertips(moved) - allegro.fingertips(q), axis=1)
            assert shift[finger_number] > 1e-4
            assert (np.delete(shift, finger_number) < 1e-12).all()


def test_one_configuration_and_a_batch_give_the_same(allegro, rng):
    """Single rows and batches agree in value; their shapes follow the input's."""
    q = _uniform(allegro, rng, 5)
    assert allegro.fingertips(q).shape == (5, 4, 3)
    np.testing.assert_array_equal(allegro.fingertips(q[2]), allegro.fingertips(q)[2])
    assert allegro.collides(q).shape == (5,)
    assert np.ndim(allegro.collides(q[2])) == 0
    for bad in (q[:, :15], q[None], np.full(16, np.nan)):
        with pytest.raises(ValueError, match="q "):
            allegro.fingertips(bad)


def test_contact_of_two_tips_is_told_from_other_contact(allegro, rng):
    """Labels, and penetrations read independently of them, say the same for every sample."""
    q = _uniform(allegro, rng, 400)
    collides, beyond = allegro.collides(q), allegro.collides_beyond_tips(q)
    kinds = set()
    for row, any_contact, beyond_tips in zip(q, collides, beyond, strict=True):
        contacts = allegro.penetrations(row)
        assert any_contact == bool(contacts)
        assert beyond_tips == any(not tip_tip for *_, tip_tip in contacts)
        assert [depth for depth, *_ in contacts] == sorted((c[0] for c in contacts), reverse=True)
        kinds.update(tip_tip for *_, tip_tip in contacts)
    assert kinds == {True, False}


def test_a_pinch_is_a_contact_of_tips_only(allegro):
    """Index and thumb tips brought together touch as spheres do: depth = 2 r - distance."""
    thumb, index = (allegro.finger_names.index(name) for name in ("thumb", "index"))
    free = [allegro.joint_names.index(f"joint_{i}") for i in (12, 13, 14, 15, 0, 1, 2, 3)]
    around_a_cylinder = np.array([1.16, 0.42, 0.51, 0.58, -0.15, 0.55, 0.89, 0.77])

    def q_of(x):
        q = allegro.default_position
        q[free] = x
        return q

    def cost(x):
        tips = allegro.fingertips(q_of(x))
        gap = 1e3 * (np.linalg.norm(tips[thumb] - tips[index]) - 0.020)
        return gap**2 + np.sum((x - around_a_cylinder) ** 2)

    bounds = list(zip(allegro.lower[free], allegro.upper[free], strict=True))
    q = q_of(minimize(cost, around_a_cylinder, bounds=bounds, method="L-BFGS-B").x)
    distance = np.linalg.norm(np.diff(allegro.fingertips(q)[[thumb, index]], axis=0))
    assert distance < 0.021
    assert allegro.collides(q)
    assert not allegro.collides_beyond_tips(q)
    depth, *links, tip_tip = allegro.penetrations(q)[0]
    assert (links, tip_tip) == (["link_15", "link_3"], True)
    # Sphere against sphere; the cylinders under the tips may reach deeper.
    assert depth >= 2 * allegro.tip_radius - distance - 1e-6


def test_samples_depend_on_nothing_but_hand_count_and_seed(allegro, tmp_path):
    """A seed gives the same samples again, another seed different ones, all within the limits."""
    first = robot_data(allegro, 500, seed=3, cache=tmp_path / "a")
    again = robot_data(allegro, 500, seed=3, cache=tmp_path / "b")
    other = robot_data(allegro, 500, seed=4, cache=tmp_path / "a")
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.p_BF, again.p_BF)
    assert not np.isin(first.q, other.q).any()
    assert ((allegro.lower <= first.q) & (first.q <= allegro.upper)).all()


def test_samples_carry_the_hands_own_answers(allegro, tmp_path):
    """Fingertips and labels are those of the model at each sample."""
    data = robot_data(allegro, 300, seed=0, cache=tmp_path)
    np.testing.assert_array_equal(data.p_BF, allegro.fingertips(data.q))
    np.testing.assert_array_equal(data.collides_beyond_tips, allegro.collides_beyond_tips(data.q))
    assert data.digest == allegro.digest


def test_samples_are_the_same_however_many_processes_label_them(allegro, tmp_path):
    """This one alone, and one beside it; progress is told in order."""
    done = []
    alone = robot_data(allegro, 3200, cache=tmp_path / "a", processes=1)
    shared = robot_data(
        allegro, 3200, cache=tmp_path / "b", processes=2, progress=lambda *step: done.append(step)
    )
    for name, value in vars(alone).items():
        np.testing.assert_array_equal(value, getattr(shared, name))
    assert 0.05 < alone.collides_beyond_tips.mean() < 0.95
    assert done[-1] == (3200, 3200) and done == sorted(done)


def test_positions_cost_nothing_where_labels_are_not_wanted(allegro, tmp_path, monkeypatch):
    """They are the same as with labels; nothing is computed or stored."""
    labelled = robot_data(allegro, 300, cache=tmp_path / "a")
    monkeypatch.setattr(HandModel, "collides_beyond_tips", lambda *_: pytest.fail("labelled"))
    data = robot_data(allegro, 300, cache=tmp_path / "b", labels=False)
    np.testing.assert_array_equal(data.q, labelled.q)
    assert data.p_BF is None and data.collides_beyond_tips is None
    assert not (tmp_path / "b").exists()


def test_cached_samples_are_returned_as_they_were(allegro, tmp_path, monkeypatch):
    """The second call computes nothing and returns identical arrays."""
    calls = []
    first = robot_data(allegro, 300, cache=tmp_path, progress=lambda *step: calls.append(step))
    assert calls[-1] == (300, 300)
    monkeypatch.setattr(HandModel, "fingertips", lambda *_: pytest.fail("sampled again"))
    second = robot_data(allegro, 300, cache=tmp_path)
    for name, value in vars(first).items():
        np.testing.assert_array_equal(value, getattr(second, name))


@pytest.mark.parametrize("damage", ["garbage", "truncated", "wrong shape", "not a number"])
def test_damaged_cache_is_made_anew(allegro, tmp_path, damage):
    """A cache file that is not whole is never used and is replaced."""
    good = robot_data(allegro, 200, cache=tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    match damage:
        case "garbage":
            path.write_bytes(b"not an archive")
        case "truncated":
            path.write_bytes(whole[: len(whole) // 2])
        case "wrong shape":
            np.savez(path, **(vars(good) | {"q": good.q[:, :3]}))
        case "not a number":
            np.savez(path, **(vars(good) | {"p_BF": good.p_BF * np.nan}))
    mended = robot_data(allegro, 200, cache=tmp_path)
    np.testing.assert_array_equal(mended.p_BF, good.p_BF)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    with np.load(path) as file:
        np.testing.assert_array_equal(file["q"], good.q)


def test_cache_belongs_to_one_model(copied, tmp_path):
    """A hand whose SDF text differs has another digest and another cache file."""
    _, load = copied
    original = HandModel(load())
    assert original.digest == HandModel(load()).digest
    sdf = tmp_path / "hand.sdf"
    text = sdf.read_text(encoding="utf-8")
    sdf.write_text(text.replace("<upper>1.61</upper>", "<upper>1.51</upper>", 1), encoding="utf-8")
    changed = HandModel(load())
    assert changed.digest != original.digest
    cache = tmp_path / "cache"
    robot_data(original, 50, cache=cache)
    data = robot_data(changed, 50, cache=cache)
    assert len(list(cache.iterdir())) == 2
    assert data.q[:, changed.joint_names.index("joint_1")].max() <= 1.51


def test_digest_ignores_where_the_files_lie(copied, allegro):
    """The same hand from another folder is the same hand."""
    _, load = copied
    assert HandModel(load()).digest == allegro.digest


def test_samples_come_even_where_they_cannot_be_stored(allegro, tmp_path):
    """A cache directory that cannot be made is reported, not fatal."""
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    assert len(robot_data(allegro, 10, cache=tmp_path / "file" / "cache").q) == 10


def _set(path: str, value):
    """A function that puts `value` at a dotted path of the description."""

    def apply(facts):
        *parents, last = path.split(".")
        for key in parents:
            facts = facts[int(key) if isinstance(facts, list) else key]
        facts[last] = value

    return apply


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("model", "nothing.sdf"), r"nothing\.sdf is missing"),
        (_set("model", ""), r"hand\.yaml.*model must be given"),
        (_set("side", "middle"), r"side must be one of right, left; given: 'middle'"),
        (_set("base_frame", "palm"), r"base_frame names the frame or link 'palm'.*base_link"),
        (_set("fingers.1.tip_link", "tip"), r"fingers\.index\.tip_link names.*'tip'.*link_3"),
        (_set("fingers.1.joints", ["joint_0", "knuckle"]), r"fingers\.index\.joints.*'knuckle'.*joint_1"),
        (_set("fingers.1.joints", ["joint_12", "joint_1"]), r"every joint once; given: twice: joint_12"),
        (_set("fingers.1.name", "pinky"), r"fingers\[1\]\.name must be one of thumb.*'pinky'"),
        (_set("fingers.1.human_keypoint", 21), r"human_keypoint must be from 1 to 20; given: 21"),
        (_set("fingers.1.tip_point", [0.0, 0.1]), r"tip_point must be three finite"),
        (_set("fingers.1.tip_radius", -0.01), r"tip_radius must be positive"),
        (_set("fingers", []), r"fingers must be a list of at least one finger"),
        (_set("default_positions.joint_12", 0.0), r"joint_12 must be within its limits.*0\.263.*given: 0"),
        (_set("default_positions.wrist", 0.0), r"default_positions names.*'wrist'.*joint_0"),
        (_set("mount.frame", "wrist"), r"mount\.frame names the frame or link 'wrist'.*mount"),
        (_set("mount.rpy_deg", [90]), r"mount\.rpy_deg must be three finite numbers"),
        (_set("colour", "red"), r"hand\.yaml is malformed.*colour"),
        (_set("fingers.0.tip_radius", "wide"), r"hand\.yaml is malformed"),
    ],
)
def test_bad_descriptions_name_what_is_wrong(copied, change, message):
    """Every error names the field, what was wanted and what was given, and lists the choices."""
    facts, load = copied
    change(facts)
    with pytest.raises(HandError, match=f"(?s){message}"):
        HandModel(load())


def test_fingers_out_of_order_are_refused(copied):
    """Fingers are listed thumb first, as everything downstream assumes."""
    facts, load = copied
    facts["fingers"].reverse()
    with pytest.raises(HandError, match=r"fingers must be each at most once, as thumb, index"):
        load()


def test_joints_that_form_no_finger_are_refused(copied):
    """A chain needs all of its moving joints, base to tip."""
    facts, load = copied
    joints = facts["fingers"][1]["joints"]
    facts["fingers"][1]["joints"] = joints[::-1]
    with pytest.raises(HandError, match=r"finger 'index': its joints must be listed base to tip"):
        HandModel(load()).kinematics()


def test_a_joint_that_no_finger_lists_is_held_at_its_default(copied, rng):
    """The finger then has fewer joints, and moves as the whole one does with that joint at this angle."""
    facts, load = copied
    whole = HandModel(load())
    facts["fingers"][1]["joints"].remove("joint_0")
    facts["default_positions"]["joint_0"] = 0.2
    hand = HandModel(load())
    q = _uniform(hand, rng, 20)
    np.testing.assert_allclose(hand.kinematics().fingertips(torch.tensor(q)), hand.fingertips(q), atol=1e-9)
    at = whole.joint_names.index("joint_0")
    np.testing.assert_allclose(whole.fingertips(np.insert(q, at, 0.2, axis=1)), hand.fingertips(q), atol=1e-9)


def test_missing_or_unreadable_files_are_named(tmp_path):
    """A missing description, and a model that is no SDF, are reported by path."""
    with pytest.raises(HandError, match=r"absent\.yaml is missing"):
        load_hand(tmp_path / "absent.yaml")
    (tmp_path / "broken.sdf").write_text("<sdf>", encoding="utf-8")
    hand = load_hand("allegro_right")
    hand.model = str(tmp_path / "broken.sdf")
    with pytest.raises(HandError, match=r"broken\.sdf: not one readable model"):
        HandModel(hand)

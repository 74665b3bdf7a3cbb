"""The retargeting explorer."""

import numpy as np
import pytest
from rerun_world import entities, read, rerun

from geort_drake import Recording
from geort_drake.errors import RecordingError
from geort_drake.metrics.explorer import (
    excerpt,
    proportional_copy,
    response,
    windowed_cosines,
    write_exploration,
)
from geort_drake.metrics.metrics import nearest_pairs, pair_distances
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import PINCH_M


def pinched(tips, names):
    """Returns where the nearest pair of the thumb's tip and another of tips (T, F, 3) meets."""
    return pair_distances(tips, nearest_pairs(tips, names)) < PINCH_M


def test_cosines_are_of_the_motion_around_an_instant():
    """A robot finger that moves 60° aside keeps a cosine of a half; one that rests counts 0."""
    t = np.arange(20)[:, None]
    human = np.zeros((20, 2, 3))
    human[:, 0] = 0.002 * t * [1, 0, 0]  # the other finger rests
    robot = np.zeros_like(human)
    robot[:, 0] = 0.005 * t * [0.5, np.sqrt(0.75), 0]
    np.testing.assert_allclose(windowed_cosines(human, robot, 3), 0.5)
    np.testing.assert_allclose(windowed_cosines(human, np.zeros_like(human), 3), 0.0)
    assert np.isnan(windowed_cosines(np.zeros_like(human), robot, 3)).all()


def test_an_excerpt_begins_where_most_pinches_are():
    """Frames without tracking repeat the last hand before them; times are the excerpt's own."""
    p_HK = np.zeros((400, 21, 3))
    p_HK[:, 4::4, 0] = np.arange(5) * 0.1
    p_HK[250:300, 8] = p_HK[0, 4]
    valid = np.ones(400, bool)
    valid[260:270] = False
    p_HK[~valid] = 9.0
    recording = Recording(np.arange(400) * 0.1 + 5.0, p_HK, valid)
    hands = excerpt(recording, rate_hz=10.0, duration_s=5.0)
    assert hands.metadata["start_s"] == pytest.approx(25.0)
    np.testing.assert_allclose(hands.t, np.arange(51) * 0.1, atol=1e-9)
    assert pinched(hands.p_HK[:50, 4::4], ("thumb", "index", "middle", "ring", "little")).all()
    later = excerpt(recording, rate_hz=10.0, duration_s=5.0, start_s=38.0)
    assert later.t[-1] == pytest.approx(1.9)  # to the recording's end
    with pytest.raises(RecordingError, match=r"within the recording's 39.9 s"):
        excerpt(recording, start_s=40.0)


def test_a_left_hand_is_retargeted_as_its_mirror_image_and_drawn_as_it_is(play, allegro_left):
    """The methods get canonical right hands; robot and asked fingertips are where the left hand's are."""
    left = allegro_left
    hands = excerpt(play, duration_s=2.0)
    given = []

    def half_way(p_HF):
        given.append(p_HF)
        return left.lower + (left.upper - left.lower) * (0.5 + 4 * p_HF.reshape(len(p_HF), -1)[:, :1])

    found = response(half_way, left, hands)
    np.testing.assert_array_equal(given[0], hands.fingertips(left.description.human_keypoints))
    np.testing.assert_allclose(found.p_BF, left.fingertips(found.q))
    np.testing.assert_allclose(found.copy, proportional_copy(mirrored(given[0]), found.p_BF))
    last_links = left.fingertips(found.q) - joint_origins(left, found.q)
    last_bones = mirrored(hands.p_HK[:, left.description.human_keypoints]) - mirrored(
        hands.p_HK[:, np.array(left.description.human_keypoints) - 1]
    )
    cosines = (last_links * last_bones).sum(axis=-1)
    lengths = np.linalg.norm(last_links, axis=-1) * np.linalg.norm(last_bones, axis=-1)
    np.testing.assert_allclose(np.cos(found.angle), cosines / lengths, atol=1e-6)


def joint_origins(hand, q):
    """Where Drake has each finger's last joint, (T, F, 3), m, in B."""
    plant, context = hand.plant, hand.plant.CreateDefaultContext()
    joints = [plant.GetJointByName(finger.joints[-1]) for finger in hand.description.fingers]
    base = plant.GetFrameByName(hand.description.base_frame)
    rows = []
    for row in q:
        for name, angle in zip(hand.joint_names, row, strict=True):
            plant.GetJointByName(name).set_angle(context, angle)
        rows.append([j.frame_on_child().CalcPose(context, base).translation() for j in joints])
    return np.array(rows)


def test_the_recording_contains_the_outputs_of_the_methods(tmp_path, allegro, play):
    """Poses, tips, pinches and collisions of every method, at every instant."""
    hands = excerpt(play, rate_hz=10.0, duration_s=3.0)
    fist, rest = allegro.upper, np.clip(np.zeros(len(allegro.lower)), allegro.lower, allegro.upper)
    methods = {
        "fist": response(lambda p_HF: np.tile(fist, (len(p_HF), 1)), allegro, hands),
        "rest": response(lambda p_HF: np.tile(rest, (len(p_HF), 1)), allegro, hands),
    }
    path = tmp_path / "explorer.rrd"
    write_exploration(path, allegro, hands, methods, {"recording_sha256": play.digest})
    assert rerun("rrd", "verify", path).returncode == 0
    pinches = pinched(hands.fingertips(allegro.description.human_keypoints), allegro.finger_names)
    assert pinches.any()
    for name, q in (("fist", fist), ("rest", rest)):
        times, tips = read(path, f"/world/{name}/tips", "Ellipsoids3D:centers")
        np.testing.assert_allclose(times, hands.t, atol=1e-9)
        np.testing.assert_allclose(tips[3], allegro.fingertips(q), atol=1e-6)
        deep = any(depth > 0.002 and not tip_tip for depth, _, _, tip_tip in allegro.penetrations(q))
        _, balls = read(path, f"/world/{name}/collisions", "Ellipsoids3D:centers")
        assert [len(row) > 0 for row in balls] == [deep] * len(hands.t)
        _, cages = read(path, f"/world/{name}/pinch", "Ellipsoids3D:centers")
        assert [len(row) for row in cages] == pinches.astype(int).tolist()
        _, states = read(path, f"/{name}", "StateChange:state")
        assert ("collides" in {state[0] for state in states}) == deep
        _, angles = read(path, f"/posture/{name}", "Scalars:scalars")
        np.testing.assert_allclose(np.ravel(angles), np.degrees(methods[name].angle.mean(axis=1)), atol=1e-4)
    assert any(entity.startswith("/world/fist/allegro_right") for entity in entities(path))
    _, text = read(path, "/about", "TextDocument:text")
    assert "| pinches closed | " in text[0][0]

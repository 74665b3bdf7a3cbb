"""Every metric against maps for which its value is known in closed form."""

import dataclasses
import functools
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geort_drake import load_retargeter, synthesize_play
from geort_drake.errors import GeortError, HandError, MethodError, RecordingError
from geort_drake.metrics import evaluation, metrics
from geort_drake.metrics.compare import TABLES, flat
from geort_drake.own_method import OwnMethod
from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting.clouds import voxel_thinned

NAMES = ("thumb", "index", "middle")


class PointHand:
    """A hand whose joints are its fingertips' coordinates: FK is the identity, reach is a 12 cm cube."""

    def kinematics(self):
        return self

    description = SimpleNamespace(side="right")
    finger_names = NAMES
    joint_names = tuple(f"{name}_{axis}" for name in NAMES for axis in "xyz")
    lower, upper = np.full(9, -0.06), np.full(9, 0.06)
    tip_radius = 0.012
    default_position = np.zeros(9)

    def sample(self, count, seed):
        return np.random.default_rng(seed).uniform(-0.06, 0.06, (count, 9))

    def fingertips(self, q):
        return q.reshape(*q.shape[:-1], 3, 3)

    def collides(self, q):
        """Where the thumb is at negative x."""
        return np.asarray(q)[:, 0] < 0

    def penetrations(self, q):
        """As deep as the thumb is negative; a second, deeper contact of the tips does not count."""
        return [(0.03, "thumb", "index", True), (-float(q[0]), "thumb", "palm", False)]


@pytest.fixture
def frames(rng):
    """1200 random instants of three fingertips in a cube of 8 cm."""
    return rng.uniform(-0.04, 0.04, (1200, 3, 3))


def test_motion_preservation_is_a_third_of_a_rotations_trace(frames, rng):
    """E⟨d, R d⟩ over the sphere is tr(R)/3 = (1 + 2 cos θ)/3. The gain plays no role; a constant map is 0."""
    assert metrics.motion_preservation(lambda p: 3 * p + 0.1, frames, rng) == pytest.approx(1.0)
    assert metrics.motion_preservation(np.zeros_like, frames, rng) == 0.0
    assert metrics.motion_preservation(lambda p: -p, frames, rng) == pytest.approx(-1.0)

    R = Rotation.from_rotvec([0.3, -0.5, 0.4])
    expected = (1 + 2 * math.cos(R.magnitude())) / 3
    value = metrics.motion_preservation(lambda p: p @ R.as_matrix().T, frames, rng, anchors=20_000)
    assert value == pytest.approx(expected, abs=0.01)


def test_track_scores_real_steps_above_a_millimetre():
    """A step of 2 mm answered at 60° scores 0.5; one of 0.5 mm is left out."""
    human = np.array([[0.0, 0, 0], [0.002, 0, 0], [0.0025, 0, 0]])[:, None]
    robot = np.array([[0.0, 0, 0], [0.5, math.sqrt(0.75), 0], [-9.0, 0, 0]])[:, None]
    assert metrics.motion_preservation_track(human, robot) == pytest.approx(0.5)
    assert metrics.motion_preservation_track(0.1 * human, robot) is None


def test_cross_talk_is_the_share_that_others_move(frames, rng):
    """Zero for independent fingers; c when every finger is moved by c times the others."""
    assert metrics.cross_talk(lambda p: 2 * p, frames, rng) == 0.0
    coupled = metrics.cross_talk(lambda p: p + 0.3 * (p.sum(axis=1, keepdims=True) - p), frames, rng)
    assert coupled == pytest.approx(0.3, rel=1e-6)


def test_coverage_of_one_point_is_the_volume_of_its_sphere(rng):
    """A fingertip in the middle of a filled 4.2 cm cube covers (4/3)πr³ of it."""
    filled = rng.uniform(-0.021, 0.021, (100_000, 1, 3))
    share = metrics.coverage(metrics.robot_voxels(filled), [np.zeros((1, 3))])
    # Voxel centres lie at ±1.5, ±4.5, ... mm: 8 at (1.5, 1.5, 1.5) and 24 at (4.5, 1.5, 1.5) are within 5.
    assert share["5mm"] == pytest.approx(32 / 14**3)
    for r in (10, 15):
        assert share[f"{r}mm"] == pytest.approx(4 / 3 * math.pi * r**3 / 42**3, rel=0.06)


def test_context_averaging_keeps_independent_maps_and_shrinks_coupled_ones(frames):
    """What a fingertip reaches only because of the other fingers averages out."""

    def coupled(p):
        return p + 3 * np.roll(p, 1, axis=1)

    for finger, tips in enumerate(metrics.average_over_context(lambda p: 2 * p, frames)):
        np.testing.assert_allclose(tips, 2 * voxel_thinned(frames[:, finger], 0.001), atol=1e-12)
    averaged = np.concatenate(metrics.average_over_context(coupled, frames))
    # Variance of own + 9 × the others', against own + 9/12.
    ratio = averaged.var() / coupled(frames).var()
    assert ratio == pytest.approx((1 + 9 / 12) / 10, rel=0.15)


def test_an_affine_map_is_flat_and_its_gain_ratio_follows_from_its_scales(frames, rng):
    """An isotropic map has gain ratio 1; one that stretches z tenfold does not, but is as flat."""
    flat, gains = metrics.flatness_and_gain(lambda p: 3 * p + 0.2, frames, rng)
    assert flat == pytest.approx(0.0, abs=1e-18)
    np.testing.assert_allclose(gains, 3.0)
    assert metrics.gain_ratio(gains) == pytest.approx(1.0)
    flat, gains = metrics.flatness_and_gain(lambda p: p * [1, 1, 10], frames, rng)
    assert flat == pytest.approx(0.0, abs=1e-18)
    # |Δ|² = 1 + 99 z² with z uniform in [−1, 1] on the sphere.
    expected = math.sqrt((1 + 99 * 0.95**2) / (1 + 99 * 0.05**2))
    assert metrics.gain_ratio(gains) == pytest.approx(expected, rel=0.03)
    # A finger that leaves many steps unanswered has none; a few steps are not enough.
    gains = rng.uniform(0.5, 1.0, (3, 100))
    gains[1, :3] = 0.0
    assert metrics.gain_ratio(gains) < 2.0
    gains[1, :8] = 1e-12
    assert metrics.gain_ratio(gains) is None


def test_pinch_figures_equal_those_computed_by_hand():
    """Four instants: closed, closed too deep, open, and a false pinch of pairs that are far apart."""

    def hand(index, middle):
        return [[0.0, 0, 0], [index, 0, 0], [0, middle, 0]]

    human = np.array([hand(0.010, 0.050), hand(0.014, 0.012), hand(0.005, 0.040), hand(0.060, 0.070)])
    robot = np.array([hand(0.020, 0.015), hand(0.030, 0.002), hand(0.025, 0.080), hand(0.023, 0.090)])
    result = metrics.pinch(human, robot, NAMES, tip_radius=0.012)
    assert result["frames"] == 3
    assert result["closed"] == pytest.approx(2 / 3)
    assert result["too_deep"] == pytest.approx(1 / 3)
    assert result["mean_mm"] == pytest.approx((20 + 2 + 25) / 3)
    assert result["p95_mm"] == pytest.approx(np.percentile([20, 2, 25], 95))
    # Over 30 mm apart: the middle in frames 0, 2 and 3, the index in 3; the first and the last of them meet.
    assert result["false"] == pytest.approx(2 / 4)
    assert result["all_pairs"]["frames"] == 4
    assert result["all_pairs"]["closed"] == pytest.approx(2 / 4)


def test_self_collision_counts_penetrations_over_two_millimetres():
    """Five joint vectors: two free, one touching, two deep; tips among themselves do not count."""
    q = np.zeros((5, 9))
    q[:, 0] = [0.01, 0.0, -0.001, -0.0021, -0.01]
    result = metrics.self_collision(PointHand(), q)
    assert result == {"deep": pytest.approx(2 / 5), "any": pytest.approx(3 / 5)}


def test_smoothness_of_a_parabola_has_no_jerk():
    """q = t² e: steps grow linearly, the third difference vanishes; a cubic's is 6."""
    t = np.arange(11.0)
    q = np.outer(t**2, [0.6, 0.8])
    result = metrics.smoothness(q, rate_hz=10.0)
    assert result["mean"] == pytest.approx(10.0)
    assert result["max"] == pytest.approx(19.0)
    assert result["jerk"] == pytest.approx(0.0, abs=1e-6)
    assert metrics.smoothness(np.outer(t**3, [0.6, 0.8]), 10.0)["jerk"] == pytest.approx(6000.0)


def test_posture_is_the_angle_between_distal_links(rng):
    """Lengths play no role; the median and the 90th percentile are over frames and fingers."""
    human = rng.normal(size=(50, 3, 3))
    axis = np.cross(human, rng.normal(size=human.shape))
    angles = np.linspace(0.0, 90.0, 150).reshape(50, 3)
    turns = np.radians(angles)[..., None] * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    robot = 7 * Rotation.from_rotvec(turns.reshape(-1, 3)).apply(human.reshape(-1, 3)).reshape(human.shape)
    assert metrics.posture(human, robot) == pytest.approx({"median": 45.0, "p90": 81.0})


def test_distal_links_turn_with_the_last_joint(allegro):
    """Their length is constant, and base joints turn them as well; a tip is its origin plus its link."""
    q = allegro.sample(20, seed=0)
    links = evaluation.distal_links(allegro)(q)
    lengths = np.linalg.norm(links, axis=-1)
    np.testing.assert_allclose(lengths, lengths[:1].repeat(20, axis=0), atol=1e-9)
    for finger, chain in zip(range(4), allegro.kinematics().fingers, strict=True):
        moved = q.copy()
        moved[:, chain.joint_indices[-1]] += 0.3
        turned = evaluation.distal_links(allegro)(moved)[:, finger]
        cosine = (turned * links[:, finger]).sum(axis=-1) / lengths[:, finger] ** 2
        tips = evaluation.fingertips_of(allegro)
        np.testing.assert_allclose(
            tips(moved)[:, finger] - tips(q)[:, finger], turned - links[:, finger], atol=1e-9
        )
        assert (cosine < 1.0).all()


def joints(p_HF):
    """Fingertips (N, 3, 3) as the joint angles of `PointHand`."""
    return p_HF.reshape(len(p_HF), 9)


def points(q):
    return q.reshape(-1, 3, 3)


def test_jitter_is_the_gain_of_noise(frames, rng):
    """Twice for a map of gain 2; a map that averages two frames passes on 1/√2 of white noise."""
    assert evaluation.jitter(lambda p: 2 * joints(p), points, frames, 2 * frames, rng) == pytest.approx(2.0)

    def smooth(p):
        return 0.5 * joints(p + np.concatenate([p[:1], p[:-1]]))

    value = evaluation.jitter(smooth, points, frames, points(smooth(frames)), rng)
    assert value == pytest.approx(math.sqrt(0.5), rel=0.05)


class Creeping:
    """A map with a memory: each call goes half of the rest of the way from zero to the fingertips."""

    def reset(self):
        self.p = 0.0

    def __call__(self, p_HF):
        self.p = 0.5 * (self.p + p_HF)
        return self.p


def test_engagement_tells_the_first_jump_from_what_follows(frames):
    """A fixed map jumps to its output and stays; one with a memory goes half way, and then settles."""
    start = np.zeros((3, 3))
    rows = np.linspace(0, len(frames) - 1, evaluation.ENGAGEMENTS).astype(int)
    distance = 1000 * np.linalg.norm(frames[rows], axis=-1).mean()
    fixed = evaluation.engagement(lambda p: p, lambda q: q, frames, start, 30.0)
    assert fixed == pytest.approx({"jump_mm": distance, "settling_mm": 0.0})
    creeping = evaluation.engagement(Creeping(), lambda q: q, frames, start, 30.0)
    assert creeping == pytest.approx({"jump_mm": distance / 2, "settling_mm": distance / 2})


def test_size_compares_gains_to_those_of_the_affine_fit(frames, rng):
    """A robot whose fingertips spread three times as far has an affine fit of gain 3."""
    gains = np.tile([[1.5], [3.0], [6.0]], (1, 100))
    size = metrics.size(gains, frames, 3 * frames + 0.1, NAMES)
    assert size["over_affine"] == pytest.approx((0.5 + 1.0 + 2.0) / 3)
    assert size["least_over_affine"] == pytest.approx(0.5) and size["median"] == pytest.approx(3.5)
    assert size["fingers"] == pytest.approx(dict(zip(NAMES, (1.5, 3.0, 6.0), strict=True)))


FOLLOWER = """
import numpy as np
def make(hand):
    calls = []
    def retarget(p_HK):
        calls.append(p_HK)
        if len(calls) > {good}:
            return None
        return hand.lower + np.ones(len(hand.lower)) * np.clip(p_HK[8, 2], 0, 0.1)
    return retarget
"""


def test_a_method_of_whole_hands_gets_recorded_hands_with_moved_fingers(allegro, play, tmp_path):
    """Recorded fingertips give recorded hands; a moved tip takes its finger along, and the knuckle stays."""
    (tmp_path / "mine.py").write_text(FOLLOWER.format(good=10**9))
    given = []
    method = OwnMethod(tmp_path / "mine.py", allegro)
    method._retarget = lambda p_HK: given.append(p_HK) or allegro.default_position
    retarget = evaluation.complete_hands(method, allegro, play)
    tips = play.fingertips(allegro.description.human_keypoints)
    shape = retarget(tips[:3]).shape
    assert shape == (3, 16) and retarget(tips[0]).shape == (16,)
    np.testing.assert_allclose(given[:3], play.p_HK[play.valid][:3], atol=1e-6)
    del given[:]
    moved = tips[:1].copy()
    moved[0, 1] += [0.003, 0.0, 0.0]
    retarget(moved)
    hand, recorded = given[0], play.p_HK[play.valid]
    np.testing.assert_allclose(hand[allegro.description.human_keypoints], moved[0], atol=1e-6)
    rest = [0, *(chain[0] for chain in FINGER_KEYPOINTS.values()), *FINGER_KEYPOINTS["little"]]
    assert np.abs(recorded[:, rest] - hand[rest]).max(axis=(1, 2)).min() < 1e-6


@pytest.mark.usefixtures("light_evaluation")
def test_a_method_of_ones_own_is_evaluated_unless_its_outputs_are_unusable(allegro, play, tmp_path):
    (tmp_path / "mine.py").write_text(FOLLOWER.format(good=10**9))
    short = dataclasses.replace(play, t=play.t[:40], p_HK=play.p_HK[:40], valid=play.valid[:40])
    figures = evaluation.evaluate(OwnMethod(tmp_path / "mine.py", allegro), allegro, short)
    assert figures["self_collision"] is not None and figures["posture"]["median"] > 0
    (tmp_path / "mine.py").write_text(FOLLOWER.format(good=15))
    with pytest.raises(MethodError, match=r"outputs are unusable: \{'of shape \(\)'"):
        evaluation.evaluate(OwnMethod(tmp_path / "mine.py", allegro), allegro, short)


def test_all_metrics_of_the_identity_on_a_hand_without_links(frames, monkeypatch):
    """The dictionary has every key, is JSON, repeats with its seed, and is perfect where it should be."""
    monkeypatch.setattr(evaluation, "NumpyKinematics", lambda hand: hand)

    def identity(p):
        return np.reshape(p, (*p.shape[:-2], 9))

    space = evaluation.robot_space(PointHand(), seed=5, samples=200_000)
    result = evaluation.evaluate_frames(identity, PointHand(), frames, 60.0, seed=5, space=space)
    assert json.loads(json.dumps(result, allow_nan=False)).keys() == result.keys()
    # The tables show nothing that is not measured.
    assert {metric for columns in TABLES.values() for metric, _, _ in columns} <= {
        *dict(flat(result)),
        *("posture.median", "posture.p90"),
    }
    assert result["motion_preservation"] == pytest.approx(1.0)
    assert result["motion_preservation_track"] == pytest.approx(1.0)
    for radius, share in result["coverage"].items():
        assert result["coverage_context_averaged"][radius] == pytest.approx(share, abs=0.005)
    assert result["jitter"] == pytest.approx(1.0) and result["engagement"]["settling_mm"] == 0.0
    assert result["size"]["median"] == pytest.approx(1.0)
    # The human's cube is 8 cm of the robot's 12 cm.
    assert result["coverage"]["15mm"] > 0.5
    assert set(result["coverage"]) == {"5mm", "10mm", "15mm"}
    assert result["self_collision_raw"] == pytest.approx((frames[:, 0, 0] < 0).mean())
    again = evaluation.evaluate_frames(identity, PointHand(), frames, 60.0, seed=5, space=space)
    result.pop("latency_us"), again.pop("latency_us")
    assert result == again
    without = evaluation.evaluate_frames(identity, PointHand(), frames, 60.0, seed=5)
    missing = {"coverage", "coverage_context_averaged", "posture"}
    assert {key for key in without if without[key] is None} == missing


def test_recordings_that_are_no_hand_of_the_robots_side_are_not_evaluated(allegro):
    """As reading a file refuses them: another unit, another frame, the other side."""
    retarget, play = load_retargeter("allegro_right"), synthesize_play(0, duration_s=1.0)
    for p_HK, message in (
        (1e3 * play.p_HK, "right if lengths were in mm"),
        (play.p_HK + np.float32(0.1), "must be given in the wrist frame H"),
        (play.p_HK * [-1, 1, 1], "of the other side"),
    ):
        for use in (HumanHand.fit, functools.partial(evaluation.evaluate, retarget, allegro)):
            with pytest.raises(GeortError, match=message):
                use(dataclasses.replace(play, p_HK=p_HK))
    with pytest.raises(RecordingError, match="is of a left hand, the robot's is a right hand"):
        evaluation.evaluate(retarget, allegro, synthesize_play(0, duration_s=1.0, side="left"))


def test_only_a_retargeter_of_the_hand_that_takes_batches_is_evaluated(allegro):
    with pytest.raises(HandError, match="another hand than 'allegro_right': joint_names differ"):
        evaluation.evaluate(load_retargeter("leap_right"), allegro, synthesize_play(0, duration_s=1.0))
    lost = np.where(np.arange(20) < 2, np.nan, np.zeros((16, 20))).T
    for answer, fault in ((lost[0], r"it returned \(16,\) for \(20, 4, 3\)"), (lost, "2 of 20 rows are not")):
        with pytest.raises(ValueError, match=fault):
            evaluation.evaluate_frames(lambda _, q=answer: q, allegro, np.zeros((20, 4, 3)), 60.0)

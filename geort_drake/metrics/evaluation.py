"""Evaluates a retargeter on a recording: calls it, and computes all `metrics` of its outputs.

The robot's kinematics is exact. Left hands are mirrored, because human hands are always stored as right ones.
"""

import functools
import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from geort_drake.errors import HandError, MethodError, RecordingError
from geort_drake.hands.hand import Hand
from geort_drake.metrics.metrics import (
    FingertipMap,
    average_over_context,
    coverage,
    cross_talk,
    flatness_and_gain,
    gain_ratio,
    motion_preservation,
    motion_preservation_track,
    pinch,
    posture,
    robot_voxels,
    self_collision,
    size,
    smoothness,
)
from geort_drake.own_method import OwnMethod
from geort_drake.people.checks import require_hand
from geort_drake.people.recording import Recording
from geort_drake.retargeting.base import forget, kinematics_of
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.retargeting.online import AnyTeleop
from geort_drake.retargeting.universal import UniversalRetargeter

ROBOT_SAMPLES = 200_000  # uniform joint angles, whose fingertips sample the C-space
MIN_FRAMES = 10
# s, beginning of a recording on which a universal map measures the person.
OBSERVED_S = 1.0
NOISE = 0.001  # m, standard deviation of a fingertip's coordinates in `jitter`
SIZE_SAMPLES = 4000  # uniform joint angles, to which `size` compares
ENGAGEMENTS = 20  # hands at which `engagement` is measured
_CHUNK = 4096  # rows that are computed at once; all of a long recording's would fill the memory


@functools.lru_cache(maxsize=8)
def robot_space(hand: Hand, seed: int, samples: int) -> list[np.ndarray]:
    """Samples the robot's C-space, the reach of its fingertips, which does not depend on the method.

    Returns:
        For each finger the centres (M, 3) in B, m, of the 3 mm voxels that its tip hits at uniform joint
        angles; mirrored for a left hand, as human hands are right.
    """
    return robot_voxels(fingertips_of(hand)(hand.sample(samples, seed)))


def evaluate(
    retarget: Callable,
    hand: Hand,
    recording: Recording,
    seed: int = 0,
    frame_limit: int | None = None,
    with_coverage: bool = True,
) -> dict:
    """Computes all metrics of a retargeter on one recording, as a dictionary of JSON types.

    Args:
        retarget: maps (F, 3) and (N, F, 3) human fingertips in H, m, to joint angles (n,) and (N, n), rad, in
            the order of `hand.joint_names`. A universal map adapts to the first second of the recording. Of
            an online method, metrics of hands that were not recorded use `AnyTeleop.settled_map`.
        hand: model of the robot hand, with the retargeter's fingers.
        recording: recording of the person's hand.
        seed: seed of the anchors, directions and robot samples.
        frame_limit: number of valid frames, from the first on, that are used; None for all.
        with_coverage: whether the coverages are computed.

    Returns:
        Metric → figure, as the page on the comparison file defines them; None where nothing can be measured.

    Raises:
        HandError: the retargeter is for another hand.
        RecordingError, MismatchError: the recording has too few frames, or see `require_hand`.
        ValueError: the retargeter returns another shape.
    """
    _require_same_hand(retarget, hand)
    require_hand(recording, hand.description.side)
    keypoints = hand.description.human_keypoints
    frames = recording.fingertips(keypoints)[:frame_limit]
    distal = distal_phalanges(recording, keypoints)[:frame_limit]
    retarget = adapt(retarget, recording)
    stationary_map = None
    if isinstance(retarget, AnyTeleop):
        stationary_map = retarget.settled_map(frames)
        retarget.reset()
    space = robot_space(hand, seed, ROBOT_SAMPLES) if with_coverage else None
    complete = complete_hands(retarget, hand, recording)
    return evaluate_frames(complete, hand, frames, recording.rate_hz, seed, space, stationary_map, distal)


def adapt(retarget: Callable, recording: Recording) -> Callable:
    """Returns a universal map adapted to the first second of a recording; other maps as they are."""
    if not isinstance(retarget, UniversalRetargeter):
        return retarget
    return retarget.for_person(recording.tracked().p_HK[: max(1, round(recording.rate_hz * OBSERVED_S))])


def _require_same_hand(retarget: Callable, hand: Hand) -> None:
    """Raises HandError if a map has other joints or joint limits than the hand."""
    for name, expected in (("joint_names", hand.joint_names), ("lower", hand.lower), ("upper", hand.upper)):
        actual = getattr(retarget, name, expected)
        if len(actual) != len(expected) or not (np.asarray(actual) == expected).all():
            raise HandError(
                f"the retargeter is for another hand than '{hand.description.name}': {name} differ: "
                f"{list(actual)}, expected {list(expected)}"
            )


def evaluate_frames(
    retarget: Callable,
    hand: Hand,
    frames: np.ndarray,
    rate_hz: float,
    seed: int = 0,
    space: Sequence[np.ndarray] | None = None,
    stationary_map: Callable | None = None,
    distal: np.ndarray | None = None,
) -> dict:
    """Computes the metrics of `evaluate` from successive fingertips `frames` (T, F, 3), m, at `rate_hz`.

    A retargeter with memory gets `frames` in order, as a batch. Metrics of hands that were not recorded
    (random motion, cross-talk, flatness, gain and the context average) use `stationary_map`, a map without
    memory, if given. Without `space` the coverages are None, and without the directions `distal` (T, F, 3)
    of the person's distal phalanges in H the posture is.

    Raises:
        RecordingError: there are too few frames.
    """
    if len(frames) < MIN_FRAMES:
        raise RecordingError(
            f"metrics need at least {MIN_FRAMES} valid frames, the recording has {len(frames)}"
        )
    rng = np.random.default_rng([seed, 1])  # other random numbers than those of robot_space

    fingertips = fingertips_of(hand)

    def g(p_HF: np.ndarray) -> np.ndarray:
        return fingertips(_angles(stationary_map or retarget, p_HF))

    q = _angles(retarget, frames)
    p_BF = fingertips(q)
    flat, gains = flatness_and_gain(g, frames, rng)
    collisions = self_collision(hand, q)
    tips = fingertips(hand.default_position[None])[0]
    figures = {
        "motion_preservation": motion_preservation(g, frames, rng),
        "motion_preservation_track": motion_preservation_track(frames, p_BF),
        "coverage": None,
        "coverage_context_averaged": None,
        "cross_talk": cross_talk(g, frames, rng),
        "flatness": flat,
        "gain_p95_p5": gain_ratio(gains),
        "size": size(gains, frames, fingertips(hand.sample(SIZE_SAMPLES, seed)), hand.finger_names),
        "pinch": pinch(frames, p_BF, hand.finger_names, hand.tip_radius),
        "self_collision": collisions["deep"],
        "self_collision_raw": collisions["any"],
        "posture": None if distal is None else posture(distal, distal_links(hand)(q)),
        "smoothness": smoothness(q, rate_hz),
        "jitter": jitter(retarget, fingertips, frames, p_BF, np.random.default_rng([seed, 2])),
        "engagement": engagement(retarget, fingertips, frames, tips, rate_hz),
    }
    if space is not None:
        figures["coverage"] = coverage(space, list(np.moveaxis(p_BF, 1, 0)))
        figures["coverage_context_averaged"] = coverage(space, average_over_context(g, frames))
    median, p99 = np.percentile(call_times(retarget, frames), (50, 99))
    figures["latency_us"] = {"median": 1e6 * float(median), "p99": 1e6 * float(p99)}
    return figures


def fingertips_of(hand: Hand) -> Callable[[np.ndarray], np.ndarray]:
    """Returns a function of joint angles (N, n), rad: fingertips (N, F, 3), m, mirrored for a left hand."""
    return functools.partial(_in_chunks, NumpyKinematics(kinematics_of(hand)).fingertips)


def distal_links(hand: Hand) -> Callable[[np.ndarray], np.ndarray]:
    """Returns a function of joint angles (N, n), rad: vectors (N, F, 3) in B, m, mirrored for a left hand.

    They lead from the origin of each finger's last joint to the fingertip.
    """
    kinematics = kinematics_of(hand)
    tip, origin = NumpyKinematics(kinematics), NumpyKinematics(kinematics.to_last_joints())
    return lambda q: _in_chunks(tip.fingertips, q) - _in_chunks(origin.fingertips, q)


def distal_phalanges(recording: Recording, keypoints: Sequence[int]) -> np.ndarray:
    """Returns vectors (T, F, 3) in H, m, from the last joint to each of the tips `keypoints`, if tracked."""
    p_HK, tips = recording.p_HK[recording.valid].astype(float), np.asarray(keypoints)
    return p_HK[:, tips] - p_HK[:, tips - 1]


def complete_hands(retarget: Callable, hand: Hand, recording: Recording) -> Callable:
    """Returns a method of whole hands as a function of fingertips; other retargeters as they are.

    The method gets the recorded hand with the nearest fingertips, whose fingers are moved to the given ones:
    the tip by the whole difference, and the joints by less, in equal steps down to the knuckle, which stays.
    """
    if not isinstance(retarget, OwnMethod):
        return retarget
    p_HK = recording.p_HK[recording.valid].astype(float)
    tips = np.asarray(hand.description.human_keypoints)
    tree = cKDTree(p_HK[:, tips].reshape(len(p_HK), -1))
    method: OwnMethod = retarget

    def of_fingertips(p_HF: np.ndarray) -> np.ndarray:
        points = np.reshape(p_HF, (-1, len(tips), 3))
        hands = p_HK[tree.query(points.reshape(len(points), -1))[1]]
        shift = points - hands[:, tips]
        for joint in range(3):
            hands[:, tips - joint] += (3 - joint) / 3 * shift
        q = method(hands)
        if not np.isfinite(q).all():
            raise MethodError(f"the method's outputs are unusable: {dict(method.faults)}")
        return q if np.ndim(p_HF) == 3 else q[0]

    of_fingertips.reset = method.reset  # type: ignore[attr-defined]
    return of_fingertips


def jitter(
    retarget: Callable,
    fingertips: FingertipMap,
    frames: np.ndarray,
    p_BF: np.ndarray,
    rng: np.random.Generator,
) -> float:
    """Returns the noise of robot fingertips over that of the person's, mean over fingers.

    White noise of 1 mm is added to each coordinate of the successive frames (T, F, 3), whose outputs without
    noise are p_BF (T, F, 3). Both noises are root mean squares.
    """
    noise = rng.normal(scale=NOISE, size=frames.shape)
    forget(retarget)
    moved_by = fingertips(_angles(retarget, frames + noise)) - p_BF
    output, source = (np.sqrt((x**2).sum(axis=-1).mean(axis=0)) for x in (moved_by, noise))
    return float((output / source).mean())


def engagement(
    retarget: Callable, fingertips: FingertipMap, frames: np.ndarray, start: np.ndarray, rate_hz: float
) -> dict[str, float]:
    """Measures what the robot's fingertips do when a person engages, over hands spread over the recording.

    Returns:
        `jump_mm`: mean distance from their places `start` (F, 3) in the default posture to the first output;
        `settling_mm`: mean distance from the first output to that after the hand has been still for 1 s.
    """
    jumps, drifts = [], []
    for row in np.linspace(0, len(frames) - 1, ENGAGEMENTS).astype(int):
        forget(retarget)
        outputs = [retarget(frames[row]) for _ in range(1 + round(rate_hz))]
        first, last = fingertips(np.stack([outputs[0], outputs[-1]]))
        jumps.append(np.linalg.norm(first - start, axis=-1).mean())
        drifts.append(np.linalg.norm(last - first, axis=-1).mean())
    forget(retarget)
    return {"jump_mm": float(1000 * np.mean(jumps)), "settling_mm": float(1000 * np.mean(drifts))}


def call_times(retarget: Callable, frames: np.ndarray, calls: int = 2000) -> np.ndarray:
    """Measures the wall times (calls,), s, of calls with one frame each, after a warm-up."""
    for frame in frames[:50]:
        retarget(frame)
    times = np.empty(calls)
    for k in range(calls):
        frame = frames[k % len(frames)]
        start = time.perf_counter()
        retarget(frame)
        times[k] = time.perf_counter() - start
    return times


def _angles(retarget: Callable, p_HF: np.ndarray) -> np.ndarray:
    """Evaluates retarget(p_HF), (N, n), in chunks; raises ValueError for another shape or NaN."""

    def checked(points: np.ndarray) -> np.ndarray:
        angles = retarget(points)
        if np.ndim(angles) != 2 or len(angles) != len(points):
            raise ValueError(
                f"a retargeter must return (N, n) for (N, F, 3); it returned {np.shape(angles)} for "
                f"{points.shape}"
            )
        return angles

    q = _in_chunks(checked, p_HF)
    if lost := np.count_nonzero(~np.isfinite(q).all(axis=1)):
        raise ValueError(f"a retargeter must return finite angles; {lost} of {len(q)} rows are not")
    return q


def _in_chunks(f: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
    return np.concatenate([f(rows[i : i + _CHUNK]) for i in range(0, len(rows), _CHUNK)])

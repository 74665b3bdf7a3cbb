"""How well a retargeter serves a person: motion, coverage, flatness, pinch, collision, smoothness, latency.

Every figure is computed through the robot's exact kinematics and averaged over fingers. The
functions take g = FK∘f, "where do the robot's fingertips (N, F, 3) go for human fingertips
(N, F, 3)", in metres; randomness enters as a NumPy Generator.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from geort_drake.comparison.contact_metrics import pinch, self_collision
from geort_drake.errors import RecordingError
from geort_drake.hands.canonical import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.training.map_figures import (
    HUMAN_VOXEL,
    ROBOT_SAMPLES,
    FingertipMap,
    anchor_rows,
    coverage,
    cross_talk,
    directions,
    motion_cosines,
    motion_preservation_track,
    moved,
    robot_voxels,
)

MIN_FRAMES = 10
SMALL_STEP = 0.002  # m, at which flatness and gain are measured
UNANSWERED = 1e-6  # a gain so small is rounding


@dataclass(frozen=True)
class RobotSpace:
    """Where the robot's fingertips can go: its C-space, from uniform samples of the joint angles.

    Attributes:
        p_BF: (N, F, 3) fingertips of all samples, m; a left hand's in the mirror, as people are right hands.
        reachable: F arrays (M, 3), the centres of the 3 mm voxels that samples hit, m.
        collision_free: the same of the samples without self-collision.
    """

    p_BF: np.ndarray
    reachable: list[np.ndarray]
    collision_free: list[np.ndarray]


@dataclass(frozen=True)
class Distributions:
    """What figures are means and percentiles of, for plots.

    Attributes:
        p_BF: (T, F, 3) where the robot's fingertips went, m, as in `RobotSpace`.
        cosines: (F, N) of `motion_cosines`.
        gains: (F, N) of `flatness_and_gain`.
        call_times: (N,) of `call_times`, s.
    """

    p_BF: np.ndarray
    cosines: np.ndarray
    gains: np.ndarray
    call_times: np.ndarray


def robot_space(hand: HandModel, seed: int = 0) -> RobotSpace:
    """Samples the C-space of a hand; it is the same for all methods, so it is worth keeping."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(hand.lower, hand.upper, (ROBOT_SAMPLES, len(hand.joint_names)))
    p_BF = _fingertips_of(hand)(q)
    return RobotSpace(p_BF, robot_voxels(p_BF), robot_voxels(p_BF[~hand.collides(q)]))


def evaluate(retarget: Callable, hand: HandModel, recording: Recording, seed: int = 0) -> dict:
    """All metrics of a retargeter on one recording, as a JSON-ready dictionary.

    Args:
        retarget: maps (F, 3) and (N, F, 3) human fingertips in H, m, to joint angles in rad.
        hand: model of the robot hand; its fingers are those of the retargeter.
        recording: of the person's hand.
        seed: of the anchors, directions and robot samples.

    Raises:
        RecordingError: when the recording has too few frames to measure on.
    """
    keypoints = hand.description.human_keypoints
    frames = recording.fingertips(keypoints)
    check_frames(frames)
    return evaluate_frames(retarget, hand, frames, recording.rate_hz, seed, robot_space(hand, seed))[0]


def check_frames(frames: np.ndarray) -> None:
    """Raises RecordingError unless there are enough frames (T, F, 3) to measure on."""
    if len(frames) < MIN_FRAMES:
        raise RecordingError(
            f"metrics need at least {MIN_FRAMES} valid frames, the recording has {len(frames)}"
        )


def evaluate_frames(
    retarget: Callable,
    hand: HandModel,
    frames: np.ndarray,
    rate_hz: float,
    seed: int = 0,
    space: RobotSpace | None = None,
    settled: Callable | None = None,
) -> tuple[dict, Distributions]:
    """`evaluate` for human fingertips (T, F, 3) of successive frames at `rate_hz`.

    A retargeter whose answers depend on the past answers `frames` in their order, as a batch. Where
    hands are asked about that were not recorded (random motion, cross-talk, flatness, gain and the
    context average), `settled` answers in its place: a map without memory. Without `space` the
    coverages are None.

    Returns:
        The metrics, and what they were made of.
    """
    check_frames(frames)
    rng = np.random.default_rng([seed, 1])  # not the numbers that robot_space drew

    fingertips = _fingertips_of(hand)

    def g(p_HF: np.ndarray) -> np.ndarray:
        return fingertips(_in_chunks(settled or retarget, p_HF))

    q = _in_chunks(retarget, frames)
    p_BF = fingertips(q)
    flat, gains = flatness_and_gain(g, frames, rng)
    collided = self_collision(hand, q)
    cosines = motion_cosines(g, frames, rng)
    figures = {
        "motion_preservation": float(cosines.mean()),
        "motion_preservation_track": motion_preservation_track(frames, p_BF),
        **_coverages(g, frames, p_BF, space),
        "cross_talk": cross_talk(g, frames, rng),
        "flatness": flat,
        "gain_p95_p5": gain_ratio(gains),
        "pinch": pinch(frames, p_BF, hand.finger_names, hand.tip_radius),
        "self_collision": collided["deep"],
        "self_collision_raw": collided["any"],
        "smoothness": smoothness(q, rate_hz),
    }
    times = call_times(retarget, frames)
    median, p99 = np.percentile(times, (50, 99))
    figures["latency_us"] = {"median": 1e6 * float(median), "p99": 1e6 * float(p99)}
    return figures, Distributions(p_BF, cosines, gains, times)


def _fingertips_of(hand: HandModel) -> Callable[[np.ndarray], np.ndarray]:
    """From joint angles (N, n) to fingertips (N, F, 3)."""
    kinematics = canonical_kinematics(hand)
    return lambda q: kinematics.fingertips(torch.from_numpy(q)).numpy()


def _coverages(g: FingertipMap, frames: np.ndarray, p_BF: np.ndarray, space: RobotSpace | None) -> dict:
    if space is None:
        return dict.fromkeys(("coverage", "coverage_context_averaged", "coverage_collision_free"))
    tips = list(np.moveaxis(p_BF, 1, 0))
    return {
        "coverage": coverage(space.reachable, tips),
        "coverage_context_averaged": coverage(space.reachable, context_averaged(g, frames)),
        "coverage_collision_free": coverage(space.collision_free, tips),
    }


def context_averaged(g: FingertipMap, frames: np.ndarray, contexts: int = 12) -> list[np.ndarray]:
    """Per finger, where its tip goes, averaged over what the person's other fingers may be doing: (M, 3).

    Each visited 1 mm voxel of a finger's tip is tried with the other tips of the recorded frames whose
    own tip is nearest; what a coupled map reaches only through the other fingers averages out.
    """
    count = min(contexts, len(frames))
    result = []
    for finger in range(frames.shape[1]):
        tips = voxel_thinned(frames[:, finger], HUMAN_VOXEL)
        _, rows = cKDTree(frames[:, finger]).query(tips, k=count)
        hands = frames[rows.ravel()]
        hands[:, finger] = np.repeat(tips, count, axis=0)
        result.append(g(hands)[:, finger].reshape(len(tips), count, 3).mean(axis=1))
    return result


def flatness_and_gain(
    g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 2000
) -> tuple[float, np.ndarray]:
    """Mean squared second over first difference, and the gain of every step (F, anchors), at 2 mm.

    The gain is how far a robot fingertip moves per metre of its human one.
    """
    flats, gains = [], []
    for finger in range(frames.shape[1]):
        x = frames[anchor_rows(frames[:, finger], anchors, rng)]
        d = SMALL_STEP * directions(anchors, rng)
        here = g(x)[:, finger]
        ahead, behind = moved(g, x, finger, d)[:, finger], moved(g, x, finger, -d)[:, finger]
        first = np.linalg.norm(ahead - here, axis=1)
        second = np.linalg.norm(ahead + behind - 2 * here, axis=1)
        flats.append((second**2).mean() / max((first**2).mean(), 1e-18))
        gains.append(first / SMALL_STEP)
    return float(np.mean(flats)), np.stack(gains)


def gain_ratio(gains: np.ndarray) -> float | None:
    """95th over 5th percentile of the gain (F, anchors), averaged over fingers.

    None where a finger does not answer a twentieth of the steps.
    """
    low, high = np.percentile(gains, (5, 95), axis=1)
    return float((high / low).mean()) if low.min() > UNANSWERED else None


def smoothness(q: np.ndarray, rate_hz: float) -> dict[str, float]:
    """Step of the joint vector per frame, |Δq| in rad, and mean jerk |Δ³q| · rate³ in rad/s³."""
    step = np.linalg.norm(np.diff(q, axis=0), axis=1)
    jerk = np.linalg.norm(np.diff(q, n=3, axis=0), axis=1) * rate_hz**3
    return {
        "mean": float(step.mean()),
        "p95": float(np.percentile(step, 95)),
        "max": float(step.max()),
        "jerk": float(jerk.mean()),
    }


def call_times(retarget: Callable, frames: np.ndarray, calls: int = 2000) -> np.ndarray:
    """Wall time (calls,) of calls with one frame each, after a warm-up, s."""
    for frame in frames[:50]:
        retarget(frame)
    times = np.empty(calls)
    for k in range(calls):
        frame = frames[k % len(frames)]
        started = time.perf_counter()
        retarget(frame)
        times[k] = time.perf_counter() - started
    return times


def _in_chunks(retarget: Callable, p_HF: np.ndarray, rows: int = 4096) -> np.ndarray:
    """retarget(p_HF) in pieces, because hidden layers of a long recording would fill the memory."""
    return np.concatenate([retarget(p_HF[i : i + rows]) for i in range(0, len(p_HF), rows)])

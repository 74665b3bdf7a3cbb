"""Measures what the guard against self-collision changes, and how long a step of it takes.

python studies/guard.py --recording hand.npy --method geort --json guard.json

Every frame of a recording (default: synthetic play) is held until the commands have settled, at most 0.33 s,
with and without the guard. Prints, and writes to --json: metrics of both, the fraction of frames that the
guard changes, and the duration of its steps in µs. Measure durations on an idle machine.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from geort_drake.comparison.metrics import motion_preservation_track, pinch, self_collision
from geort_drake.comparison.train import cached_checkpoint
from geort_drake.console import run_main
from geort_drake.files import write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.mirror import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.self_collision_guard import SelfCollisionGuard

STEPS = 33  # largest number of steps of 10 ms per frame


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--recording", type=Path, help="recording of a person's hand")
    parser.add_argument("--method", default="geort", help="method, trained on the recording or cached")
    parser.add_argument("--retargeter", type=Path, help="checkpoint instead of --method")
    parser.add_argument("--frames", type=int, help="number of frames from the start (default: all)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args(argv)
    description = load_hand(arguments.hand)
    hand = HandModel(description)
    if arguments.recording:
        recording = read_recording(arguments.recording, description.side, training=True)
    else:
        recording = synthesize_play(0)
    path = arguments.retargeter or cached_checkpoint(arguments.hand, recording, arguments.method)
    frames = recording.fingertips(description.human_keypoints)
    frames = frames[: arguments.frames].astype(float)
    unguarded = load_retargeter(path, hand)(frames)
    guarded, times, corrected = _guarded(hand, unguarded)
    figures = {
        "frames": len(frames),
        "without": _scores(hand, frames, unguarded),
        "with": _scores(hand, frames, guarded),
        "frames_changed": float((guarded != unguarded).any(axis=1).mean()),
        "us_passed_on": _percentiles(times[~corrected]),
        "us_corrected": _percentiles(times[corrected]),
    }
    print(json.dumps(figures, indent=2))
    if arguments.json:
        write_text(arguments.json, json.dumps(figures, indent=2) + "\n")
    return 0


def _guarded(hand: HandModel, unguarded: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns settled commands (T, n) under the guard; each step's time, µs, and whether it corrected."""
    start = dict(zip(hand.joint_names, hand.default_position, strict=True))
    limits = JointLimits(hand.lower, hand.upper)
    guard = SelfCollisionGuard(hand, hand.joint_names, start, limits)
    q, settled, times, corrected = hand.default_position, [], [], []
    reach = limits.speed * 0.01
    for wanted in unguarded:
        for _ in range(STEPS):
            started = time.perf_counter()
            after = guard.guarded(wanted, q)
            times.append(1e6 * (time.perf_counter() - started))
            corrected.append(not np.array_equal(after, np.clip(wanted, q - reach, q + reach)))
            moved = np.abs(after - q).max()
            q = after
            if moved < 1e-6:
                break
        settled.append(q)
    return np.array(settled), np.array(times), np.array(corrected)


def _scores(hand: HandModel, frames: np.ndarray, q: np.ndarray) -> dict:
    p_BF = canonical_kinematics(hand).fingertips(torch.from_numpy(q)).numpy()
    return {
        "motion_preservation_track": motion_preservation_track(frames, p_BF),
        "pinch": pinch(frames, p_BF, hand.finger_names, hand.tip_radius),
        "self_collision": self_collision(hand, q),
    }


def _percentiles(times: np.ndarray) -> dict[str, float]:
    if not len(times):
        return {}
    return {name: round(float(np.percentile(times, p)), 1) for name, p in (("median", 50), ("p99", 99))}


if __name__ == "__main__":
    run_main(main)

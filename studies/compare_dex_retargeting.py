"""Compares our online baselines with the dex-retargeting package, frame by frame.

python studies/compare_dex_retargeting.py --recording alex.npy

Needs `pip install dex-retargeting six`. Both sides get the same hand (its kinematics written as URDF), the
same frames in order and the same settings, without a low-pass filter. The optimisers differ: theirs stops
when the objective changes by less than 1e-6, and adds the regularisation towards the previous joint angles to
the gradient but not to the value that its line search compares. Prints distances between fingertips,
objectives and call times; --json saves them.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from geort_drake.comparison.metrics import pinch
from geort_drake.console import console, progress_bar, run_main
from geort_drake.errors import GeortError
from geort_drake.files import require_writable, write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.readers import read_recording
from geort_drake.retargeting.methods import make_untrained

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from dex_package import TYPES, make_dex_retargeter


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], epilog=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--hand", default="allegro_right", help="(default: %(default)s)")
    parser.add_argument("--recording", type=Path, required=True, help="recording of a person's hand")
    parser.add_argument("--frames", type=int, help="compare only the first N valid frames")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args(argv)
    if arguments.json:
        require_writable(arguments.json)
    description = load_hand(arguments.hand)
    if description.side != "right":
        raise GeortError(f"hand '{description.name}' is a left one; this study compares right hands")
    recording = read_recording(arguments.recording, description.side)
    hands = recording.p_HK[recording.valid].astype(float)[: arguments.frames]
    hand = HandModel(description)
    results = {}
    with progress_bar() as progress:
        for name in TYPES:
            keypoints = description.human_keypoints
            ours = make_untrained(name, hand.kinematics(), keypoints)
            try:
                theirs = make_dex_retargeter(name, hand, ours.huber_delta)
            except ImportError as error:
                raise GeortError(f"{error}; pip install dex-retargeting six") from error
            task = progress.add_task(name, total=len(hands), note="")
            q, spent = {"ours": [], "theirs": []}, {"ours": 0.0, "theirs": 0.0}
            origin, tip = theirs.optimizer.target_link_human_indices
            order = [theirs.joint_names.index(joint) for joint in hand.joint_names]
            for p_HK in hands:
                started = time.perf_counter()
                q["ours"].append(ours(p_HK))
                middle = time.perf_counter()
                q["theirs"].append(theirs.retarget(p_HK[tip] - p_HK[origin])[order])
                spent["ours"] += middle - started
                spent["theirs"] += time.perf_counter() - middle
                progress.advance(task)
            results[name] = _figures(hand, q, spent, ours, hands)
    table = Table(title=f"ours and dex-retargeting on {description.name}, {len(hands)} frames")
    for heading in ("method", "tips apart, mean / p95 / max", "ours fits better", "call, ours / theirs"):
        table.add_column(heading)
    for name, row in results.items():
        apart = " / ".join(f"{row[key]:.1f}" for key in ("mean_mm", "p95_mm", "max_mm"))
        calls = f"{row['call_ms']['ours']:.1f} / {row['call_ms']['theirs']:.1f} ms"
        table.add_row(name, f"{apart} mm", f"{row['ours_lower']:.1%}", calls)
    console.print(table)
    if arguments.json:
        write_text(arguments.json, json.dumps(results, indent=2) + "\n")
        print(arguments.json)
    return 0


def _figures(hand, q, spent, ours, hands) -> dict:
    """Returns distances between fingertips and objectives without regularisation, among other figures."""
    q = {side: np.array(rows, dtype=float) for side, rows in q.items()}
    p = {side: hand.fingertips(rows) for side, rows in q.items()}
    apart = 1000 * np.linalg.norm(p["ours"] - p["theirs"], axis=-1)
    # The projections depend on the human hand alone, so both sides have the same.
    ours.reset()
    loss: dict[str, list[float]] = {"ours": [], "theirs": []}
    projected = np.zeros((1, len(ours._vectors.pairs)), dtype=bool)
    for number, p_HK in enumerate(hands):
        targets, weights, projected = ours._targets(ours._points(p_HK)[None], projected)
        for side, values in loss.items():
            values.append(ours._vectors.objective(q[side][number][None], targets, weights, None)[0][0])
    tips = ours._points(hands)
    return {
        "frames": len(hands),
        "pinch": {
            side: pinch(tips, points, hand.finger_names, hand.tip_radius) for side, points in p.items()
        },
        "mean_mm": float(apart.mean()),
        "median_mm": float(np.median(apart)),
        "p95_mm": float(np.percentile(apart, 95)),
        "max_mm": float(apart.max()),
        "loss": {side: float(np.mean(values)) for side, values in loss.items()},
        "ours_lower": float((np.array(loss["ours"]) <= np.array(loss["theirs"])).mean()),
        "call_ms": {side: 1000 * seconds / len(hands) for side, seconds in spent.items()},
    }


if __name__ == "__main__":
    run_main(main)

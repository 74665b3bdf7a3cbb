"""Draws synthetic play, and below it a glove's recording: fingertip clouds, speeds and pinches.

python studies/human_play.py human_play.png --glove manus.npz
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from geort_drake.colours import FINGER_COLOURS
from geort_drake.console import run_main
from geort_drake.files import atomic_path
from geort_drake.people.coverage import fingertip_speeds, pinch_distances
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.people.synthetic.play import synthesize_play


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("output", type=Path, help="picture to write")
    parser.add_argument("--glove", type=Path, help="recording to draw below, for comparison")
    parser.add_argument("--seed", type=int, default=0, help="seed of the play")
    arguments = parser.parse_args(argv)
    recordings = {f"synthetic play, seed {arguments.seed}": synthesize_play(arguments.seed)}
    if arguments.glove is not None:
        recordings[f"glove: {arguments.glove.name}"] = read_recording(arguments.glove)
    plot(recordings, arguments.output)


def plot(recordings: dict[str, Recording], path: Path) -> None:
    """Draws fingertip clouds from two sides, speeds and pinch fractions, a row per recording."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rows = len(recordings)
    figure, axes = plt.subplots(
        rows, 4, figsize=(15, 4.3 * rows), squeeze=False, layout="constrained", width_ratios=[1, 1, 1, 0.8]
    )
    limits = _limits(recordings.values())
    for row, (name, recording) in zip(axes, recordings.items(), strict=True):
        _draw_clouds(row[0], recording, (0, 2), limits, "x: out of the palm, mm", f"{name}\nfrom the side")
        _draw_clouds(row[1], recording, (1, 2), limits, "y: towards the index side, mm", "from the palm")
        _draw_speeds(row[2], recording)
        _draw_pinches(row[3], recording)
    axes[0, 2].legend(loc="lower right")
    with atomic_path(path) as draft:
        figure.savefig(draft, dpi=110)
    plt.close(figure)


def _limits(recordings: Iterable[Recording]) -> np.ndarray:
    """Returns the range (3, 2), mm, that contains every fingertip and the wrist."""
    points = np.concatenate([1e3 * recording.fingertips().reshape(-1, 3) for recording in recordings])
    low, high = np.minimum(points.min(axis=0), -8.0), np.maximum(points.max(axis=0), 8.0)
    return np.stack([low - 5, high + 5], axis=1)


def _draw_clouds(
    axis: Axes, recording: Recording, plane: tuple[int, int], limits: np.ndarray, x_label: str, title: str
) -> None:
    p_HF = 1e3 * recording.fingertips()
    some = np.linspace(0, len(p_HF) - 1, min(len(p_HF), 5000)).astype(int)
    palm = 1e3 * np.median(recording.p_HK[recording.valid][:, [0, 1, 5, 9, 13, 17, 0]], axis=0)
    for i, finger in enumerate(FINGER_NAMES):
        cloud = p_HF[some, i][:, plane]
        axis.plot(*cloud.T, ".", ms=1.2, alpha=0.5, mew=0, color=FINGER_COLOURS[finger], rasterized=True)
    axis.plot(*palm[:, plane].T, "-o", color="0.25", ms=3, lw=1.2)
    axis.set_xlim(limits[plane[0]])
    axis.set_ylim(limits[plane[1]])
    axis.set_aspect("equal")
    axis.set_xlabel(x_label)
    axis.set_ylabel("z: along the fingers, mm")
    axis.set_title(title, fontsize=10)


def _draw_speeds(axis: Axes, recording: Recording) -> None:
    speeds = fingertip_speeds(recording).clip(1e-4)
    share = np.linspace(0, 100, 400)
    for i, finger in enumerate(FINGER_NAMES):
        axis.plot(
            np.percentile(speeds[:, i], share), share, color=FINGER_COLOURS[finger], lw=1.8, label=finger
        )
    axis.set_xscale("log")
    axis.set_xlim(1e-3, 4)
    axis.set_ylim(0, 100)
    axis.grid(alpha=0.3)
    axis.set_xlabel("fingertip speed, m/s")
    axis.set_ylabel("share of frames at most as fast, %")
    known = "" if recording.metadata.get("rate_known", True) else " (rate assumed)"
    axis.set_title(f"speed, {recording.rate_hz:.0f} Hz{known}", fontsize=10)


def _draw_pinches(axis: Axes, recording: Recording) -> None:
    names = [*FINGER_NAMES[1:], "any"]
    near = np.stack(list(pinch_distances(recording).values()), axis=1) < PINCH_M
    shares = 100 * np.append(near.mean(axis=0), near.any(axis=1).mean())
    bars = axis.bar(names, shares, color=[FINGER_COLOURS.get(name, "0.5") for name in names])
    axis.bar_label(bars, fmt="%.0f %%", padding=2, fontsize=9)
    axis.set_ylim(0, 45)
    axis.set_ylabel("share of frames, %")
    axis.set_title("thumb within 15 mm of", fontsize=10)
    axis.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    run_main(main)

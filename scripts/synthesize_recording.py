"""Makes a synthetic recording of a hand at play: ranges, fists, waves and pinches, from a seed."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geort_drake.cli.console import console, run_main, warn
from geort_drake.cli.options import at_least, check_outputs, command, make_parser, positive
from geort_drake.colours import FINGER_COLOURS
from geort_drake.files import atomic_path
from geort_drake.people.checks import check_recording
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import SIDES, Recording
from geort_drake.people.summary import fingertip_speeds, summarize

_MOST_FRAMES = 5_000_000  # half a day at 120 Hz, and two gigabytes while they are made


def main(argv: Sequence[str] | None = None) -> None:
    arguments = parse_arguments(argv)
    hand = None
    if arguments.hand_of is not None:
        hand = HumanHand.fit(read_recording(arguments.hand_of, arguments.side))
    compared = {}
    if arguments.compare is not None:
        name = f"glove: {arguments.compare.name}"
        compared[name] = read_recording(arguments.compare, arguments.side)
    recording = check_recording(
        synthesize_play(arguments.seed, arguments.duration, arguments.rate, hand), str(arguments.output)
    )
    recording.save(arguments.output)
    for warning in recording.metadata["warnings"]:
        warn(warning)
    told = f"{len(recording)} frames at {recording.rate_hz:g} Hz"
    lines = {"Recording": f"{arguments.output} ({told})"}
    if arguments.plot is not None:
        plot({f"synthetic play, seed {arguments.seed}": recording} | compared, arguments.plot)
        lines["Plot"] = str(arguments.plot)
    lines["Train on it, and grasp"] = command("simulate_grasp.py", "--recording", arguments.output)
    for what, line in lines.items():
        console.print(f"{what}: {line}", markup=False, soft_wrap=True)


def plot(recordings: dict[str, Recording], path: Path) -> None:
    """Draws fingertip clouds from the side and the front, speeds and pinch shares, one row each."""
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


def _limits(recordings) -> np.ndarray:
    """(3, 2) range in mm that holds every fingertip and the wrist."""
    points = np.concatenate([1e3 * recording.fingertips().reshape(-1, 3) for recording in recordings])
    low, high = np.minimum(points.min(axis=0), -8.0), np.maximum(points.max(axis=0), 8.0)
    return np.stack([low - 5, high + 5], axis=1)


def _draw_clouds(axis, recording: Recording, plane, limits, x_label: str, title: str) -> None:
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


def _draw_speeds(axis, recording: Recording) -> None:
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


def _draw_pinches(axis, recording: Recording) -> None:
    summary = summarize(recording)
    names = [*FINGER_NAMES[1:], "any"]
    shares = 100 * np.append(summary.pinch_share, summary.any_pinch_share)
    bars = axis.bar(names, shares, color=[FINGER_COLOURS.get(name, "0.5") for name in names])
    axis.bar_label(bars, fmt="%.0f %%", padding=2, fontsize=9)
    axis.set_ylim(0, 45)
    axis.set_ylabel("share of frames, %")
    axis.set_title("thumb within 15 mm of", fontsize=10)
    axis.spines[["top", "right"]].set_visible(False)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__)
    parser.add_argument("output", type=Path, help=".npz to write")
    parser.add_argument("--seed", type=at_least(0), default=0, help="of the motions")
    parser.add_argument("--duration", type=positive, default=300.0, help="s")
    parser.add_argument("--rate", type=positive, default=120.0, help="frames per second")
    parser.add_argument(
        "--hand_of", type=Path, help="recording whose hand to use (default: an average adult's)"
    )
    parser.add_argument("--plot", type=Path, help=".png to draw clouds, speeds and pinches to")
    parser.add_argument("--compare", type=Path, help="recording to draw below, for comparison")
    parser.add_argument("--side", choices=SIDES, default="right", help="of --hand_of and --compare")
    arguments = parser.parse_args(argv)
    if arguments.duration * arguments.rate > _MOST_FRAMES:
        parser.error(f"--duration by --rate may be at most {_MOST_FRAMES:,} frames")
    # Also the name of the plot, which comes last, is looked at before anything is written.
    check_outputs(parser, (arguments.output, ".npz"), (arguments.plot, ".png"))
    return arguments


if __name__ == "__main__":
    run_main(main)

"""Evaluates retargeting methods side by side on a recording of a person's hand.

python scripts/evaluate_retargeting.py --recording alex.npy --methods geort vector_online --json table.json
"""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich import box
from rich.table import Table

from geort_drake.console import console, progress_bar, run_main
from geort_drake.evaluation.comparison import Judged, check_methods, judge, method_names, report
from geort_drake.evaluation.plots import looked_up, write_plots
from geort_drake.files import require_writable, write_text
from geort_drake.gloves.readers import read_recording
from geort_drake.hands.description import hand_names, load_hand
from geort_drake.hands.model import HandModel

EPILOG = """\
Methods that are trained are kept for the next run in the cache. A method may also be the directory of a
checkpoint. Online methods answer the recording's frames in their order; where a metric asks about hands that
were not recorded, the hand is held until their answer has settled, from their state at the nearest frame.
"""


def main(argv: Sequence[str] | None = None) -> int:
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.seed < 0:
        parser.error(f"--seed must be 0 or more, not {arguments.seed}")
    if arguments.frames is not None and arguments.frames < 10:
        parser.error(f"--frames must be at least 10, not {arguments.frames}")
    check_methods(arguments.methods)
    if arguments.json:
        require_writable(arguments.json)
    if arguments.plots:
        require_writable(arguments.plots, directory=True)
    description = load_hand(arguments.hand)
    recording = read_recording(arguments.recording, description.side, training=True)
    scored = recording
    if arguments.score_on:
        scored = read_recording(arguments.score_on, description.side)
    hand = HandModel(description)
    results: dict[str, Judged] = {}
    with progress_bar() as progress:
        task = progress.add_task("methods", total=len(arguments.methods), note="")
        for name in arguments.methods:
            progress.update(task, note=name)
            results[name] = judge(
                name, hand, recording, arguments.seed, scored, arguments.frames, trainer=_trainer(progress)
            )
            progress.advance(task)
    for table in _tables(description.name, results):
        console.print(table)
    keypoints = [finger.human_keypoint for finger in description.fingers]
    frames = scored.fingertips(keypoints)[: arguments.frames]
    if arguments.json:
        files = {
            "recording": arguments.recording.name,
            "scored_on": (arguments.score_on or arguments.recording).name,
        }
        content = {**files, **report(results, hand, recording, arguments.seed, scored)}
        write_text(arguments.json, json.dumps(content, indent=2, allow_nan=False) + "\n")
        print(arguments.json)
    if arguments.plots:
        for path in write_plots(arguments.plots, results, frames, hand.finger_names):
            print(path)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--hand",
        default="allegro_right",
        help=f"name or file of a hand description; names: {', '.join(hand_names())} (default: %(default)s)",
    )
    parser.add_argument("--recording", type=Path, required=True, help="what methods are trained on")
    parser.add_argument("--score_on", type=Path, help="score on this recording, of another person perhaps")
    parser.add_argument(
        "--methods",
        nargs="+",
        metavar="NAME",
        default=list(method_names()),
        help=f"any of {', '.join(method_names())}, or directories of checkpoints (default: all names)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of training and metrics (default: %(default)s)")
    parser.add_argument("--frames", type=int, help="score on the first so many valid frames only")
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    parser.add_argument("--plots", type=Path, help="write plots of the frontier and the fingertips here")
    return parser


def _trainer(progress):
    """`cached_checkpoint`, with the bars of training in place of these ones."""
    from geort_drake.evaluation.checkpoint_cache import cached_checkpoint

    def train(*arguments, **options):
        progress.stop()
        try:
            return cached_checkpoint(*arguments, **options)
        finally:
            progress.start()

    return train


# Title → heading → what to look up in a method's metrics, and how to print it. Two tables fit a terminal.
TABLES: dict[str, dict[str, tuple[tuple[str, ...], str]]] = {
    "motion and space": {
        "MP": (("motion_preservation",), "{:.3f}"),
        "track": (("motion_preservation_track",), "{:.3f}"),
        "cover\n10 mm": (("coverage", "10mm"), "{:.2f}"),
        "\n15 mm": (("coverage", "15mm"), "{:.2f}"),
        "averaged\n10 mm": (("coverage_context_averaged", "10mm"), "{:.2f}"),
        "cross\ntalk": (("cross_talk",), "{:.2f}"),
        "flat-\nness": (("flatness",), "{:.3f}"),
        "gain": (("gain_p95_p5",), "{:.1f}"),
    },
    "pinch, collision and speed": {
        "pinches\nclosed": (("pinch", "closed"), "{:.1%}"),
        "too\ndeep": (("pinch", "too_deep"), "{:.1%}"),
        "mean\nmm": (("pinch", "mean_mm"), "{:.1f}"),
        "false": (("pinch", "false"), "{:.2%}"),
        "self-\ncollision": (("self_collision",), "{:.1%}"),
        "call\nµs": (("latency_us", "median"), "{:.0f}"),
    },
}


def _tables(hand: str, results: Mapping[str, Judged]) -> Iterator[Table]:
    for title, columns in TABLES.items():
        table = Table(title=f"{hand}: {title}", box=box.SIMPLE, padding=(0, 1, 0, 0))
        table.add_column("method")
        for heading in columns:
            table.add_column(heading, justify="right", no_wrap=True)
        for name, judged in results.items():
            values = [(looked_up(judged.metrics, path), form) for path, form in columns.values()]
            cells = ["–" if value is None else form.format(value) for value, form in values]
            table.add_row(Path(name).name, *cells)
        yield table


if __name__ == "__main__":
    run_main(main)

"""Sweep: how do the metrics of a trained method depend on its losses and settings?

python studies/sweep.py --recording hand.npy --output runs/sweep --seeds 0 1 2 --jobs 2
python studies/sweep.py --recording hand.npy --output runs/widths hidden=64,256 coverage_weight=0,2

A method is trained with its defaults, and again with one setting changed at a time: the settings given as
NAME=V1,V2, or without any every *_weight at 0, half and double its value. Each run is a checkpoint in
OUTPUT/METHOD-CHANGE-seedN, so an interrupted sweep continues with the same command; delete the folder after
changing the code of training. OUTPUT/sweep.md compares every run with the default run of the same seed: mean
and standard deviation of the differences over seeds. OUTPUT/frontier.png shows the means of all runs.
Latencies are not reported, as several runs share the machine.
"""

import argparse
import json
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from joblib import Parallel, delayed

from geort_drake.comparison.metric_table import TABLES, mean
from geort_drake.comparison.plots import STYLE, frontier, save
from geort_drake.comparison.train import DEFAULT_METHOD, train_checkpoint, training_config
from geort_drake.console import console, run_main
from geort_drake.errors import GeortError
from geort_drake.files import require_writable, write_text
from geort_drake.hands.description import load_hand
from geort_drake.retargeting.checkpoint import METRICS
from geort_drake.settings import parse_settings, settings_of

COLUMNS = [metric for table in TABLES.values() for metric in table if not metric.path.startswith("latency")]
FACTORS = (0.0, 0.5, 2.0)  # of a weight; 0 removes its loss
Settings = dict[str, Any]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("changes", nargs="*", metavar="NAME=V1,V2", help="settings to vary (default: every loss weight)")
    add("--recording", type=Path, required=True, help="of a person's hand")
    add("--output", type=Path, required=True, help="folder of the sweep")
    add("--hand", default="allegro_right", help="name or file of a hand description")
    add("--method", default=DEFAULT_METHOD, help="a trained method (default: %(default)s)")
    add("--seeds", type=int, nargs="+", default=[0], help="of training and metrics")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of all runs, repeatable")
    add("--jobs", type=int, default=1, help="runs at a time, one thread each")
    arguments = parser.parse_args(argv)
    require_writable(arguments.output, directory=True)
    config = training_config(arguments.method, hand=load_hand(arguments.hand))
    common = parse_settings(arguments.set, config, arguments.method)
    changes = list(changes_of(arguments.method, {**settings_of(config), **common}, arguments.changes))
    tasks = [
        delayed(run)(arguments, folder_of(arguments, change, seed), {**common, **change}, seed)
        for change in changes
        for seed in arguments.seeds
    ]
    console.print(f"{len(tasks)} runs")
    errors = [error for error in Parallel(arguments.jobs, inner_max_num_threads=1)(tasks) if error]
    for error in errors:
        console.print(error, style="red", markup=False)
    report(arguments, changes)
    return 1 if errors else 0


def changes_of(method: str, settings: Settings, texts: Sequence[str]) -> Iterator[Settings]:
    """What each run changes: nothing first, then one setting each."""
    yield {}
    for text in texts:
        name, _, values = text.partition("=")
        for value in values.split(","):
            yield parse_settings([f"{name}={value}"], training_config(method), method)
    if not texts:
        weights = {name: value for name, value in settings.items() if name.endswith("_weight") and value}
        yield from ({name: factor * value} for name, value in weights.items() for factor in FACTORS)


def folder_of(arguments: argparse.Namespace, change: Settings, seed: int) -> Path:
    """The checkpoint of a run."""
    return arguments.output / f"{arguments.method}-{title_of(change)}-seed{seed}"


def title_of(change: Settings) -> str:
    return ",".join(f"{name}={value}" for name, value in change.items()) or "default"


def run(arguments: argparse.Namespace, folder: Path, settings: Settings, seed: int) -> str | None:
    """Trains one run unless it exists; returns the error if there was one."""
    if not folder.exists():
        try:
            train_checkpoint(
                arguments.hand,
                arguments.recording,
                folder,
                arguments.method,
                seed,
                show_progress=False,
                settings=settings,
            )
        except GeortError as error:
            return f"{folder.name}: {error}"
    return None


def report(arguments: argparse.Namespace, changes: Sequence[Settings]) -> None:
    """Writes the table and the plot of the runs that exist."""
    metrics: dict[str, dict[int, dict]] = {}  # title of a change → seed → metrics
    for change in changes:
        files = {seed: folder_of(arguments, change, seed) / METRICS for seed in arguments.seeds}
        found = {seed: json.loads(path.read_text("utf-8")) for seed, path in files.items() if path.exists()}
        if found:
            metrics[title_of(change)] = found
    if not metrics:
        return
    default = metrics.get("default", {})
    headings = ["run", "seeds", *(metric.path for metric in COLUMNS)]
    rows = [headings, ["---"] * len(headings)]
    for title, found in metrics.items():
        row = [title, " ".join(map(str, found))]
        for metric in COLUMNS:
            values = [metric.of(of_seed) for of_seed in found.values()]
            if title != "default":
                pairs = [
                    (metric.of(found[seed]), metric.of(default[seed])) for seed in found if seed in default
                ]
                values = [None if None in pair else pair[0] - pair[1] for pair in pairs]
            row.append(mean_and_deviation(metric.form, values, "" if title == "default" else "+"))
        rows.append(row)
    text = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    write_text(arguments.output / "sweep.md", text)
    with mpl.rc_context(STYLE):
        means = {title: mean(list(found.values())) for title, found in metrics.items()}
        save(frontier(means), arguments.output / "frontier.png")
    console.print(f"Table and plot: {arguments.output}", markup=False)


def mean_and_deviation(form: str, values: Sequence[float | None], sign: str) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    text = form.replace("{:", "{:" + sign).format(statistics.mean(known))
    return text if len(known) == 1 else f"{text} ± {form.format(statistics.stdev(known))}"


if __name__ == "__main__":
    run_main(main)

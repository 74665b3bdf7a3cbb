"""Times functions in turns, so that other load affects them equally; shared by all benchmarks."""

import argparse
import datetime
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import joblib
import numpy as np
from rich.table import Table

from geort_drake.console import console
from geort_drake.files import require_writable, write_text

BLOCK = 0.002  # s; long compared with a switch of functions, short compared with other programs' time slices


def parser(doc: str) -> argparse.ArgumentParser:
    """Returns a parser with the options that all benchmarks share."""
    options = argparse.ArgumentParser(
        description=doc.splitlines()[0], epilog=doc, formatter_class=argparse.RawTextHelpFormatter
    )
    options.add_argument(
        "--seconds", type=float, default=20.0, help="time to measure for (default: %(default)s)"
    )
    options.add_argument("--json", type=Path, help="write the figures to this file")
    return options


def parse(options: argparse.ArgumentParser, argv) -> argparse.Namespace:
    """Parses the arguments; refuses a --json file that cannot be written before the work."""
    arguments = options.parse_args(argv)
    if arguments.json:
        require_writable(arguments.json)
    return arguments


def worker_counts() -> list[int]:
    """Returns 1, 2, 4, ... up to the number of cores, and that number."""
    cores = joblib.cpu_count()
    return sorted({1, *(n for n in (2, 4, 8, 16, 32) if n < cores), cores})


def measure(functions: Mapping[str, Callable[[], object]], seconds: float) -> dict[str, dict]:
    """Calls the functions in turns, a block of calls each, for `seconds`.

    Returns:
        Name → number of calls; median and percentiles of a call, µs, in wall time and in CPU time of the
        thread (without other programs' time slices, but with 0.8 µs of its clock); and `blocks`, the median
        CPU time of each block, µs.
    """
    wall: dict[str, list[int]] = {name: [] for name in functions}
    cpu: dict[str, list[list[int]]] = {name: [] for name in functions}
    counts = {name: max(1, round(BLOCK / _fastest(function))) for name, function in functions.items()}
    end, turns = time.perf_counter() + seconds, 0
    while turns < 5 or time.perf_counter() < end:
        turns += 1
        for name, function in functions.items():
            cpu[name].append(spent := [])
            for _ in range(counts[name]):
                busy, started = time.thread_time_ns(), time.perf_counter_ns()
                function()
                wall[name].append(time.perf_counter_ns() - started)
                spent.append(time.thread_time_ns() - busy)
    return {name: _summary(np.array(wall[name]), np.array(cpu[name])) for name in functions}


def _fastest(function: Callable[[], object]) -> float:
    """Returns the seconds of the fastest of some calls, which also warm up the function."""
    times, end = [], time.perf_counter() + 20 * BLOCK
    while len(times) < 3 or time.perf_counter() < end:
        started = time.perf_counter()
        function()
        times.append(time.perf_counter() - started)
    return min(times)


def _summary(wall_ns: np.ndarray, cpu_ns: np.ndarray) -> dict:
    summary = {"calls": wall_ns.size, "turns": len(cpu_ns), "blocks": np.median(cpu_ns, axis=1) / 1000}
    for clock, times in (("wall", wall_ns), ("cpu", cpu_ns)):
        for key, percent in (("p5", 5), ("median", 50), ("p95", 95), ("p99", 99)):
            summary[f"{clock}_{key}_us"] = float(np.percentile(times, percent)) / 1000
    return summary


def ratios(results: Mapping[str, dict], to: str) -> dict[str, dict]:
    """Returns the ratio of CPU times to those of `to`, block by block: median and percentiles 5 and 95."""
    found = {}
    for name, row in results.items():
        p5, median, p95 = np.percentile(row["blocks"] / results[to]["blocks"], [5, 50, 95])
        found[name] = {"median": float(median), "p5": float(p5), "p95": float(p95)}
    return found


def report(title: str, results: Mapping[str, dict], to: str, path: Path | None, **more) -> None:
    """Prints a table with ratios to the row `to`, and writes everything as JSON if `path` is given."""
    against = ratios(results, to)
    table = Table(title=title)
    for heading in ("", "median", "p99", "CPU median", "CPU p99", f"CPU over '{to}' (p5 – p95)"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in results.items():
        times = [
            f"{row[key]:,.1f} µs" for key in ("wall_median_us", "wall_p99_us", "cpu_median_us", "cpu_p99_us")
        ]
        r = against[name]
        table.add_row(name, *times, f"{r['median']:.2f} ({r['p5']:.2f} – {r['p95']:.2f})")
    console.print(table)
    if path:
        rows = {
            name: {key: value for key, value in row.items() if key != "blocks"} | {"ratio": against[name]}
            for name, row in results.items()
        }
        write_json(path, title=title, ratio_to=to, results=rows, **more)


def write_json(path: Path, **content) -> None:
    """Writes the figures with facts about the machine."""
    write_text(path, json.dumps({**content, "machine": machine()}, indent=2) + "\n")
    print(path)


def machine() -> dict:
    """Returns processor, versions, load and command."""
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load_average": os.getloadavg(),
        "threads": os.environ.get("OMP_NUM_THREADS"),
        "system": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "blas": f"{blas['name']} {blas['version']}",
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    names = (
        [line for line in info.read_text().splitlines() if line.startswith("model name")]
        if info.exists()
        else []
    )
    return names[0].split(":")[1].strip() if names else platform.processor()

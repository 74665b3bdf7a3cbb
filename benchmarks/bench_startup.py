"""Times imports and the loading of a checkpoint, each in a fresh Python process.

python benchmarks/bench_startup.py --json startup.json

NumPy's import, which all others include, has its own row.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table
from side_by_side import parse, parser, write_json
from untrained import FORMS, untrained, untrained_arrays

from geort_drake.console import console, run_main
from geort_drake.retargeting.checkpoint import save_checkpoint

# Program of a child process: `before` is not timed, `code` is.
TIMED = """
import sys, time
{before}
wall, cpu = time.perf_counter(), time.process_time()
{code}
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
heavy = [name for name in ("torch", "pydrake", "rerun") if name in sys.modules]
print(1000 * wall, 1000 * cpu, *heavy)
"""


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse(parser(__doc__), argv)
    with tempfile.TemporaryDirectory() as folder:
        steps = {
            "import numpy": ("", "import numpy"),
            "import geort_drake": ("", "import geort_drake"),
            "import geort_drake.retargeting.retargeter": ("", "import geort_drake.retargeting.retargeter"),
        }
        silent = "import contextlib, io; silence = contextlib.redirect_stdout(io.StringIO())"
        show = "from geort_drake.cli import main; silence.__enter__(); main([]); sys.stdout = sys.__stdout__"
        steps["geort-drake --help"] = (silent, show)
        load = "from geort_drake.retargeting.retargeter import load_retargeter"
        for method in FORMS:
            path = _checkpoint(method, Path(folder) / method)
            steps[f"load_retargeter, {method}"] = (load, f"load_retargeter({str(path)!r})")
        times: dict[str, list[list[float]]] = {name: [] for name in steps}
        heavy: dict[str, list[str]] = {}
        end, turns = time.perf_counter() + arguments.seconds, 0
        while turns < 3 or time.perf_counter() < end:
            turns += 1
            for name, (before, code) in steps.items():
                wall, cpu, *heavy[name] = _timed(before, code)
                times[name].append([float(wall), float(cpu)])
    table = Table(title="start-up")
    for heading in ("", "median", "p5 – p95", "CPU median", "heavy packages"):
        table.add_column(heading, justify="right" if heading else "left")
    results = {}
    for name, rows in times.items():
        (p5, median, p95), cpu = np.percentile(rows, [5, 50, 95], axis=0).T[0], np.median(rows, axis=0)[1]
        found = ", ".join(heavy[name]) or "none"
        table.add_row(name, f"{median:.1f} ms", f"{p5:.1f} – {p95:.1f} ms", f"{cpu:.1f} ms", found)
        results[name] = {
            "processes": len(rows),
            "wall_p5_ms": float(p5),
            "wall_median_ms": float(median),
            "wall_p95_ms": float(p95),
            "cpu_median_ms": float(cpu),
            "heavy": heavy[name],
        }
    console.print(table)
    if arguments.json:
        write_json(arguments.json, title="start-up", results=results)
    return 0


def _timed(before: str, code: str) -> list[str]:
    script = TIMED.format(before=before, code=code)
    return subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()


def _checkpoint(method: str, path: Path) -> Path:
    """Writes a checkpoint with random weights, of a trained one's size."""
    model = untrained(method)
    names = {"finger_names": list(model.finger_names), "joint_names": list(model.joint_names)}
    limits = {"lower": model.lower.tolist(), "upper": model.upper.tolist()}
    return save_checkpoint(
        path,
        untrained_arrays(method, 4, 4),
        method=method,
        hand={"name": "untrained", "model_sha256": "", **names, **limits},
        human_keypoints=[4, 8, 12, 16],
        training={},
        provenance={},
        history=[{"step": step, "total": 0.0} for step in range(200)],
    )


if __name__ == "__main__":
    run_main(main)

"""Times the labelling of robot samples: fingertips and self-collisions of random postures, from Drake.

python benchmarks/bench_robot_data.py --json robot_data.json

Each number of processes labels the same postures in turns, without a cache; results must be bitwise equal.
Ratios are wall time over that of one process, turn by turn.
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table
from side_by_side import parse, parser, worker_counts, write_json

from geort_drake.console import console, run_main
from geort_drake.errors import GeortError
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.hands.samples import RobotData, robot_data


def main(argv: Sequence[str] | None = None) -> int:
    made = parser(__doc__)
    made.set_defaults(seconds=60.0)
    made.add_argument("--hand", default="allegro_right", help="(default: %(default)s)")
    made.add_argument("--count", type=int, default=100_000, help="postures (default: %(default)s)")
    arguments = parse(made, argv)
    hand = HandModel(load_hand(arguments.hand))
    numbers = worker_counts()
    times: dict[int, list[float]] = {number: [] for number in numbers}
    busy: list[float] = []
    wanted = None
    end = time.perf_counter() + arguments.seconds
    while len(busy) < 3 or time.perf_counter() < end:
        for number in numbers:
            cpu, wall = time.process_time(), time.perf_counter()
            data = _labelled(hand, arguments.count, number)
            times[number].append(time.perf_counter() - wall)
            if number == 1:
                busy.append(time.process_time() - cpu)
            wanted = wanted or data
            _check_equal(data, wanted, number)
    table = Table(title=f"{arguments.count:,} postures of {arguments.hand}, labelled")
    for heading in ("processes", "wall, median", "p5 – p95", "over one process"):
        table.add_column(heading, justify="right")
    rows = {}
    for number, walls in times.items():
        p5, median, p95 = np.percentile(walls, [5, 50, 95])
        ratio = float(np.median(np.divide(walls, times[1])))
        rows[number] = {"median_s": median, "p5_s": p5, "p95_s": p95, "ratio": ratio}
        table.add_row(str(number), f"{median:.2f} s", f"{p5:.2f} – {p95:.2f} s", f"{ratio:.2f}")
    console.print(table)
    each = 1e6 * float(np.median(busy)) / arguments.count
    console.print(f"CPU time of one posture in one process: {each:.1f} µs")
    if arguments.json:
        write_json(arguments.json, results=rows, cpu_per_posture_us=each, count=arguments.count)
    return 0


def _labelled(hand: HandModel, count: int, processes: int) -> RobotData:
    with tempfile.TemporaryDirectory() as folder:
        return robot_data(hand, count, seed=0, cache=Path(folder), processes=processes)


def _check_equal(data: RobotData, wanted: RobotData, processes: int) -> None:
    for name, value in vars(wanted).items():
        if not np.array_equal(value, getattr(data, name)):
            raise GeortError(f"{name} of {processes} processes differs from that of one")


if __name__ == "__main__":
    run_main(main)

"""Measures reliability: what happens when inputs, files, frames, disks and processes fail?

python studies/reliability.py
python studies/reliability.py --parts frames files

Injects faults and counts the outcomes. Writes the counts to docs/results/data/reliability.json, and the table
of docs/results/reliability.md to reliability.csv in the same folder; --json and --quick leave both unchanged.
The exit code is 1 if a guarantee was broken. Needs the test extra, and for the part "guided" atheris: pip
install atheris
"""

import argparse
import csv
import gc
import io
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from geort_drake.console import console, progress_bar, run_main
from geort_drake.errors import GeortError
from geort_drake.files import require_writable, write_text
from geort_drake.systems.glove_checks import GloveChecks

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "docs" / "results" / "data"
TABLE, FIGURES = DATA / "reliability.csv", DATA / "reliability.json"
_MACHINE = ("date", "processor", "cores", "load_average", "python")
# The faults are shared with the tests, which inject only some of them.
sys.path[:0] = [str(ROOT / name) for name in ("tests", "benchmarks", "studies")]

from faults import disks, kills  # noqa: E402
from faults.hostile import CASES, faults_of  # noqa: E402
from faults.mutations import fuzz  # noqa: E402
from faults.sound import LOWER, TIPS, UPPER, play, smooth_retargeter  # noqa: E402
from faults.systems import (  # noqa: E402
    faulty_frames,
    fuzz_arm,
    fuzz_guard,
    fuzz_system,
)
from guided_fuzzing import fuzz_guided, require_atheris  # noqa: E402
from side_by_side import machine  # noqa: E402
from system_bench import Bench, Watch  # noqa: E402

Report = Callable[[int, int], None]  # called with the numbers of finished and of all items

FULL = {
    "inputs": None, "files": 10_000, "guided": 20_000, "kills": 25, "frames": 10_000, "commands": 100_000,
    "updates": 1_000_000, "trials": 3,
}  # fmt: skip
QUICK = {
    "inputs": 20, "files": 400, "guided": 400, "kills": 5, "frames": 1_000, "commands": 1_000,
    "updates": 5_000, "trials": 1,
}  # fmt: skip
GROWTH_MB, SLOW_DOWN = 10.0, 0.05
_BLOCKS = 100  # of updates, whose times are compared


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parse(argv)
    counts = counts_of(arguments)
    store = arguments.json or (None if arguments.quick else FIGURES)
    figures = json.loads(store.read_text("utf-8")) if store and store.exists() else {}
    with tempfile.TemporaryDirectory() as name, progress_bar() as progress:
        for part in arguments.parts:
            task = progress.add_task(part, total=1, note="")

            def report(done: int, total: int, task=task) -> None:
                progress.update(task, completed=done, total=total)

            started = time.perf_counter()
            result = PARTS[part](counts, arguments.seed, Path(name) / part, report)
            took = {"seconds": round(time.perf_counter() - started, 1), "seed": arguments.seed}
            on = {name: value for name, value in machine().items() if name in _MACHINE}
            figures[part] = {**result, "measured": took | on}
            # Written after each part, because a long one may be interrupted.
            if store:
                write_text(store, json.dumps(figures, indent=2) + "\n")
    text = table(figures)
    console.print(text, markup=False, soft_wrap=True)
    if store == FIGURES:
        write_text(TABLE, text)
        console.print(f"Written: {TABLE}", soft_wrap=True)
    failures = [text for part in arguments.parts for text in figures[part]["failures"]]
    for text in failures:
        console.print(text, style="red", markup=False, soft_wrap=True)
    return 1 if failures else 0


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="parts to measure (default: all)")
    add("--quick", action="store_true", help="a small part of everything; the page is not changed")
    for name, count in FULL.items():
        add(
            f"--{name}",
            type=int,
            metavar="N",
            help=f"number of {name} (default: {'all' if count is None else f'{count:,}'})",
        )
    add("--seed", type=int, default=0, help="seed of all random choices (default: 0)")
    add("--json", type=Path, help="another file for the figures; figures of other parts in it are kept")
    arguments = parser.parse_args(argv)
    if arguments.json:
        require_writable(arguments.json)
    if "guided" in arguments.parts:
        require_atheris()
    return arguments


def counts_of(arguments: argparse.Namespace) -> dict:
    """Returns the requested number of each kind of fault."""
    usual = QUICK if arguments.quick else FULL
    given = {name: getattr(arguments, name) for name in FULL}
    return {name: usual[name] if value is None else value for name, value in given.items()}


# -- the parts


def inputs(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Tries malformed inputs, and counts those that are refused as they should be."""
    chosen = list(CASES)
    if counts["inputs"] is not None:
        chosen = [chosen[i] for i in np.random.default_rng(seed).permutation(len(chosen))[: counts["inputs"]]]
    tried: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    failures = []
    for number, case in enumerate(chosen):
        wrong = faults_of(case, folder / str(number))
        tried[case.kind] += 1
        refused[case.kind] += not wrong
        failures += [f"{case}: {'; '.join(wrong)}"] if wrong else []
        report(number + 1, len(chosen))
    return {"tried": dict(tried), "refused": dict(refused), "failures": failures}


def files(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Tries sound inputs with random changes."""
    return fuzz(counts["files"], seed, folder, report)


def guided(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Tries random changes, guided by the lines of the readers that they reach."""
    result = fuzz_guided(counts["guided"], seed, folder)
    report(1, 1)
    return result


def killed(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Kills programs at random moments and starts them again."""
    rng, known = np.random.default_rng(seed), {}
    tried: Counter[str] = Counter()
    recovered: Counter[str] = Counter()
    failures = []
    works = list(kills.WORKS)
    for number in range(counts["kills"]):
        work = works[number % len(works)]
        if work not in known:
            known[work] = kills.reference(work, folder / work)
        by_clock = number // len(works) % 2 == 0
        wrong = kills.kill(known[work], folder / f"{work}-{number}", rng, by_clock)
        tried[work] += 1
        recovered[work] += not wrong
        failures += [f"{work} killed, number {number}: {'; '.join(wrong)}"] if wrong else []
        report(number + 1, counts["kills"])
    return {"tried": dict(tried), "recovered": dict(recovered), "failures": failures}


def disk(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Writes to files that may not grow, full disks and read-only disks."""
    failures, tried = [], {}
    mounts = disks.can_mount(folder / "mounts")
    for reason, options in disks.DISKS.items():
        if mounts or not options:
            failures += [f"{reason}: {text}" for text in disks.spoilt(folder / reason, reason)]
            tried[reason] = len(disks.WRITERS)
    report(1, 1)
    return {"tried": tried, "failures": failures}


def frames(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Sends faulty frames to the system and the Python call, and faulty wrist poses to the arm."""
    results = {
        "system": fuzz_system(counts["frames"], seed),
        "call": fuzz_call(counts["frames"], seed),
        "compiled": fuzz_call(counts["frames"], seed, "numba"),
        "arm": fuzz_arm(counts["frames"], seed),
    }
    report(1, 1)
    failures = [
        f"the {name} broke a guarantee {result['violations']} times: {result}"
        for name, result in results.items()
        if result["violations"] or result.get("speed_when_held")
    ]
    return {**results, "failures": failures}


def fuzz_call(count: int, seed: int, backend: str = "numpy") -> dict:
    """Calls a retargeter with `count` faulty frames: results are within the limits, or frames refused."""
    rng = np.random.default_rng(seed)
    retarget = smooth_retargeter()
    if backend == "numba":
        retarget.compile()
    refused = violations = 0
    for frame, _ in faulty_frames(count, rng):
        points = frame["keypoints"] if rng.random() < 0.5 else frame["keypoints"][list(TIPS)]
        try:
            q = retarget(points)
        except GeortError:
            refused += 1
            # Only points that are not finite, or whose squares are not, may be refused.
            violations += bool(np.abs(points).max() < 1e150)
        else:
            violations += not ((LOWER <= q) & (q <= UPPER)).all()
    return {"frames": count, "refused": refused, "violations": violations}


def guard(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Sends commands that fold the hand into itself to the guard."""
    result = fuzz_guard(counts["commands"], seed)
    report(1, 1)
    return {**result, "failures": [f"the guard: {result}"] if result["violations"] else []}


def updates(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Checks violations, memory and speed over very many updates."""
    results, failures = soak(counts["updates"]), []
    for name, result in results.items():
        if result["violations"] or result["growth_mb"] > GROWTH_MB:
            failures.append(f"{name}: {result}")
        # With fewer updates, noise of the machine hides a slow-down.
        elif result["slow_down"] > SLOW_DOWN and counts["updates"] >= 100_000:
            failures.append(f"{name} slows down: {result}")
    report(1, 1)
    return {"of": results, "failures": failures}


def soak(count: int) -> dict[str, dict]:
    """Makes `count` updates of a `RetargetingSystem` and as many calls of a `Retargeter`.

    Returns:
        For each: updates; violations; us_per_update; growth_mb, growth of the resident memory after the first
        tenth; and slow_down, the median CPU time of an update in the last tenth over that in the second, less
        1.
    """
    bench, frames = Bench(checks=GloveChecks(ease_at_start=False)), play().p_HK.astype(float)
    watch, retarget = Watch(bench.limits, bench.period), smooth_retargeter()

    def update(number: int) -> int:
        q, v, _ = bench.tick(frames[number % len(frames)], float(number % 997 > 5))
        return len(watch.broken(q, v))

    def call(number: int) -> int:
        return int(not np.isfinite(retarget(frames[number % len(frames)]).sum()))

    return {"RetargetingSystem": _measured(update, count), "Retargeter": _measured(call, count)}


def _measured(step: Callable[[int], int], count: int) -> dict:
    """Calls `step`, which returns the violations of an update, with the update's number."""
    blocks = np.array_split(np.arange(count), min(_BLOCKS, count))
    # The first tenth fills caches and pools.
    tenth = max(1, len(blocks) // 10)
    times, memory, violations = [], {}, 0
    for block, numbers in enumerate(blocks, 1):
        started = time.thread_time()
        for number in numbers.tolist():
            violations += step(number)
        times.append((time.thread_time() - started) / len(numbers))
        if block in (tenth, len(blocks)):
            gc.collect()
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            memory[block] = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    early, late = np.median(times[tenth : 2 * tenth] or times), np.median(times[-tenth:])
    return {
        "updates": count,
        "violations": violations,
        "growth_mb": round(max(0.0, memory[len(blocks)] - memory[tenth]), 2),
        "us_per_update": round(1e6 * float(np.median(times)), 1),
        "slow_down": round(float(late / early) - 1.0, 4),
    }


def trials(counts: dict, seed: int, folder: Path, report: Report) -> dict:
    """Simulates grasps and checks their physics at every step."""
    from faults.physics import watched
    from grasp_setup import centred_map, human_with, scenario_with

    from geort_drake.simulation.diagram import make_trial_diagram

    seen, failures = {}, []
    for number, name in enumerate(("cylinder", "sphere", "cube")[: counts["trials"]]):
        human = human_with(name)
        result = watched(make_trial_diagram(scenario_with(name), centred_map(), human), 12.0)
        seen[name] = result.__dict__
        failures += [f"{name}: {result}"] if result.violations or not result.contacts else []
        report(number + 1, counts["trials"])
    return {"of": seen, "failures": failures}


PARTS: dict[str, Callable[[dict, int, Path, Report], dict]] = {
    "inputs": inputs,
    "files": files,
    "guided": guided,
    "kills": killed,
    "disk": disk,
    "frames": frames,
    "guard": guard,
    "updates": updates,
    "trials": trials,
}


# -- the table


def table(figures: dict[str, dict]) -> str:
    """Returns the figures as CSV."""
    rows = [("what", "count", "outcome")]
    if part := figures.get("inputs"):
        for kind, count in part["tried"].items():
            rows.append(
                (f"malformed inputs: {kind}s", f"{count}", f"{part['refused'][kind]} refused by name")
            )
        total, refused = (sum(part[key].values()) for key in ("tried", "refused"))
        rows.append(("malformed inputs, all", f"{total}", f"{refused} refused by name"))
    for name, what in (("files", "at random"), ("guided", "at random, guided by the lines they reach")):
        if part := figures.get(name):
            rows.append((
                f"sound inputs of {len(part['tried'])} kinds changed {what}", f"{part['inputs']:,}",
                f"{len(part['failures'])} neither read nor refused by name",
            ))  # fmt: skip
    if part := figures.get("kills"):
        for name, count in part["tried"].items():
            rows.append((f"`kill -9` of {name}", f"{count}", f"{part['recovered'][name]} recovered"))
    if part := figures.get("disk"):
        rows.append(
            (
                "disks that are full or read-only",
                f"{sum(part['tried'].values())}",
                f"{len(part['failures'])} unclear",
            )
        )
    if part := figures.get("frames"):
        system, call, compiled, arm = (part[name] for name in ("system", "call", "compiled", "arm"))
        spoilt, jumps = (sum(of["faults"].values()) for of in (system, arm))
        rows += [
            ("frames through `RetargetingSystem`", f"{system['frames']:,}, {spoilt:,} with a fault",
             f"{system['violations']} violations"),
            ("the same to `Retargeter`", f"{call['frames']:,}", f"{call['violations']} violations"),
            ("the same, compiled by numba", f"{compiled['frames']:,}",
             f"{compiled['violations']} violations"),
            ("wrist poses through `WristToArm`, live", f"{arm['frames']:,}, {jumps:,} with a fault",
             f"{arm['violations']} violations"),
        ]  # fmt: skip
    if part := figures.get("guard"):
        rows.append((
            "commands to `SelfCollisionGuard`",
            f"{part['steps']:,}, {sum(part['corrected'].values()):,} not followed",
            f"{part['violations']} violations; {part['us_passed_on']:.0f} µs a step, "
            f"{part['us_corrected']:.0f} µs where it corrects (medians)",
        ))  # fmt: skip
    if part := figures.get("updates"):
        for name, result in part["of"].items():
            rows.append((
                f"updates of `{name}`", f"{result['updates']:,}",
                f"{result['violations']} violations; memory +{result['growth_mb']:.1f} MB; time per update "
                f"{100 * result['slow_down']:+.1f} %",
            ))  # fmt: skip
    if part := figures.get("trials"):
        for name, result in part["of"].items():
            rows.append((
                f"steps of a grasp, {name}", f"{result['steps']:,}",
                f"{result['violations']} violations; effort {100 * result['effort']:.0f} % of the limit, "
                f"penetration {1e3 * result['penetration']:.1f} mm, energy from nothing "
                f"{1e3 * result['gained']:.0f} mJ",
            ))  # fmt: skip
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    run_main(main)

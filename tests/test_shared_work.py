"""Work that is shared with other processes."""

import functools
import os
import time
from pathlib import Path

from geort_drake.hands.shared_work import shared_work, worthwhile_processes

PARTS = list(range(40))
PATIENCE_S = 120.0


def started(_number: int) -> None:
    """What a worker does first."""


def failed() -> None:
    raise RuntimeError("a worker that cannot start")


def number_and_process(part: int) -> tuple[int, int]:
    return part, os.getpid()


def noted(folder: Path, part: int) -> tuple[int, int]:
    (folder / str(part)).touch()
    return number_and_process(part)


def patient(folder: Path, part: int) -> tuple[int, int]:
    """Does the first part once a worker is at part 20."""
    deadline = time.monotonic() + PATIENCE_S
    while part == 0 and not (folder / "20").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    return number_and_process(part)


def dies(_part: int) -> None:
    os._exit(1)


def test_results_come_in_order_and_each_once():
    """Whoever made them; with one process there are no others."""
    alone = list(shared_work(PARTS, number_and_process, number_and_process, 1, started, (1,)))
    assert alone == [(part, os.getpid()) for part in PARTS]
    shared = list(shared_work(PARTS, number_and_process, number_and_process, 3, started, (1,)))
    assert [part for part, _ in shared] == PARTS


def test_others_take_part_from_the_end(tmp_path):
    """While the first part takes its time, a worker has done the last ones."""
    here, there = functools.partial(patient, tmp_path), functools.partial(noted, tmp_path)
    results = list(shared_work(PARTS, here, there, 2, started, (1,)))
    assert [part for part, _ in results] == PARTS
    assert results[0][1] == os.getpid() and results[-1][1] != os.getpid()


def test_this_process_does_what_workers_fail_to_do():
    """A worker that cannot start, and one that dies at its work, cost nothing but time."""
    for there, start, arguments in ((number_and_process, failed, ()), (dies, started, (1,))):
        results = list(shared_work(PARTS, number_and_process, there, 2, start, arguments))
        assert results == [(part, os.getpid()) for part in PARTS]


def test_little_work_is_not_shared(monkeypatch):
    """One process per core, as long as each has twice as much to do as its start takes."""
    monkeypatch.setattr("joblib.cpu_count", lambda: 4)
    assert [worthwhile_processes(parts, 10) for parts in (1, 39, 40, 200)] == [1, 1, 2, 4]

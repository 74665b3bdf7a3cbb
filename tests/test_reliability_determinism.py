"""One seed, one result, bit for bit: in another process, with other hashes and other numbers of threads."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
# Data, a trained checkpoint, a trial with its recordings: their digests.
PROGRAM = """
import json, os, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from faults import kills
found = {{}}
for name in ("data generation", "training", "recording"):
    folder = Path(name)
    folder.mkdir()
    os.chdir(folder)
    kills.WORKS[name].main(0)
    os.chdir("..")
    found |= kills.WORKS[name].results(folder)
print(json.dumps(found))
"""


@pytest.mark.slow
def test_another_process_gives_the_same_bits(tmp_path):
    """Samples, synthetic play, weights trained on the CPU, trials, and both kinds of recordings."""
    found = []
    for number, threads in enumerate(("1", "2")):
        folder = tmp_path / str(number)
        folder.mkdir()
        environment = {
            **os.environ,
            "PYTHONHASHSEED": str(7 * number + 1),
            "OMP_NUM_THREADS": threads,
            "XDG_CACHE_HOME": str(folder / "cache"),
        }
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM.format(tests=str(TESTS))],
            cwd=folder, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout.splitlines()[-1]))
    assert found[0] == found[1]
    assert {Path(name).suffix for name in found[0]} == {".npz", "", ".rrd"}
    assert len(found[0]) == 7

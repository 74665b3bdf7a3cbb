"""One seed, one result, bit for bit: in another process, with other hashes and numbers of threads."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from faults import kills

TESTS = Path(__file__).resolve().parent
PROGRAM = f"""
import sys
sys.path.insert(0, {str(TESTS)!r})
from test_reliability_determinism import digests
import json
print(json.dumps(digests()))
"""


def digests() -> dict[str, str]:
    """Digests of data, of a trained checkpoint, and of trials with their recordings, all made here."""
    found = {}
    for name in ("data generation", "training", "recording"):
        folder = Path(name).resolve()
        folder.mkdir()
        os.chdir(folder)
        kills.WORKS[name].main(0)
        os.chdir("..")
        found |= kills.WORKS[name].results(folder)
    return found


@pytest.mark.slow
def test_another_process_gives_the_same_bits(tmp_path, monkeypatch):
    """Samples, synthetic play, weights trained on the CPU, trials, and both kinds of recordings."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "here" / "cache"))
    here = digests()
    environment = {
        **os.environ,
        "PYTHONHASHSEED": "8",
        "OMP_NUM_THREADS": "2",
        "XDG_CACHE_HOME": str(tmp_path / "there" / "cache"),
    }
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=tmp_path / "there", env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == here
    assert {Path(name).suffix for name in here} == {".npz", "", ".rrd"}
    assert len(here) == 7

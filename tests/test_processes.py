"""Workers do not outlive who started them."""

import os
import signal
import subprocess
import sys

import pytest

WORKER = (
    "import os, time; from geort_drake.processes import end_with; "
    "end_with(os.getppid()); print(os.getpid(), flush=True); time.sleep(600)"
)
STARTER = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {WORKER!r}])"
PATIENCE_S = 60.0


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_worker_ends_when_its_starter_is_killed():
    """Even by a signal that the starter cannot handle."""
    starter = subprocess.Popen([sys.executable, "-c", STARTER], stdout=subprocess.PIPE, text=True)
    worker = int(starter.stdout.readline())
    os.kill(worker, 0)
    starter.send_signal(signal.SIGKILL)
    # The worker holds the other end of the pipe for as long as it lives.
    assert starter.communicate(timeout=PATIENCE_S) == ("", None)

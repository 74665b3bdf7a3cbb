"""The code that a trial runs through, and its digest."""

import functools
from pathlib import Path

from geort_drake.files import digest_of
from geort_drake.sources import PACKAGE, imported_sources

# Modules that a worker loads, and those that make the retargeters of a benchmark.
_ENTRIES = (
    "benchmark/trial.py",
    "people/human_hand.py",
    "hands/canonical.py",
    "retargeting/methods/online.py",
    "retargeting/methods/trivial.py",
    "retargeting/methods/coupled/retargeter.py",
    "retargeting/retargeter.py",
)
# Learned weights have a digest of their own, so training does not count; nor do reports and what is drawn.
_ROOMS = ("people", "hands", "retargeting", "simulation", "systems")


@functools.cache
def code_digest() -> str:
    """SHA-256 of the trials' code, as it was on the disk when this process first asked."""
    return digest_of(PACKAGE, trial_sources())


def trial_sources() -> list[Path]:
    """The modules that a trial can run through: all that is imported, at once or later, from `_ENTRIES`."""
    return [path for path in imported_sources(_ENTRIES) if path.relative_to(PACKAGE).parts[0] in _ROOMS]

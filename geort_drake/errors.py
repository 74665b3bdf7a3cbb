"""Exceptions raised for invalid user input.

A message names file, field and frame, what was expected, what was given, and the valid choices. The commands
print the message alone and exit with code 2.
"""

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager


class GeortError(Exception):
    """Base of every error that the user of the package can correct."""


class UsageError(GeortError):
    """Options of a command contradict each other or have unusable values."""


class RecordingError(GeortError):
    """A recording of a human hand is missing, malformed or unusable."""


class HandError(GeortError):
    """A hand description or its model is missing, malformed or inconsistent."""


class MapError(GeortError):
    """The file of a trained map is missing, damaged or of a map for another hand."""


class ScenarioError(GeortError):
    """A scenario is missing, malformed or impossible."""


class PolicyError(GeortError):
    """A policy that corrects commands is missing, cannot be run, or has the wrong inputs or outputs."""


class MethodError(GeortError):
    """A retargeting method that a user wrote cannot be loaded, or its output is unusable."""


class TrainingError(GeortError):
    """Training cannot start or had to stop."""


class BenchmarkError(GeortError):
    """A benchmark's folder is corrupt, in use, or made with another configuration."""


class LiveError(GeortError):
    """A message cannot be used, or a glove or robot is missing or does not answer."""


class FrameError(GeortError):
    """Keypoints are not in the wrist frame, or of the other hand."""


class MismatchError(LiveError):
    """A glove sends another version, unit or hand; waiting does not help."""


class OutputError(GeortError, OSError):
    """A file or folder cannot be written, or not completely."""


class UnknownNameError(GeortError):
    """A name is unknown; the message lists the valid ones."""

    def __init__(self, kind: str, name: str, choices: Iterable[str]):
        super().__init__(f"unknown {kind} '{name}'; choose one of: {', '.join(sorted(choices)) or 'none'}")


@contextmanager
def naming(what: str | os.PathLike, kind: type[GeortError]) -> Iterator[None]:
    """Puts what it is about before the message of an error of this kind that is raised within."""
    try:
        yield
    except kind as error:
        raise kind(f"{what}: {error}") from error


def listed(names: Sequence[str]) -> str:
    """Joins names by commas; of more than eight, the last ones are counted."""
    more = len(names) - 8
    return ", ".join(names if more <= 0 else [*names[:8], f"and {more} more"])

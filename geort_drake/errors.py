"""What a user can get wrong, as exceptions that say how to put it right.

Every message names the thing (file, field, frame), what was wanted, what was given and, where
there is a list to choose from, the list. The scripts print the message alone and exit with 2.
"""

from collections.abc import Iterable


class GeortError(Exception):
    """Base of every error that the user of the package can correct."""


class RecordingError(GeortError):
    """A recording of a human hand is missing, malformed or unusable."""


class HandError(GeortError):
    """A hand description or its model is missing, malformed or inconsistent."""


class CheckpointError(GeortError):
    """A checkpoint is missing, incomplete, altered or made for something else."""


class ScenarioError(GeortError):
    """A scenario is missing, malformed or asks for something impossible."""


class PolicyError(GeortError):
    """A policy that corrects commands is missing, cannot be run, or has other inputs and outputs."""


class TrainingError(GeortError):
    """Training cannot start or had to stop."""


class BenchmarkError(GeortError):
    """A benchmark's folder is corrupt, in use, or of another configuration."""


class LiveError(GeortError):
    """A message cannot be used, or a glove or robot is missing or does not answer."""


class MismatchError(LiveError):
    """A glove speaks another version or unit, or is of another hand; waiting for it does not help."""


class OutputError(GeortError, OSError):
    """A file or folder cannot be written where it was asked for, or not to its end."""


class UnknownNameError(GeortError):
    """A name stands for nothing; the message lists the names that do."""

    def __init__(self, kind: str, given: str, choices: Iterable[str]):
        listed = ", ".join(sorted(choices)) or "none"
        super().__init__(f"unknown {kind} '{given}'; choose one of: {listed}")

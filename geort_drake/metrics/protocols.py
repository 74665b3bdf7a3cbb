"""Protocols of a comparison: the frames for the training of a method and those for its evaluation."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.metrics.evaluation import MIN_FRAMES
from geort_drake.people.recording import Recording

SAME_PERSON, HELD_OUT, OTHER_PERSON = "same_person", "held_out", "other_person"
# Successive frames are similar, so frames this close to a held-out block are not used for training, s.
GUARD_S = 1.0


@dataclasses.dataclass(frozen=True)
class Case:
    """A training recording and the recording for the evaluation."""

    part: str  # name of the file or block
    trained_on: Recording
    scored_on: Recording


@dataclasses.dataclass(frozen=True)
class Protocol:
    """A way to compare methods.

    Attributes:
        name: SAME_PERSON, HELD_OUT or OTHER_PERSON.
        title: title in tables.
        meaning: meaning of its metrics, and which are left out.
        cases: one case per part.
        with_coverage: whether coverage of the robot's C-space is meaningful.
    """

    name: str
    title: str
    meaning: str
    cases: tuple[Case, ...]
    with_coverage: bool = True


def same_person(recording: Recording, name: str) -> Protocol:
    """Makes the protocol that trains and evaluates on the same recording, as in the paper."""
    return Protocol(
        SAME_PERSON,
        "same person, training recording",
        "trained and scored on the same recording, as in the paper",
        (Case(name, recording, recording),),
    )


def held_out(recording: Recording, blocks: int) -> Protocol:
    """Makes the protocol that evaluates on each of `blocks` contiguous parts and trains on the others.

    The parts divide the valid frames. Frames of the block, and those up to GUARD_S before or after it, are
    invalid in the training recording.

    Raises:
        RecordingError: there are fewer than two blocks, or blocks are too short for the metrics.
    """
    frames = np.flatnonzero(recording.valid)
    most = len(frames) // MIN_FRAMES
    if not 2 <= blocks <= most:
        raise RecordingError(
            f"held-out blocks must be 2 to {most} for {len(frames)} valid frames (at least {MIN_FRAMES} "
            f"each), not {blocks}"
        )
    cases = []
    for number, block in enumerate(np.array_split(frames, blocks), start=1):
        inside = np.zeros(len(recording), dtype=bool)
        inside[block] = True
        first, last = recording.t[block[[0, -1]]]
        away = (recording.t < first - GUARD_S) | (recording.t > last + GUARD_S)
        cases.append(
            Case(
                f"block {number} of {blocks}",
                dataclasses.replace(recording, valid=recording.valid & away),
                dataclasses.replace(recording, valid=inside),
            )
        )
    return Protocol(
        HELD_OUT,
        "same person, held-out blocks",
        f"scored on each of {blocks} contiguous blocks, trained on the rest, {GUARD_S:g} s before and after "
        "the block left out; no coverage, as a block contains too little motion to cover the C-space",
        tuple(cases),
        with_coverage=False,
    )


def other_person(recording: Recording, others: Mapping[str, Recording]) -> Protocol:
    """Makes the protocol that trains on one recording and evaluates on others, name → recording.

    Raises:
        RecordingError: one of the others is the training recording.
    """
    for name, other in others.items():
        if other.digest == recording.digest:
            raise RecordingError(f"{name}: this is the training recording; give another one")
    return Protocol(
        OTHER_PERSON,
        "another person",
        "trained on one person's recording, scored on another's; only a universal map adapts, to the "
        "first second",
        tuple(Case(name, recording, other) for name, other in others.items()),
    )

"""What is learned from and scored on: no frame on both sides, none forgotten."""

import dataclasses

import numpy as np
import pytest

from geort_drake.comparison.protocols import GUARD_S, held_out, other_person
from geort_drake.errors import RecordingError
from geort_drake.people.play import synthesize_play


@pytest.fixture(scope="module")
def play():
    """Twenty seconds at 30 Hz in which tracking was lost twice."""
    recording = synthesize_play(0, duration_s=20.0, rate_hz=30.0)
    valid = np.ones(len(recording), dtype=bool)
    valid[100:140] = valid[400:403] = False
    return dataclasses.replace(recording, valid=valid)


def test_held_out_blocks_share_out_the_valid_frames(play):
    """Every valid frame is scored once, in a block without gaps other than lost tracking."""
    cases = held_out(play, 4).cases
    assert len(cases) == 4
    scored = np.array([case.scored_on.valid for case in cases])
    np.testing.assert_array_equal(scored.sum(axis=0), play.valid.astype(int))
    assert np.ptp(scored.sum(axis=1)) <= 1
    for block in scored:
        first, last = np.flatnonzero(block)[[0, -1]]
        np.testing.assert_array_equal(block[first : last + 1], play.valid[first : last + 1])


def test_nothing_near_a_held_out_block_is_learned_from(play):
    """What is learned from is all that is valid and at least the guard away in time, on both sides."""
    for case in held_out(play, 4).cases:
        assert not (case.trained_on.valid & case.scored_on.valid).any()
        first, last = play.t[case.scored_on.valid][[0, -1]]
        learned = play.t[case.trained_on.valid]
        away = np.maximum(first - learned, learned - last)
        assert away.min() == pytest.approx(GUARD_S, abs=0.04)
        assert away.min() > GUARD_S
        outside = play.valid & ((play.t < first - GUARD_S) | (play.t > last + GUARD_S))
        assert case.trained_on.valid.sum() == outside.sum()


@pytest.mark.parametrize("blocks", [1, 56])
def test_too_few_or_too_many_blocks_are_refused(play, blocks):
    """557 valid frames make at most 55 blocks that can be measured on."""
    with pytest.raises(RecordingError, match=f"2 to 55 for 557 valid frames .* not {blocks}"):
        held_out(play, blocks)


def test_other_people_are_learned_from_nowhere(play):
    """Trained on the one, scored on each of the others; the same recording again is no other person."""
    other = synthesize_play(1, duration_s=5.0, rate_hz=30.0)
    (case,) = other_person(play, {"other.npz": other}).cases
    assert (case.part, case.trained_on, case.scored_on) == ("other.npz", play, other)
    with pytest.raises(RecordingError, match=r"again.npz: is the recording that methods are trained on"):
        other_person(play, {"other.npz": other, "again.npz": dataclasses.replace(play)})

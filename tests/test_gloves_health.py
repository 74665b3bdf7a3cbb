"""Files that are wrong in exactly one way, in every format: each is refused or repaired, and the fault named.

`WRONG` counts them. The sound files that they are made from have no finding (`test_gloves_formats`).
"""

import re

import numpy as np
import pytest
from file_faults import FILES
from glove_files import WRITERS
from hand_faults import ADVICE, ERROR, FAULTS, UNFIT, WARNING, hand_faults, one_spike, stored_twice
from moving_hands import FRAMES, RATE_HZ, moving

from geort_drake.errors import RecordingError
from geort_drake.people.checks import examine, verdict
from geort_drake.people.checks.order import EXCHANGES, ORDERS, fitting_order, is_right
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import mirrored
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import open_recording
from geort_drake.people.recording import Recording

WRONG = len(hand_faults()) + len(FILES)


def judged(path) -> tuple[list, Recording | None]:
    """What is found in a file beside the absence of times, and the recording; or why it cannot be read."""
    try:
        recording, findings = open_recording(path)
    except RecordingError as error:
        return [str(error)], None
    recording, found = examine(recording)
    return [finding for finding in [*findings, *found] if finding.check != "timestamps"], recording


@pytest.mark.parametrize(("written", "fault"), hand_faults(), ids=lambda x: getattr(x, "__name__", x))
def test_a_hand_with_one_fault_is_caught_in_every_format(tmp_path, written, fault):
    """There is one finding, of the right check and severity, and it names the fault."""
    findings, _ = judged(WRITERS[written](tmp_path, fault(moving())))
    severity, check, message = FAULTS[fault]
    assert len(findings) == 1, [str(finding) for finding in findings]
    assert (findings[0].check, findings[0].severity) == (check, severity)
    assert re.search(message, str(findings[0])), str(findings[0])
    assert verdict(findings) == {
        ERROR: "refused", UNFIT: "usable with warnings", WARNING: "usable with warnings", ADVICE: "usable"
    }[severity]  # fmt: skip


@pytest.mark.parametrize("fault", FILES)
def test_a_file_with_one_fault_is_caught(tmp_path, fault):
    """It is refused with a message that names file and fault, or repaired with one finding that does."""
    write, message = FILES[fault]
    path = write(tmp_path, moving())
    findings, _ = judged(path)
    assert len(findings) == 1, [str(finding) for finding in findings]
    assert re.search(message, str(findings[0])), str(findings[0])
    assert not isinstance(findings[0], str) or findings[0].startswith(str(path))


def test_the_corpus_is_large_enough():
    """At least 60 wrong files, and every format among them."""
    assert WRONG >= 60
    assert {written for written, _ in hand_faults()} == set(WRITERS)


def test_what_is_repaired_is_as_it_was(tmp_path):
    """A spike is marked invalid alone, and frames that were stored twice are left out."""
    _, recording = judged(WRITERS["manus"](tmp_path, one_spike(moving())))
    assert np.flatnonzero(~recording.valid).tolist() == [150]
    _, recording = judged(WRITERS["manus"](tmp_path, stored_twice(moving())))
    np.testing.assert_allclose(recording.t, moving().t, atol=1e-6)
    np.testing.assert_allclose(recording.p_HK, moving().p_HK, atol=1e-6)


@pytest.fixture(scope="module")
def real_hands(alex_npy, manus_npz):
    """Keypoints (T, 21, 3) of two people's recordings."""
    return [open_recording(path)[0].p_HK.astype(float) for path in (alex_npy, manus_npz)]


@pytest.mark.parametrize("order", [*ORDERS, *EXCHANGES])
def test_the_order_of_real_hands_is_told(real_hands, order):
    """Gloves' bones keep their lengths, so each order is told, and which fingers or joints are exchanged."""
    for p_HK in real_hands:
        assert fitting_order(p_HK[:, list((ORDERS | EXCHANGES)[order])]) == order


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("length_m", "breadth_m"), [(0.15, 0.07), (0.19, 0.085), (0.21, 0.1)])
def test_the_order_of_sound_hands_is_right(length_m, breadth_m, side):
    """Of several people, either side, straight, in motion, in a fist, and as a camera sees them."""
    hand = HumanHand.anatomical(length_m, breadth_m)
    p_HK = synthesize_play(1, duration_s=10.0, rate_hz=30.0, hand=hand).p_HK.astype(float)
    fist = np.where([name.endswith("flexion") for name in hand.joint_names], hand.upper, 0.0)
    for p in (p_HK, p_HK[:5], hand.keypoints(np.zeros((5, 20))), hand.keypoints(fist[None].repeat(5, 0))):
        seen = mirrored(p) if side == "left" else p
        assert is_right(fitting_order(seen))
        noise = np.random.default_rng(0).normal(0.0, 0.003, seen.shape)
        assert is_right(fitting_order(seen + noise))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_keypoints_is_told_from_distances(order, seed):
    """Every known order is recognised, in any unit, frame and noise of a camera, mirrored or not."""
    rng = np.random.default_rng(seed)
    p = moving().p_HK[:, list(ORDERS[order])] * [1, -1, 1] * rng.uniform(0.01, 1000)
    noise = 0.003 / np.abs(moving().p_HK).max() * np.abs(p).max()
    found = fitting_order(p + rng.normal(0.0, noise, p.shape))
    assert found == order
    assert is_right(found) == (order == next(iter(ORDERS)))


def test_no_order_fits_what_is_no_hand(rng):
    """Points at random are no hand in any order."""
    assert fitting_order(rng.normal(size=(50, 21, 3))) is None


def test_rate_is_that_of_the_hand():
    """The motion that all files are made from has the rate the messages above were written for."""
    assert RATE_HZ == 60.0
    assert len(moving().t) == FRAMES

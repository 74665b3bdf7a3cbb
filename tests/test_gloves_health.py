"""Files that are wrong in exactly one way, in every format: each is refused or repaired, and the fault named.

`WRONG` counts them. The sound files that they are made from have no finding (`test_gloves_formats`).
"""

import functools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from glove_files import (
    FRAMES,
    FROM_WRIST_25,
    RATE_HZ,
    WRITERS,
    Hand,
    manus_table,
    mediapipe_frames,
    moving,
    openxr_frames,
    poses,
    stacked,
    transforms,
    vision_pro_arrays,
    webxr_frames,
    write_dex_retargeting,
    write_ho3d,
    write_mano,
    write_manus,
    write_manus_csv,
    write_mediapipe,
    write_openxr,
    write_openxr_json,
    write_own,
    write_vision_pro,
    write_vision_pro_pkl,
    write_webxr,
    write_webxr_json,
)

from geort_drake.errors import RecordingError
from geort_drake.gloves.health import examine, verdict
from geort_drake.gloves.health.findings import Severity
from geort_drake.gloves.health.order import ORDERS, fitting_order, is_right
from geort_drake.gloves.readers import open_recording
from geort_drake.gloves.recording import Recording

ERROR, UNFIT, WARNING, ADVICE = Severity.ERROR, Severity.UNFIT, Severity.WARNING, Severity.ADVICE
FINGERS = {"thumb": 1, "index": 5, "middle": 9, "ring": 13, "little": 17}


def keypoints_changed(change):
    """A fault that is put into p_HK (T, 21, 3)."""

    @functools.wraps(change)
    def fault(hand: Hand) -> Hand:
        p = hand.p_HK.copy()
        return replace(hand, p_HK=change(p))

    return fault


def kept(hand: Hand, frames) -> Hand:
    """Only those frames, with the times they had."""
    return Hand(hand.p_HK[frames], hand.t[frames], hand.R_WH[frames], hand.p_WH[frames], hand.side)


def millimetres(hand):
    return replace(hand, p_HK=1e3 * hand.p_HK, p_WH=1e3 * hand.p_WH)


@keypoints_changed
def mirrored_axes(p):
    return p * [-1, 1, 1]


@keypoints_changed
def little_finger_first(p):
    return p[:, [0, *(k + j for k in (17, 13, 9, 5, 1) for j in range(4))]]


@keypoints_changed
def thumb_last(p):
    return p[:, [0, *range(5, 21), 1, 2, 3, 4]]


@keypoints_changed
def breathing_bones(p):
    return p * (1 + 0.5 * np.sin(0.05 * np.arange(len(p))))[:, None, None]


@keypoints_changed
def noisy_bones(p):
    return p * (1 + 0.08 * np.sin(0.05 * np.arange(len(p))))[:, None, None]


@keypoints_changed
def dead_ring_finger(p):
    p[:, 13:17] = p[0, 13:17]
    return p


@keypoints_changed
def doubled_keypoint(p):
    p[:, 7] = p[:, 8]
    return p


@keypoints_changed
def one_spike(p):
    p[150, 8] += [0.03, 0.05, -0.02]
    return p


@keypoints_changed
def flat(p):
    return p * [0, 1, 1]


@keypoints_changed
def many_lost(p):
    p[40:110] = np.nan
    return p


@keypoints_changed
def few_lost(p):
    p[[40, 90], 3] = np.nan
    return p


@keypoints_changed
def stalled_start(p):
    return np.concatenate([p[:1].repeat(35, axis=0), p[:-35]])


@keypoints_changed
def stalled_most(p):
    p[80:] = p[80]
    return p


@keypoints_changed
def polled_too_fast(p):
    p[5::10] = p[4:-1:10]
    return p


def stored_twice(hand):
    return kept(hand, np.sort(np.append(np.arange(FRAMES), [30, 200])))


def one_in_eight_dropped(hand):
    return kept(hand, np.arange(FRAMES)[np.arange(FRAMES) % 8 != 3])


def long_gap(hand):
    return replace(hand, t=hand.t + 2.0 * (np.arange(FRAMES) > 100))


def clock_runs_back(hand):
    return replace(hand, t=np.where(np.arange(FRAMES) == 100, hand.t[97], hand.t))


def clock_in_milliseconds(hand):
    return replace(hand, t=1e3 * hand.t)


def two_joined(hand):
    joined = kept(hand, np.delete(np.arange(FRAMES), np.arange(200, 225)))
    return replace(joined, t=hand.t[:-25])


def tracker_jumps(hand):
    return replace(hand, p_WH=hand.p_WH + 1.5 * (np.arange(FRAMES) > 100)[:, None])


def too_short(hand):
    return kept(hand, np.arange(60, FRAMES - 50))


def one_frame(hand):
    return kept(hand, np.arange(1))


def no_pinch(hand):
    return moving(pinch=False)


def stiff_dip(hand):
    return moving(held=(("ring_dip_flexion", 25.0),))


def no_spreading(hand):
    return moving(held=(("middle_mcp_abduction", 2.0),))


# Faults of the hand itself: severity, check, and what the message must say.
FAULTS = {
    millimetres: (
        ERROR,
        "unit",
        r"60 to 110 mm, but is 8\d\.\d+ m; .* millimetres .*--unit mm",
    ),
    mirrored_axes: (ERROR, "handedness", r"bend backwards .* left hand or a right one in mirrored axes"),
    little_finger_first: (ERROR, "joint order", r"wrong joint order: .*: wrist, then little finger to thumb"),
    breathing_bones: (ERROR, "bone lengths", r"bone \d+–\d+ changes its length by 3\d %"),
    dead_ring_finger: (
        ERROR,
        "constant signal",
        r"tip of ring moves by less than 1 mm in (6\.[67]|13\.3) s",
    ),
    thumb_last: (
        ERROR,
        "joint order",
        r"wrong joint order: .*: wrist, index to little finger, then the",
    ),
    doubled_keypoint: (ERROR, "bone lengths", r"keypoints 7 and 8 coincide"),
    flat: (ERROR, "constant signal", r"in one plane .* 2-D landmarks"),
    many_lost: (ERROR, "lost frames", r"70 of 400 frames are not finite .* frame 40; at most one in ten"),
    stalled_most: (ERROR, "constant signal", r"frames repeat for (5\.3|10\.6) s from frame 80"),
    clock_runs_back: (ERROR, "clock", r"t must increase, but frame 100 has"),
    clock_in_milliseconds: (ERROR, "clock", r"t must be in seconds, .* gives 0\.06; .* milliseconds"),
    one_frame: (ERROR, "length", r"at least 2 frames are needed, 1 given"),
    noisy_bones: (WARNING, "bone lengths", r"changes its length by [56] %"),
    one_spike: (
        WARNING,
        "jumps",
        r"in 1 single frames a keypoint jumps .* keypoint 8 \(index\) in frame 150",
    ),
    few_lost: (WARNING, "lost frames", r"2 of 400 frames are not finite numbers, the first is frame 40"),
    stalled_start: (WARNING, "constant signal", r"frames repeat for (0\.6|1\.2) s from frame 0"),
    polled_too_fast: (WARNING, "duplicated frames", r"40 of 400 frames repeat .* the first is frame 5"),
    stored_twice: (WARNING, "duplicated frames", r"2 of 402 frames are stored twice .* frame 31 .* left out"),
    one_in_eight_dropped: (WARNING, "dropped frames", r"50 frames are missing in 400 \(13 %\)"),
    long_gap: (WARNING, "dropped frames", r"1 gaps in time, the longest 2\.02 s before frame 101"),
    two_joined: (WARNING, "jumps", r"1 jumps between frames .* before frame 200"),
    tracker_jumps: (WARNING, "jumps", r"the wrist jumps 1 times, the first before frame 101, at 1\d\d m/s"),
    too_short: (UNFIT, "length", r"290 valid frames, training needs at least 300"),
    no_pinch: (UNFIT, "pinches", r"no pinch: .* nearest: index \(\d+ mm\)"),
    stiff_dip: (WARNING, "constant signal", r"the ring does not bend at keypoint 15"),
    no_spreading: (ADVICE, "narrow motion", r"middle moves sideways by only \d°.*spread the fingers"),
}
EVERYWHERE = (millimetres, mirrored_axes, little_finger_first, breathing_bones, dead_ring_finger)
PLAIN = (
    "own",
    "geort",
    "manus",
    "manus_csv",
    "mediapipe",
    "openxr",
    "webxr",
    "vision_pro",
    "mano",
    "dex_retargeting",
)
ELSEWHERE = {
    thumb_last: ("vision_pro", "webxr_json"),
    doubled_keypoint: ("geort", "manus"),
    flat: ("mediapipe", "dex_retargeting"),
    many_lost: ("manus", "openxr"),
    stalled_most: ("manus", "geort"),
    clock_runs_back: ("manus", "own", "mano"),
    clock_in_milliseconds: ("openxr", "vision_pro"),
    one_frame: ("manus_csv",),
    noisy_bones: ("mediapipe", "mano_npy"),
    one_spike: ("manus", "ho3d"),
    few_lost: ("manus_csv", "dex_retargeting"),
    stalled_start: ("webxr", "mediapipe_npy"),
    polled_too_fast: ("geort", "mano"),
    stored_twice: ("manus", "vision_pro_pkl"),
    one_in_eight_dropped: ("openxr", "own"),
    long_gap: ("mediapipe", "webxr"),
    two_joined: ("geort", "manus"),
    tracker_jumps: ("openxr_json", "vision_pro"),
    too_short: ("mano",),
    no_pinch: ("geort", "dex_retargeting"),
    stiff_dip: ("manus",),
    no_spreading: ("own",),
}


def hand_faults():
    """(writer, fault) of all files whose hand is at fault."""
    pairs = [(written, fault) for fault in EVERYWHERE for written in PLAIN]
    return pairs + [(written, fault) for fault, formats in ELSEWHERE.items() for written in formats]


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


def without(table, column):
    place = table[0].index(column)
    return [[cell for i, cell in enumerate(row) if i != place] for row in table]


def with_cell(table, row, column, value):
    table[row][table[0].index(column)] = value
    return table


def ergonomics():
    names = ["Thumb_CMC_Spread", "Thumb_CMC_Flex", "Index_MCP_Spread", "Index_MCP_Flex"]
    return [["Frame", "Elapsed_Time_In_Milliseconds", "Time", *names], [0, 0, "0", 1, 2, 3, 4]]


def edited(frames, i, **changes):
    frames[i] = {**frames[i], **changes}
    return frames


def in_frame(contents, i, **changes):
    edited(contents["frames"], i, **changes)
    return contents


def manus_data(hand, order):
    return poses(stacked(hand.joints(), order), [1.0, 0, 0, 0])


def mirrored_wrist(hand):
    X = vision_pro_arrays(hand)["right_wrist"]
    return X * np.array([-1.0, 1, 1, 1])[:, None]


def world_fingers(hand):
    arrays = vision_pro_arrays(hand)
    return arrays["right_wrist"] @ arrays["right_fingers"]


def ho3d(hand, i, value):
    joints = np.zeros((21, 3), np.float32)
    annotations = [{"handJoints3D": joints} for _ in range(3)]
    annotations[i] = value
    return annotations


def dex(hand, i, value):
    frames = list(hand.p_HK)
    frames[i] = value
    return frames


# Faults of the file: how it is written, and what the message must say beside the file's name.
FILES = {
    "own lacks t": (lambda f, h: write_own(f, h, t=None), "not a recording, it lacks t"),
    "own of another convention": (
        lambda f, h: write_own(f, h, metadata=np.array(json.dumps({"side": "right", "convention": 9}))),
        "convention 9 is not the one read here, 1",
    ),
    "own with 25 keypoints": (
        lambda f, h: write_own(f, h, p_HK=np.zeros((FRAMES, 25, 3))),
        r"p_HK must have shape",
    ),
    "own in world axes": (
        lambda f, h: write_own(f, h, p_HK=h.p_HK[..., [1, 2, 0]]),
        r"must be given in the wrist frame H .* the middle knuckle is towards \+y",
    ),
    "own of a left hand": (
        lambda f, h: write_own(f, h, metadata=np.array(json.dumps({"side": "left", "convention": 1}))),
        "holds a left hand, a right one was asked for",
    ),
    "manus with 24 nodes": (
        lambda f, h: write_manus(f, h, data=np.zeros((9, 24, 7))),
        r"\(T, 25, 7\), not .* \(9, 24",
    ),
    "manus with the quaternion first": (
        lambda f, h: write_manus(f, h, data=np.roll(manus_data(h, FROM_WRIST_25), 4, axis=2)),
        "the quaternion stands first",
    ),
    "manus with fewer times": (
        lambda f, h: write_manus(f, h, timestamps=h.t[:-1]),
        "399 timestamps for 400 frames",
    ),
    "manus with a node twice": (
        lambda f, h: write_manus(f, h, keypoint_ids=np.r_[0, np.arange(24)]),
        "keypoint_ids must be the numbers 0 to 24",
    ),
    "manus of a left hand": (lambda f, h: write_manus(f, h, chirality=np.array("LEFT")), "holds a left hand"),
    "manus of neither hand": (
        lambda f, h: write_manus(f, h, chirality=np.array("?")),
        r"chirality '\?' is none of",
    ),
    "manus with the palm last": (
        lambda f, h: write_manus(f, h, data=manus_data(h, [*FROM_WRIST_25[:24], "palm"])),
        "wrong joint order: .* they are no hand in any known order",
    ),
    "csv without a column": (
        lambda f, h: write_manus_csv(f, h, without(manus_table(h), "Ring_DIP_Y")),
        "lacks 1 of .* such as Ring_DIP_Y",
    ),
    "csv with a word": (
        lambda f, h: write_manus_csv(f, h, with_cell(manus_table(h), 12, "Hand_X", "n/a")),
        "line 13, column Hand_X must be a number, not 'n/a'",
    ),
    "csv with a short row": (
        lambda f, h: write_manus_csv(f, h, manus_table(h)[:20] + [[1, 2, 3]]),
        "line 21 has 3 cells",
    ),
    "csv of joint angles": (
        lambda f, h: write_manus_csv(f, h, ergonomics()),
        "these are ergonomics, that is joint angles",
    ),
    "csv with a frame missing": (
        lambda f, h: write_manus_csv(f, h, [row for i, row in enumerate(manus_table(h)) if i != 50]),
        "1 frames are missing, the first after frame 48",
    ),
    "csv without rows": (
        lambda f, h: write_manus_csv(f, h, manus_table(h)[:1]),
        "at least 2 frames are needed, 0",
    ),
    "csv that is empty": (lambda f, h: write_manus_csv(f, h, []), "the table is empty"),
    "mediapipe in the picture": (
        lambda f, h: write_mediapipe(f, h, [{"landmarks": m["worldLandmarks"]} for m in mediapipe_frames(h)]),
        "landmarks of the picture .* world landmarks",
    ),
    "mediapipe with 20 landmarks": (
        lambda f, h: write_mediapipe(
            f, h, edited(mediapipe_frames(h), 4, worldLandmarks=[[[0.0, 0.0, 0.0]] * 20])
        ),
        "frame 4: 21 landmarks are wanted, 20 given",
    ),
    "mediapipe with a word": (
        lambda f, h: write_mediapipe(
            f, h, edited(mediapipe_frames(h), 4, worldLandmarks=[[["a", 1, 2]] * 21])
        ),
        "frame 4, landmark 0 must be a point of three numbers",
    ),
    "mediapipe of the other hand": (
        lambda f, h: write_mediapipe(f, h, [{**m, "handedness": [["Left"]]} for m in mediapipe_frames(h)]),
        "holds a left hand, a right one was asked for",
    ),
    "mediapipe of unnamed hands": (
        lambda f, h: write_mediapipe(
            f, h, [{"worldLandmarks": 2 * m["worldLandmarks"]} for m in mediapipe_frames(h)]
        ),
        "frame 0 shows 2 hands and does not say which is which",
    ),
    "mediapipe without a time": (
        lambda f, h: write_mediapipe(f, h, edited(mediapipe_frames(h), 9, timestampMs=None)),
        "frame 9: timestampMs must be a number, not None",
    ),
    "mediapipe cut off": (lambda f, h: cut(write_mediapipe(f, h)), "not JSON"),
    "openxr with the palm second": (
        lambda f, h: write_openxr(f, h, joints=stacked(h.joints(), ["wrist", "palm", *FROM_WRIST_25[1:]])),
        "joint 0 must be the palm and joint 1 the wrist",
    ),
    "openxr with another quaternion": (
        lambda f, h: write_openxr(f, h, joints=poses(np.zeros((5, 26, 3)), [0, 0, 0, 3.0])),
        "have norm 3",
    ),
    "openxr without a joint": (
        lambda f, h: write_openxr_json(f, h, in_frame(openxr_frames(h), 3, joints=[None] * 25)),
        "frame 3: 26 joints are wanted, 25 given",
    ),
    "openxr of a left hand": (lambda f, h: write_openxr(f, h, hand=np.array("left")), "holds a left hand"),
    "webxr without a joint": (
        lambda f, h: write_webxr_json(f, h, in_frame(webxr_frames(h), 3, joints={"wrist": None})),
        "frame 3 lacks 24 of 25 joints, such as thumb-metacarpal",
    ),
    "webxr row by row": (
        lambda f, h: write_webxr(
            f, h, joints=transforms(stacked(h.joints(), FROM_WRIST_25), h.R_WH[:, None]).reshape(-1, 400)
        ),
        "transforms are transposed: their numbers were to stand in columns",
    ),
    "webxr without ones": (
        lambda f, h: write_webxr(f, h, joints=0.5 * np.load(write_webxr(f, h))["joints"]),
        r"rigid transforms, whose last row is 0 0 0 1",
    ),
    "vision pro transposed": (
        lambda f, h: write_vision_pro(
            f, h, right_fingers=vision_pro_arrays(h)["right_fingers"].swapaxes(2, 3)
        ),
        "transforms are transposed: their numbers were to stand in rows",
    ),
    "vision pro with the joints in the world": (
        lambda f, h: write_vision_pro(f, h, right_fingers=world_fingers(h)),
        "joints in the wrist's frame",
    ),
    "vision pro with a mirrored wrist": (
        lambda f, h: write_vision_pro(f, h, right_wrist=mirrored_wrist(h)),
        "must hold rotations, .* mirrors",
    ),
    "vision pro with fewer wrists": (
        lambda f, h: write_vision_pro(f, h, right_wrist=vision_pro_arrays(h)["right_wrist"][:-2]),
        "398 right_wrist for 400 frames",
    ),
    "vision pro of the other hand": (
        lambda f, h: write_vision_pro(f, replace(h, side="left")),
        "a right hand must be called right_fingers",
    ),
    "vision pro lacks a field": (
        lambda f, h: write_vision_pro_pkl(f, h, [{"right_fingers": np.eye(4)}, {}]),
        "frame 1 lacks right_fingers",
    ),
    "ho3d's evaluation": (
        lambda f, h: write_ho3d(f, h, ho3d(h, 1, {"handJoints3D": np.zeros(3)})),
        r"frame 1: .* not \(3,\) \(the wrist alone",
    ),
    "ho3d without joints": (
        lambda f, h: write_ho3d(f, h, ho3d(h, 2, {})),
        "frame 2 must be a dict with handJoints3D",
    ),
    "ho3d's empty folder": (lambda f, h: write_ho3d(f, h, []), "holds no .pkl files"),
    "mano with 16 joints": (
        lambda f, h: write_mano(f, h, handJoints3D=np.zeros((9, 16, 3))),
        r"\(T, 21, 3\), not float64 \(9, 16, 3\)",
    ),
    "dex-retargeting in pictures": (
        lambda f, h: write_dex_retargeting(f, h, dex(h, 5, np.zeros((21, 2)))),
        r"frame 5 must have shape \(21, 3\)",
    ),
    "dex-retargeting with code": (
        lambda f, h: write_dex_retargeting(f, h, dex(h, 5, print)),
        "asks for builtins.print, which could run code",
    ),
    "dex-retargeting cut off": (lambda f, h: cut(write_dex_retargeting(f, h)), "not a readable pickle"),
    "archive cut off": (lambda f, h: cut(write_manus(f, h)), "not a readable NumPy file"),
}
WRONG = len(hand_faults()) + len(FILES)


def cut(path):
    """The first half of the file."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


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

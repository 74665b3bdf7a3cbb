"""Faults of a recorded hand, each put alone into one that is sound, and what is to be found of it."""

import functools
from dataclasses import replace

import numpy as np
from moving_hands import FRAMES, Hand, moving

from geort_drake.people.checks.findings import Severity

ERROR, UNFIT, WARNING, ADVICE = Severity.ERROR, Severity.UNFIT, Severity.WARNING, Severity.ADVICE


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
def index_for_middle(p):
    return p[:, [*range(5), *range(9, 13), *range(5, 9), *range(13, 21)]]


@keypoints_changed
def pip_for_dip(p):
    return p[:, [*range(6), 7, 6, *range(8, 21)]]


@keypoints_changed
def tips_before_dips(p):
    return p[:, [0, *(k + j for k in range(1, 21, 4) for j in (0, 1, 3, 2))]]


@keypoints_changed
def index_tip_lost(p):
    p[:, 8] = np.nan
    return p


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
        # Our own files have no unit to choose.
        r"60 to 110 mm, but is 8\d\.\d+ m; .* millimetres .*(--unit mm|give keypoints in metres)",
    ),
    mirrored_axes: (ERROR, "handedness", r"bend backwards .* left hand or a right one in mirrored axes"),
    little_finger_first: (ERROR, "joint order", r"wrong joint order: .*: wrist, then little finger to thumb"),
    index_for_middle: (
        ERROR,
        "joint order",
        r"wrong joint order: .*: the same, but index and middle finger exchanged",
    ),
    pip_for_dip: (ERROR, "joint order", r"the same, but PIP and DIP of the index finger exchanged"),
    tips_before_dips: (ERROR, "joint order", r"the same, but DIP and tip of every finger exchanged"),
    index_tip_lost: (ERROR, "lost frames", r"keypoint 8 \(index\) is lost in all 400 frames"),
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
    clock_in_milliseconds: (
        ERROR,
        "clock",
        r"(t|timestamps) must be in seconds, .* gives 0\.06; .* milliseconds",
    ),
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
    index_for_middle: ("own", "geort", "manus", "mediapipe"),
    pip_for_dip: ("own", "manus_csv", "openxr"),
    tips_before_dips: ("geort", "vision_pro_app", "mediapipe_npy"),
    index_tip_lost: ("geort", "openxr_json"),
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

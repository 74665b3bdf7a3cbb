"""Recordings that are wrong as a whole: what leaves the meaning open is refused, the rest is reported."""

import dataclasses as dc
import json
import re

import numpy as np
import pytest
from glove_files import (
    FROM_WRIST_25,
    WRITERS,
    manus_table,
    mediapipe_frames,
    openxr_frames,
    poses,
    stacked,
    transforms,
    vision_pro_arrays,
    write_dex_retargeting,
    write_ho3d,
    write_manus,
    write_manus_csv,
    write_mediapipe,
    write_openxr,
    write_openxr_json,
    write_own,
    write_vision_pro,
    write_webxr,
)
from moving_hands import FRAMES, Hand, moving

from geort_drake.errors import RecordingError
from geort_drake.people.checks import check_recording, examine, verdict
from geort_drake.people.checks.findings import Severity
from geort_drake.people.checks.order import EXCHANGES, ORDERS, fitting_order, is_right
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import mirrored
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import open_recording, read_recording

ERROR, UNFIT, WARNING, ADVICE = Severity.ERROR, Severity.UNFIT, Severity.WARNING, Severity.ADVICE


def kept(hand: Hand, frames) -> Hand:
    """Only those frames, with the times they had."""
    return Hand(hand.p_HK[frames], hand.t[frames], hand.R_WH[frames], hand.p_WH[frames], hand.side)


def keypoints(hand: Hand, change) -> Hand:
    return dc.replace(hand, p_HK=change(hand.p_HK.copy()))


def put(place, value):
    """A change of p_HK (T, 21, 3)."""

    def change(p):
        p[place] = value(p) if callable(value) else value
        return p

    return change


def order(name):
    return lambda hand: keypoints(hand, lambda p: p[:, list((ORDERS | EXCHANGES)[name])])


AFTER_100 = np.arange(FRAMES) > 100
BREATHING = np.sin(0.05 * np.arange(FRAMES))[:, None, None]
RHD = "wrist, then each finger from tip to base (RHD)"
# Faults of the hand: the hand with the fault, severity, check, and what the message must say.
HANDS = {
    "millimetres": (
        lambda h: dc.replace(h, p_HK=1e3 * h.p_HK, p_WH=1e3 * h.p_WH),
        ERROR, "unit", r"60 to 110 mm, but is 8\d\.\d+ m; .* millimetres .*(--unit mm|give keypoints in m)",
    ),
    "mirrored axes": (
        lambda h: keypoints(h, lambda p: p * [-1, 1, 1]),
        ERROR, "handedness", r"bend backwards .* left hand or a right one in mirrored axes",
    ),
    "another order": (order(RHD), ERROR, "joint order", r"wrong joint order: .*tip to base \(RHD\)"),
    "fingers exchanged": (
        order("the same, but index and middle finger exchanged"),
        ERROR, "joint order", r"wrong joint order: .*: the same, but index and middle finger exchanged",
    ),
    "a fingertip lost": (
        lambda h: keypoints(h, put(np.s_[:, 8], np.nan)),
        ERROR, "lost frames", r"keypoint 8 \(index\) is lost in all 400 frames",
    ),
    "breathing bones": (
        lambda h: keypoints(h, lambda p: p * (1 + 0.5 * BREATHING)),
        ERROR, "bone lengths", r"bone \d+–\d+ changes its length by 3\d %",
    ),
    "noisy bones": (
        lambda h: keypoints(h, lambda p: p * (1 + 0.08 * BREATHING)),
        WARNING, "bone lengths", r"changes its length by [56] %",
    ),
    "a dead finger": (
        lambda h: keypoints(h, put(np.s_[:, 13:17], lambda p: p[0, 13:17])),
        ERROR, "constant signal", r"tip of ring moves by less than 1 mm in (6\.[67]|13\.3) s",
    ),
    "a doubled keypoint": (
        lambda h: keypoints(h, put(np.s_[:, 7], lambda p: p[:, 8])),
        ERROR, "bone lengths", r"keypoints 7 and 8 coincide",
    ),
    "flat": (
        lambda h: keypoints(h, lambda p: p * [0, 1, 1]), ERROR, "constant signal", r"in one plane .* 2-D",
    ),
    "many frames lost": (
        lambda h: keypoints(h, put(np.s_[40:110], np.nan)),
        ERROR, "lost frames", r"70 of 400 frames .* frame 40; at most one in ten may be lost",
    ),
    "stalled": (
        lambda h: keypoints(h, put(np.s_[80:], lambda p: p[80])),
        ERROR, "constant signal", r"frames repeat for (5\.3|10\.6) s from frame 80",
    ),
    "stalled start": (
        lambda h: keypoints(h, lambda p: np.concatenate([p[:1].repeat(35, axis=0), p[:-35]])),
        WARNING, "constant signal", r"frames repeat for (0\.6|1\.2) s from frame 0",
    ),
    "polled too fast": (
        lambda h: keypoints(h, put(np.s_[5::10], lambda p: p[4:-1:10])),
        WARNING, "duplicated frames", r"40 of 400 frames repeat .* the first is frame 5",
    ),
    "clock in milliseconds": (
        lambda h: dc.replace(h, t=1e3 * h.t),
        ERROR, "clock", r"(t|timestamps) must be in seconds, .* gives 0\.06; .* milliseconds",
    ),
    "one frame": (lambda h: kept(h, np.arange(1)), ERROR, "length", r"at least 2 frames are needed, 1 given"),
    "stored twice": (
        lambda h: kept(h, np.sort(np.append(np.arange(FRAMES), [30, 200]))),
        WARNING, "duplicated frames", r"2 of 402 frames are stored twice .* frame 31 .* left out",
    ),
    "frames dropped": (
        lambda h: kept(h, np.arange(FRAMES)[np.arange(FRAMES) % 8 != 3]),
        WARNING, "dropped frames", r"50 frames are missing in 400 \(13 %\)",
    ),
    "a gap": (
        lambda h: dc.replace(h, t=h.t + 2.0 * AFTER_100),
        WARNING, "dropped frames", r"1 gaps in time, the longest 2\.02 s before frame 101",
    ),
    "two joined": (
        lambda h: dc.replace(kept(h, np.delete(np.arange(FRAMES), np.arange(200, 225))), t=h.t[:-25]),
        WARNING, "jumps", r"1 jumps in .* before frame 200",
    ),
    "a tracker that jumps": (
        lambda h: dc.replace(h, p_WH=h.p_WH + 1.5 * AFTER_100[:, None]),
        WARNING, "jumps", r"the wrist jumps 1 times, the first before frame 101, at 1\d\d m/s",
    ),
    "too short": (
        lambda h: kept(h, np.arange(60, FRAMES - 50)),
        UNFIT, "length", r"290 valid frames, training needs at least 300",
    ),
    "no pinch": (lambda h: moving(pinch=False), UNFIT, "pinches", r"no pinch: .* closest: index \(\d+ mm\)"),
    "a stiff joint": (
        lambda h: moving(held=(("ring_dip_flexion", 25.0),)),
        WARNING, "constant signal", r"the ring does not bend at keypoint 15",
    ),
    "no spreading": (
        lambda h: moving(held=(("middle_mcp_abduction", 2.0),)),
        ADVICE, "narrow motion", r"middle moves sideways by only \d°.*spread the fingers",
    ),
}  # fmt: skip
EVERYWHERE = ("own", "geort", "manus_csv", "mediapipe", "openxr_json", "vision_pro", "dex_retargeting")
PLACES = {name: ("manus",) for name in HANDS} | {
    "millimetres": EVERYWHERE, "mirrored axes": EVERYWHERE, "another order": EVERYWHERE,
    "clock in milliseconds": ("openxr", "vision_pro"),
    "a tracker that jumps": ("openxr_json",), "one frame": ("manus_csv",),
}  # fmt: skip


@pytest.mark.parametrize(("fault", "written"), [(name, w) for name in HANDS for w in PLACES[name]])
def test_a_fault_of_the_hand_is_found_in_every_format(tmp_path, fault, written):
    """There is one finding, of the right check and severity, and it names the fault."""
    change, severity, check, message = HANDS[fault]
    recording, findings = open_recording(WRITERS[written](tmp_path, change(moving())))
    findings += examine(recording)[1]
    findings = [finding for finding in findings if finding.check != "timestamps"]
    assert [(finding.check, finding.severity) for finding in findings] == [(check, severity)], findings
    assert re.search(message, str(findings[0])), str(findings[0])
    assert verdict(findings) == {
        ERROR: "refused", UNFIT: "usable with warnings", WARNING: "usable with warnings", ADVICE: "usable"
    }[severity]  # fmt: skip


def metadata(**fields):
    return np.array(json.dumps({"side": "right", "convention": 1, **fields}))


def manus_nodes(hand, order):
    return poses(stacked(hand.joints(), order), [1.0, 0, 0, 0])


def relabelled(hand, **fields):
    return [{**frame, **fields} for frame in mediapipe_frames(hand)]


def pictures(hand):
    return [{"landmarks": m["worldLandmarks"], "handedness": m["handedness"]} for m in mediapipe_frames(hand)]


def commas(table):
    return [[str(cell).replace(".", ",") for cell in row] for row in table]


def in_milliseconds(hand):
    contents = openxr_frames(hand)
    for frame, t in zip(contents["frames"], hand.t.tolist(), strict=True):
        frame["time"] = 1e3 * t
    return contents


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def left(hand):
    return dc.replace(hand, side="left")


ERGONOMICS = [["Frame", "Time", "Thumb_CMC_Spread", "Thumb_CMC_Flex"], [0, "0", 1, 2]]
LABEL_LEFT = [[{"categoryName": "Left"}]]
# Files that leave the meaning open: how each is written, and what the message must say.
REFUSED = {
    "own of another convention": (
        lambda f, h: write_own(f, h, metadata=metadata(convention=9)), "convention 9 is not supported"
    ),
    "own in other axes": (
        lambda f, h: write_own(f, h, p_HK=h.p_HK[..., [1, 2, 0]]),
        r"must be given in the wrist frame H .* the middle knuckle is towards \+y",
    ),
    "own with quaternions of another kind": (
        lambda f, h: write_own(f, h, X_WH=np.full((FRAMES, 7), 2.0)), "X_WH must hold unit quaternions"
    ),
    "own with a clock that starts anew": (
        lambda f, h: write_own(f, h, t=np.where(AFTER_100, h.t - h.t[101], h.t)),
        "of 400 frames have no time, or one that does not increase, .*; at most one in ten may be lost",
    ),
    "own of a left hand": (
        lambda f, h: write_own(f, h, metadata=metadata(side="left")),
        "holds a left hand, a right one was requested",
    ),
    "manus with 24 nodes": (
        lambda f, h: write_manus(f, h, data=np.zeros((9, 24, 7))), r"\(T, 25, 7\), not .* \(9, 24"
    ),
    "manus with the quaternion first": (
        lambda f, h: write_manus(f, h, data=np.roll(manus_nodes(h, FROM_WRIST_25), 4, axis=2)),
        "the quaternion stands first",
    ),
    "manus with fewer times": (
        lambda f, h: write_manus(f, h, timestamps=h.t[:-1]), "399 timestamps for 400 frames"
    ),
    "manus of neither hand": (
        lambda f, h: write_manus(f, h, chirality=np.array("?")), r"chirality '\?' is none of"
    ),
    "manus with the palm last": (
        lambda f, h: write_manus(f, h, data=manus_nodes(h, [*FROM_WRIST_25[:24], "palm"])),
        "wrong joint order: .* they do not form a hand in any known order",
    ),
    "csv without a column": (
        lambda f, h: write_manus_csv(f, h, [row[:40] + row[41:] for row in manus_table(h)]),
        "lacks 1 of the joint positions' 63 columns, such as",
    ),
    "csv in metres": (
        lambda f, h: write_manus_csv(f, h, manus_table(h, "_Position")),
        "but is 0.0008.* m with the file's lengths in cm; .* numbers were metres .*--unit m$",
    ),
    "csv with decimal commas": (
        lambda f, h: write_manus_csv(f, h, commas(manus_table(h)), ";"),
        "column Hand_X must be a number, not '.*,.*'; write decimals with points",
    ),
    "csv of joint angles": (
        lambda f, h: write_manus_csv(f, h, ERGONOMICS), "these are ergonomics, that is joint angles"
    ),
    "csv without rows": (
        lambda f, h: write_manus_csv(f, h, manus_table(h)[:1]), "at least 2 frames are needed, 0"
    ),
    "mediapipe in the picture": (
        lambda f, h: write_mediapipe(f, h, pictures(h)), "frame 0: .*image landmarks .* world landm"
    ),
    "mediapipe of the other hand": (
        lambda f, h: write_mediapipe(f, left(h)), "hand is labelled left, and its fingers do not"
    ),
    "mediapipe of a mirrored picture": (
        lambda f, h: write_mediapipe(f, h, relabelled(left(h), handedness=[["Right"]])),
        "bend backwards .* read it with side 'left', and if the axes are mirrored also with --mirror",
    ),
    "openxr with the palm second": (
        lambda f, h: write_openxr(f, h, joints=stacked(h.joints(), ["wrist", "palm", *FROM_WRIST_25[1:]])),
        "joint 0 must be the palm and joint 1 the wrist",
    ),
    "openxr in milliseconds": (
        lambda f, h: write_openxr_json(f, h, in_milliseconds(h)),
        "time must be in nanoseconds, .* gives 6e.07; .* numbers were milliseconds",
    ),
    "webxr without ones": (
        lambda f, h: write_webxr(f, h, joints=0.5 * np.load(write_webxr(f, h))["joints"]),
        r"rigid transforms, whose last row is 0 0 0 1",
    ),
    "vision pro with the joints in the world": (
        lambda f, h: write_vision_pro(
            f, h, right_fingers=vision_pro_arrays(h)["right_wrist"] @ vision_pro_arrays(h)["right_fingers"]
        ),
        "joints in the wrist's frame",
    ),
    "vision pro with a mirrored wrist": (
        lambda f, h: write_vision_pro(
            f, h, right_wrist=vision_pro_arrays(h)["right_wrist"] * np.array([-1.0, 1, 1, 1])[:, None]
        ),
        "must hold rotations, .* mirrors",
    ),
    "vision pro of the other hand": (
        lambda f, h: write_vision_pro(f, left(h)), "a right hand must be called right_fingers"
    ),
    "ho3d's evaluation": (
        lambda f, h: write_ho3d(f, h, [{"handJoints3D": np.zeros(3)}] * 3), r"frame 0: .* not \(3,\)"
    ),
    "ho3d's empty folder": (lambda f, h: write_ho3d(f, h, []), "holds no .pkl files"),
    "dex-retargeting with code": (
        lambda f, h: write_dex_retargeting(f, h, [*h.p_HK, print]), "names builtins.print, which could run"
    ),
    "dex-retargeting cut off": (lambda f, h: cut(write_dex_retargeting(f, h)), "not a readable pickle"),
    "archive cut off": (lambda f, h: cut(write_manus(f, h)), "not a readable NumPy file"),
    "no file": (lambda f, h: f / "nowhere.npz", "no such file"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_a_file_whose_meaning_is_open_is_refused(tmp_path, fault):
    """The message names the file, what was expected and what was given."""
    write, message = REFUSED[fault]
    path = write(tmp_path, moving())
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(str(path))


def turned(hand):
    return transforms(stacked(hand.joints(), FROM_WRIST_25), hand.R_WH[:, None]).reshape(-1, 400)


REPAIRED = {
    "csv with a frame missing": (
        lambda f, h: write_manus_csv(f, h, [row for i, row in enumerate(manus_table(h)) if i != 50]),
        "1 frames are missing, the first after frame 48",
    ),
    "mediapipe labelled for the mirror": (
        lambda f, h: write_mediapipe(f, h, relabelled(h, handedness=LABEL_LEFT)),
        "labelled left, but the fingers bend as a right hand's: read as right, .* mirrored",
    ),
    "webxr row by row": (
        lambda f, h: write_webxr(f, h, joints=turned(h)),
        "transforms are transposed: expected columns",
    ),
    "own with odd metadata": (
        lambda f, h: write_own(f, h, metadata=metadata(format=["x"])),
        "metadata format must be of type str",
    ),
}


@pytest.mark.parametrize("oddity", REPAIRED)
def test_what_is_odd_but_clear_is_read_with_a_warning(tmp_path, oddity):
    """The keypoints are the same as without the oddity."""
    write, message = REPAIRED[oddity]
    recording = read_recording(write(tmp_path, moving()))
    (warning,) = recording.metadata["warnings"]
    assert re.search(message, warning)
    np.testing.assert_allclose(recording.p_HK[-300:], moving().p_HK[-300:], atol=1e-6)


def test_a_git_lfs_pointer_is_named_with_the_way_out(tmp_path):
    """In place of any recording, also of one of HO-3D's pickles."""
    for suffix in ("csv", "json", "jsonl", "npy", "npz", "pkl"):
        path = tmp_path / f"0000.{suffix}"
        path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
        with pytest.raises(RecordingError, match=rf"0000\.{suffix}: is a Git LFS pointer.*`git lfs pull`"):
            read_recording(path)
    with pytest.raises(RecordingError, match=r"0000\.pkl: is a Git LFS pointer.*`git lfs pull`"):
        read_recording(tmp_path)


def test_checking_a_sound_recording_changes_nothing():
    """Neither its data nor, the second time, its metadata."""
    play = synthesize_play(3, duration_s=12.0, rate_hz=50.0)
    checked = check_recording(play, training=True)
    assert checked.digest == play.digest
    assert check_recording(checked).metadata == checked.metadata


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_the_shortest_recordings_are_examined(tmp_path, frames):
    """No check needs more frames than there are."""
    _, findings = examine(open_recording(write_own(tmp_path, kept(moving(), np.arange(frames))))[0])
    assert f"{frames} valid frames, training needs at least 300" in " ".join(map(str, findings))


def test_training_asks_for_more_than_replay(tmp_path):
    """Short recordings replay with a warning but do not train."""
    path = write_own(tmp_path, kept(moving(), np.arange(250)))
    assert any("250 valid frames" in warning for warning in read_recording(path).metadata["warnings"])
    with pytest.raises(RecordingError, match=r"own\.npz: 250 valid frames, training needs at least 300"):
        read_recording(path, training=True)


@pytest.mark.parametrize("name", [*ORDERS, *list(EXCHANGES)[::4]])
def test_the_order_of_joints_is_named(name, rng):
    """In any frame, unit and side, also with a camera's noise; gloves' bones tell exchanged joints."""
    p = moving().p_HK[:, list((ORDERS | EXCHANGES)[name])] * [1, -1, 1] * rng.uniform(0.01, 1000)
    noise = 0.003 / 0.2 * np.abs(p).max() if name in ORDERS else 0.0
    found = fitting_order(p + rng.normal(0.0, noise, p.shape))
    assert found == name
    assert is_right(found) == (name == next(iter(ORDERS)))


def test_no_order_fits_what_is_no_hand(rng):
    """Points at random are no hand in any order."""
    assert fitting_order(rng.normal(size=(50, 21, 3))) is None


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("length_m", "breadth_m"), [(0.15, 0.07), (0.21, 0.1)])
def test_the_order_of_sound_hands_is_right(length_m, breadth_m, side):
    """Of several people, either side, straight, in motion, in a fist, and as a camera sees them."""
    hand = HumanHand.anatomical(length_m, breadth_m)
    p_HK = synthesize_play(1, duration_s=10.0, rate_hz=30.0, hand=hand).p_HK.astype(float)
    fist = np.where([name.endswith("flexion") for name in hand.joint_names], hand.upper, 0.0)
    for p in (p_HK, p_HK[:5], hand.keypoints(np.zeros((5, 20))), hand.keypoints(fist[None].repeat(5, 0))):
        seen = mirrored(p) if side == "left" else p
        assert is_right(fitting_order(seen))
        assert is_right(fitting_order(seen + np.random.default_rng(0).normal(0.0, 0.003, seen.shape)))


def test_real_recordings_are_sound(alex_npy, manus_npz):
    """Of two people's recordings one is sound; the other has what is known of it, and no error."""
    known = {manus_npz: [], alex_npy: ["timestamps", "duplicated frames", "jumps", "pinches"]}
    for path, checks in known.items():
        recording, findings = open_recording(path)
        findings += examine(recording)[1]
        assert [finding.check for finding in findings] == checks
        assert all(finding.severity is WARNING for finding in findings)

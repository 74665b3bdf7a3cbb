"""Recordings that are wrong as a whole: what leaves the meaning open is refused, the rest is reported."""

import dataclasses as dc
import json
import re
import warnings

import glove_files as gloves
import numpy as np
import pytest
from glove_files import FRAMES, moving

from geort_drake import read_recording, synthesize_play
from geort_drake.errors import RecordingError
from geort_drake.people.checks import examine, verdict
from geort_drake.people.checks.anatomy import EXPECTED, ORDERS, fitting_order
from geort_drake.people.checks.findings import Severity
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import mirrored
from geort_drake.people.readers import open_recording

ERROR, UNFIT, WARNING = Severity.ERROR, Severity.UNFIT, Severity.WARNING


def keypoints(change):
    """The change of a hand that changes its p_HK (T, 21, 3)."""
    return lambda hand: dc.replace(hand, p_HK=change(hand.p_HK.copy()))


def put(place, value):
    def change(p):
        p[place] = value(p) if callable(value) else value
        return p

    return keypoints(change)


def exchanged(a, b):
    return keypoints(lambda p: p[:, [{a: b, b: a}.get(i, i) for i in range(21)]])


AFTER_100 = np.arange(FRAMES) > 100
BREATHING = np.sin(0.05 * np.arange(FRAMES))[:, None, None]
RHD = "wrist, then each finger from tip to base (RHD)"
# The hand with a fault, severity, check, and what the message must say.
HANDS = {
    "millimetres": (
        lambda h: dc.replace(h, p_HK=1e3 * h.p_HK, p_WH=1e3 * h.p_WH),
        ERROR, "unit", r"60 to 110 mm, but is 8\d\.\d+ m; .* in mm.*(--unit mm|give keypoints in m)",
    ),
    "mirrored axes": (
        keypoints(lambda p: p * [-1, 1, 1]), ERROR, "handedness", "bend backwards .* left hand or a right one"
    ),
    "another order": (keypoints(lambda p: p[:, ORDERS[RHD]]), ERROR, "joint order", r"tip to base \(RHD\)"),
    "joints exchanged": (exchanged(7, 8), ERROR, "joint order", "no hand in any known order: keypoint 8"),
    "a fingertip lost": (put(np.s_[:, 8], np.nan), ERROR, "lost frames", "keypoints 8 are lost in all 400"),
    "many frames lost": (
        put(np.s_[40:110], np.nan), ERROR, "lost frames", "70 of 400 frames .* frame 40; at most one in ten"
    ),
    "breathing bones": (
        keypoints(lambda p: p * (1 + 0.5 * BREATHING)), ERROR, "bone lengths", r"changes its length by 3\d%"
    ),
    "noisy bones": (
        keypoints(lambda p: p * (1 + 0.08 * BREATHING)), WARNING, "bone lengths", "its length by [56]%"
    ),
    "a dead finger": (
        put(np.s_[:, 13:17], lambda p: p[0, 13:17]), ERROR, "constant signal", "ring never bends at .* 13, 14"
    ),
    "a stiff joint": (
        lambda h: moving(held=(("ring_dip_flexion", 25.0),)),
        WARNING, "constant signal", "the ring never bends at keypoints 15",
    ),
    "stalled": (put(np.s_[80:], lambda p: p[80]), ERROR, "constant signal", "repeat for .* from frame 80"),
    "polled too fast": (
        put(np.s_[5::10], lambda p: p[4:-1:10]), WARNING, "duplicated frames", "40 of 400 frames .* frame 5"
    ),
    "clock in milliseconds": (
        lambda h: dc.replace(h, t=1e3 * h.t),
        ERROR, "clock", r"2 to 2000 frames in a second, but give 0\.06.* if times were multiplied by 0\.001",
    ),
    "stored twice": (
        lambda h: h.part(np.sort(np.append(np.arange(FRAMES), [30, 200]))),
        WARNING, "duplicated frames", r"2 of 402 frames are stored twice .*t\[31\].* left out",
    ),
    "frames dropped": (
        lambda h: h.part(np.arange(FRAMES)[np.arange(FRAMES) % 8 != 3]),
        WARNING, "dropped frames", "50 frames are missing in 400, with 0 gaps",
    ),
    "two joined": (
        lambda h: dc.replace(h.part(np.delete(np.arange(FRAMES), np.arange(200, 225))), t=h.t[:-25]),
        WARNING, "jumps", r"1 jumps in .*p_HK\[200\]",
    ),
    "a tracker that jumps": (
        lambda h: dc.replace(h, p_WH=h.p_WH + 1.5 * AFTER_100[:, None]),
        WARNING, "jumps", r"the wrist jumps 1 times, the first at 1\d\d m/s .*X_WH\[101\]",
    ),
    "too short": (lambda h: h.part(np.arange(60, FRAMES - 50)), UNFIT, "length", "290 valid frames"),
    "no pinch": (lambda h: moving(pinch=False), UNFIT, "pinches", r"never .* 15 mm of: index \(\d+ mm\)"),
}  # fmt: skip
WITHOUT_WRIST = ("geort", "mediapipe", "dex_retargeting")  # formats in which the hand's axes are found out
CASES = [(fault, "openxr") for fault in HANDS] + [
    (fault, written)
    for fault in ("millimetres", "mirrored axes", "another order")
    for written in WITHOUT_WRIST
]


@pytest.mark.parametrize(("fault", "written"), CASES)
def test_a_fault_of_the_hand_is_found(tmp_path, fault, written):
    """There is one finding, of the right check and severity, and it names the fault."""
    change, severity, check, message = HANDS[fault]
    recording, findings = open_recording(gloves.WRITERS[written](tmp_path, change(moving())))
    findings += examine(recording)[1]
    findings = [finding for finding in findings if finding.check != "timestamps"]
    assert [(finding.check, finding.severity) for finding in findings] == [(check, severity)], findings
    assert re.search(message, str(findings[0])), str(findings[0])
    assert verdict(findings) == ("refused" if severity is ERROR else "usable with warnings")


def metadata(**fields):
    return np.array(json.dumps({"side": "right", "convention": 1, **fields}))


def relabelled(hand, label):
    return [{**frame, "handedness": label} for frame in gloves.mediapipe_frames(hand)]


def pictures(hand):
    return [
        {"landmarks": m["worldLandmarks"], "handedness": m["handedness"]}
        for m in gloves.mediapipe_frames(hand)
    ]


def commas(table):
    return [[str(cell).replace(".", ",") for cell in row] for row in table]


PALM_SECOND = ["wrist", "palm", *gloves.FROM_WRIST_25[1:]]
# Files that leave the meaning open: how each is written, and what the message must say.
REFUSED = {
    "own of another convention": (
        lambda f, h: gloves.write_own(f, h, metadata=metadata(convention=9)), "convention 9 is not supported"
    ),
    "own of points in a plane": (
        lambda f, h: gloves.write_own(f, h, p_HK=h.p_HK * [0, 1, 1]),
        "changes its length by .* 3-D keypoints in m",
    ),
    "own with a clock that starts anew": (
        lambda f, h: gloves.write_own(f, h, t=np.where(AFTER_100, h.t - h.t[101], h.t)),
        "have no time, or one that does not increase, .*; at most one in ten may be lost",
    ),
    "manus with 24 nodes": (
        lambda f, h: gloves.write_manus(f, h, data=np.zeros((9, 24, 7))), r"\(T, 25, 7\), not .* \(9, 24"
    ),
    "csv with decimal commas": (
        lambda f, h: gloves.write_manus_csv(f, h, commas(gloves.manus_table(h)), ";"),
        "line 2 must contain numbers with decimal points: .*'.*,.*'",
    ),
    "mediapipe in the picture": (
        lambda f, h: gloves.write_mediapipe(f, h, pictures(h)), "frame 0: .*image landmarks .* world landm"
    ),
    "mediapipe of a mirrored picture": (
        lambda f, h: gloves.write_mediapipe(f, h, relabelled(dc.replace(h, side="left"), [["Right"]])),
        "bend backwards .* read it with --side left, .* if the axes are mirrored, convert it with "
        "--side left --mirror",
    ),
    "openxr with the palm second": (
        lambda f, h: gloves.write_openxr(f, h, joints=gloves.stacked(h.joints(), PALM_SECOND)),
        "wrong joint order: .* keypoint 1, the thumb's base",
    ),
    "webxr without ones": (
        lambda f, h: gloves.write_webxr(f, h, joints=0.5 * np.load(gloves.write_webxr(f, h))["joints"]),
        "rigid transforms, whose last row is 0 0 0 1",
    ),
    "vision pro with the joints in the world": (
        lambda f, h: gloves.write_vision_pro(
            f, h, right_fingers=gloves.vision_pro_arrays(h)["right_wrist"] @ fingers(h)
        ),
        "joints in the wrist's frame",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_a_file_whose_meaning_is_open_is_refused(tmp_path, fault):
    write, message = REFUSED[fault]
    path = write(tmp_path, moving())
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(str(path))


def fingers(hand):
    return gloves.vision_pro_arrays(hand)["right_fingers"]


REPAIRED = {
    "mediapipe labelled for the mirror": (
        lambda f, h: gloves.write_mediapipe(f, h, relabelled(h, [["Left"]])),
        "labelled left, but the fingers bend as a right hand's: read as right, .* mirrored",
    ),
    "vision pro transposed": (
        lambda f, h: gloves.write_vision_pro(f, h, right_fingers=np.swapaxes(fingers(h), 2, 3)),
        "transforms are stored transposed",
    ),
    "own with odd metadata": (
        lambda f, h: gloves.write_own(f, h, metadata=metadata(format=["x"])), "metadata format must be str"
    ),
}  # fmt: skip


@pytest.mark.parametrize("oddity", REPAIRED)
def test_what_is_odd_but_clear_is_read_with_a_warning(tmp_path, oddity):
    """The keypoints are the same as without the oddity."""
    write, message = REPAIRED[oddity]
    recording = read_recording(write(tmp_path, moving()))
    (warning,) = recording.metadata["warnings"]
    assert re.search(message, warning)
    np.testing.assert_allclose(recording.p_HK, moving().p_HK, atol=1e-6)


def test_a_git_lfs_pointer_is_named_with_the_way_out(tmp_path):
    """In place of any recording, also of one of HO-3D's pickles."""
    for suffix in ("csv", "json", "npz", "pkl"):
        path = tmp_path / f"0000.{suffix}"
        path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
        with pytest.raises(RecordingError, match=rf"0000\.{suffix}: is a Git LFS pointer.*`git lfs pull`"):
            read_recording(path)
    with pytest.raises(RecordingError, match=r"0000\.pkl: is a Git LFS pointer.*`git lfs pull`"):
        read_recording(tmp_path)


def test_short_recordings_can_be_replayed_but_not_trained_on(tmp_path):
    """From two frames on; training needs 300."""
    for frames in (2, 3, 4, 250):
        path = gloves.write_own(tmp_path, moving().part(np.arange(frames)))
        _, findings = examine(open_recording(path)[0])
        assert f"{frames} valid frames, training needs at least 300" in " ".join(map(str, findings))
        with pytest.raises(RecordingError, match=r"own\.npz: "):
            read_recording(path, training=True)
    assert any("250 valid frames" in warning for warning in read_recording(path).metadata["warnings"])


@pytest.mark.parametrize("name", ORDERS)
def test_the_order_of_joints_is_named(name, rng):
    """In any frame, unit and side, also with a camera's noise."""
    p = moving().p_HK[:, ORDERS[name]] * [1, -1, 1] * rng.uniform(0.01, 1000)
    assert fitting_order(p)[0] == name
    assert fitting_order(p + rng.normal(0.0, 0.015 * np.abs(p).max(), p.shape))[0] == name


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("length_m", "breadth_m"), [(0.15, 0.07), (0.21, 0.1)])
def test_the_order_of_sound_hands_is_right(length_m, breadth_m, side):
    """Of several people, either side, straight, in motion, in a fist, and as a camera sees them."""
    hand = HumanHand.anatomical(length_m, breadth_m)
    p_HK = synthesize_play(1, duration_s=10.0, rate_hz=30.0, hand=hand).p_HK.astype(float)
    fist = np.where([name.endswith("flexion") for name in hand.joint_names], hand.upper, 0.0)
    for p in (p_HK, p_HK[:5], hand.keypoints(np.zeros((5, 20))), hand.keypoints(fist[None].repeat(5, 0))):
        seen = mirrored(p) if side == "left" else p
        assert fitting_order(seen)[0] == EXPECTED
        assert fitting_order(seen + np.random.default_rng(0).normal(0.0, 0.003, seen.shape))[0] == EXPECTED


def test_real_recordings_are_sound(alex_npy, manus_npz):
    """Of two people's recordings one is sound; the other has what is known of it, and no error."""
    known = {manus_npz: [], alex_npy: ["timestamps", "duplicated frames", "jumps", "pinches"]}
    for path, checks in known.items():
        recording, findings = open_recording(path)
        findings += examine(recording)[1]
        assert [finding.check for finding in findings] == checks
        assert all(finding.severity is WARNING for finding in findings)


@pytest.mark.parametrize("p_HK", [np.zeros((0, 21, 3)), np.full((9, 21, 3), np.nan)], ids=["empty", "lost"])
def test_a_file_without_a_hand_is_refused_without_warnings(p_HK, tmp_path):
    np.save(tmp_path / "hand.npy", p_HK)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RecordingError, match=r"at least 2 frames|show no hand"):
            read_recording(tmp_path / "hand.npy")

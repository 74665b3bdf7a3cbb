"""Faults of a recording's file, each alone, and what must be said of it."""

import json
from dataclasses import replace

import numpy as np
from glove_files import (
    FROM_WRIST_25,
    manus_table,
    mediapipe_frames,
    openxr_frames,
    poses,
    stacked,
    transforms,
    vision_pro_app_frames,
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
    write_vision_pro_app,
    write_vision_pro_pkl,
    write_webxr,
    write_webxr_json,
)
from moving_hands import FRAMES


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


def labelled(hand, label):
    return [{**frame, "handedness": [[{"categoryName": label}]]} for frame in mediapipe_frames(hand)]


def timed(contents, times):
    for frame, t in zip(contents["frames"], times.tolist(), strict=True):
        frame["time"] = t
    return contents


def commas(table):
    return [[str(cell).replace(".", ",") for cell in row] for row in table]


def split_at_commas(path):
    """Without the quotes that keep a cell with a comma together."""
    path.write_text(path.read_text().replace('"', ""))
    return path


def with_joint(hand, i, joint, value):
    frames = vision_pro_app_frames(hand)
    frames[i]["rightHand"][joint] = value
    return frames


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


def cut(path):
    """The first half of the file."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


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
    "csv in metres": (
        lambda f, h: write_manus_csv(f, h, manus_table(h, "_Position")),
        "but is 0.0008.* m with the file's lengths in cm; .* numbers were metres .*--unit m$",
    ),
    "csv with decimal commas": (
        lambda f, h: write_manus_csv(f, h, commas(manus_table(h)), ";"),
        "column Hand_X must be a number, not '.*,.*'; write decimals with points",
    ),
    "csv with decimal commas between commas": (
        lambda f, h: split_at_commas(write_manus_csv(f, h, commas(manus_table(h)))),
        "line 2 has 1\\d\\d cells, the header has 78; are decimals written with commas",
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
    "mediapipe in the picture, with labels": (
        lambda f, h: write_mediapipe(
            f,
            h,
            [{"landmarks": m["worldLandmarks"], "handedness": m["handedness"]} for m in mediapipe_frames(h)],
        ),
        "frame 0 holds landmarks of the picture .* world landmarks",
    ),
    "mediapipe of the other hand": (
        lambda f, h: write_mediapipe(f, replace(h, side="left")),
        "holds a left hand by its label, and its fingers do not bend as a right one's",
    ),
    "mediapipe labelled for the mirror": (
        lambda f, h: write_mediapipe(f, h, labelled(h, "Left")),
        "labelled left, but the fingers bend as a right hand's: taken for a right one, .* mirrored",
    ),
    "mediapipe of a mirrored picture": (
        lambda f, h: write_mediapipe(f, h, labelled(replace(h, side="left"), "Right")),
        "bend backwards .* read it with side 'left', and if the axes are mirrored also with --mirror",
    ),
    "mediapipe of no side": (
        lambda f, h: write_mediapipe(f, h, labelled(h, "Both")),
        "frame 0: handedness 'both' is none of: left, right",
    ),
    "mediapipe in seconds": (
        lambda f, h: write_mediapipe(
            f, h, [{**m, "timestampMs": t} for m, t in zip(mediapipe_frames(h), h.t.tolist(), strict=True)]
        ),
        "timestampMs must be in milliseconds, .* gives 6e.04; .* numbers were seconds",
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
    "openxr in milliseconds": (
        lambda f, h: write_openxr_json(f, h, timed(openxr_frames(h), 1e3 * h.t)),
        "time must be in nanoseconds, .* gives 6e.07; .* numbers were milliseconds",
    ),
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
    "vision pro's app with a short matrix": (
        lambda f, h: write_vision_pro_app(f, h, with_joint(h, 7, "ringTip", [1.0] * 15)),
        "frame 7, rightHand.ringTip must be 16 numbers",
    ),
    "vision pro's app, the other hand": (
        lambda f, h: write_vision_pro_app(f, replace(h, side="left")),
        "no frame has a rightHand; the file holds the other hand",
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

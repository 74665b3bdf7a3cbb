"""Hands in motion, and recordings of them in every format that is read, by the documentation of each."""

import csv
import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from geort_drake.people.synthetic.hand import HumanHand

FRAMES, RATE_HZ = 400, 60.0
FINGERS = ("index", "middle", "ring", "little")
KEYPOINTS = ("wrist", *(f"thumb_{j}" for j in ("cmc", "mcp", "ip", "tip"))) + tuple(
    f"{finger}_{j}" for finger in FINGERS for j in ("mcp", "pip", "dip", "tip")
)


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand in motion: keypoints p_HK (T, 21, 3) as a right hand's, times, and its wrist in the world."""

    p_HK: np.ndarray
    t: np.ndarray
    R_WH: np.ndarray
    p_WH: np.ndarray
    side: str = "right"

    @property
    def seen(self) -> np.ndarray:
        """The keypoints of the real hand, which is the mirror image of a left one's description."""
        return self.p_HK * [1, -1, 1] if self.side == "left" else self.p_HK

    def part(self, frames) -> "Hand":
        """Only those frames, with the times they had."""
        return Hand(self.p_HK[frames], self.t[frames], self.R_WH[frames], self.p_WH[frames], self.side)

    def joints(self, world: bool = True) -> dict[str, np.ndarray]:
        """Positions (T, 3) by name, in the world or from the wrist, with what lies beside the keypoints."""
        p = self.seen
        if world:
            p = np.einsum("tij,tkj->tki", self.R_WH, p) + self.p_WH[:, None]
        named = {name: p[:, i] for i, name in enumerate(KEYPOINTS)}
        for finger in FINGERS:
            named[f"{finger}_base"] = 0.7 * named["wrist"] + 0.3 * named[f"{finger}_mcp"]
        named["palm"] = 0.5 * (named["middle_base"] + named["middle_mcp"])
        named["elbow"] = named["wrist"] + 3.0 * (named["wrist"] - named["middle_mcp"])
        return named


@functools.cache
def moving(pinch: bool = True, held: tuple[tuple[str, float], ...] = ()) -> Hand:
    """Every joint swings at its own pace, the thumb meets each finger once, and the wrist turns and travels.

    Args:
        pinch: whether the thumb meets the fingers; otherwise it stays away from them.
        held: joints that do not move, and the angle they keep, deg.
    """
    hand, t = HumanHand.anatomical(), np.arange(FRAMES) / RATE_HZ
    phase = 2 * np.pi * t[:, None] * (0.5 + 0.03 * np.arange(20))
    theta = 0.5 * (hand.lower + hand.upper) + 0.42 * (hand.upper - hand.lower) * np.sin(phase)
    for finger in range(1, 5) if pinch else ():
        pose = np.deg2rad([30, 20, 20, 40, *[0, 20, 20, 15] * 4]).reshape(5, 4)
        pose[finger] = np.deg2rad([0, 40, 50, 35])
        pose = pose.reshape(20)
        for _ in range(8):
            tips = hand.fingertips(pose)
            tips[[0, finger]] = tips[[0, finger]].mean(axis=0)
            pose = hand.solve_fingertips(tips, pose)
        near = 0.5 * (1 + np.cos(np.pi * np.clip((np.arange(FRAMES) - 80 * finger) / 32, -1, 1)))[:, None]
        theta = theta + near * (pose - theta)
    if not pinch:
        theta[:, :4] = np.deg2rad([45, -15, 0, 10] + [14, 14, 8, 12] * np.sin(phase[:, :4]))
    for joint, degrees in held:
        theta[:, hand.joint_names.index(joint)] = np.deg2rad(degrees)
    s = t / t[-1]
    turn = Rotation.from_euler("xyz", np.column_stack([7 * s, 0.8 * np.sin(9 * s), 1 - 3 * s]))
    path = np.column_stack([0.4 * s, 0.1 * np.cos(s), 1.0 + 0.1 * np.sin(5 * s)])
    return Hand(hand.keypoints(theta), t, turn.as_matrix(), path)


# -- files: joints are called by name, so that nothing of a reader is used


def stacked(named: dict[str, np.ndarray], order) -> np.ndarray:
    """(T, J, 3) in an order of names."""
    return np.stack([named[name] for name in order], axis=1)


def poses(p: np.ndarray, quaternion) -> np.ndarray:
    """(T, J, 7): points with the same quaternion each."""
    return np.concatenate([p, np.broadcast_to(quaternion, (*p.shape[:2], 4))], axis=2)


def transforms(p: np.ndarray, R: np.ndarray | None = None) -> np.ndarray:
    """(..., 4, 4) with translations p (..., 3)."""
    X = np.zeros((*p.shape[:-1], 4, 4))
    X[..., :3, :3] = np.eye(3) if R is None else R
    X[..., :3, 3], X[..., 3, 3] = p, 1.0
    return X


def xyz(point: list[float]) -> dict[str, float]:
    return dict(zip("xyz", point, strict=True))


def with_bases(name: str) -> list[str]:
    """Five joints of a finger from the metacarpal's base to the tip."""
    return [f"{name}_{j}" for j in ("base", "mcp", "pip", "dip", "tip")]


THUMB = [f"thumb_{j}" for j in ("cmc", "mcp", "ip", "tip")]
FROM_WRIST_25 = ["wrist", *THUMB, *(joint for finger in FINGERS for joint in with_bases(finger))]


def write_contents(path: Path, contents: Any) -> None:
    """Writes a file; its ending says how."""
    match path.suffix:
        case ".npz":
            np.savez(path, **contents)
        case ".npy":
            np.save(path, contents)
        case ".jsonl":
            path.write_text("".join(json.dumps(line) + "\n" for line in contents))
        case _:
            path.write_text((yaml.safe_dump if path.suffix == ".yaml" else json.dumps)(contents))


def writer(name: str, contents_of: Callable[[Hand], Any]):
    """Makes a function that writes what another makes of a hand, or other contents that are given.

    Fields of an .npz file can be replaced by name; those given as None are left out.
    """

    def write(folder: Path, hand: Hand, contents: Any = None, **fields) -> Path:
        contents = contents_of(hand) if contents is None else contents
        if fields:
            contents = {key: value for key, value in (contents | fields).items() if value is not None}
        write_contents(folder / name, contents)
        return folder / name

    return write


def own_fields(hand: Hand) -> dict:
    """docs/reference/recording-formats.md: t, p_HK, valid, X_WH, metadata."""
    quaternions = Rotation.from_matrix(hand.R_WH).as_quat(scalar_first=True)
    return {
        "t": hand.t,
        "p_HK": hand.p_HK.astype(np.float32),
        "valid": np.ones(len(hand.t), bool),
        "X_WH": np.column_stack([quaternions, hand.p_WH]),
        "metadata": np.array(json.dumps({"side": hand.side, "convention": 1})),
    }


def manus_fields(hand: Hand) -> dict:
    """25 nodes with quaternions, Unix time."""
    return {
        "data": poses(stacked(hand.joints(), FROM_WRIST_25), [1.0, 0, 0, 0]).astype(np.float64),
        "timestamps": 1.7e9 + hand.t,
        "keypoint_ids": np.arange(25, dtype=np.int32),
        "chirality": np.array(hand.side.upper()),
    }


def _manus_joints() -> dict[str, str]:
    """MANUS Core's names of joints, and ours."""
    thumb = dict(zip(("CMC", "MCP", "DIP", "TIP"), THUMB, strict=True))
    names = {"Hand": "wrist"} | {f"Thumb_{joint}": name for joint, name in thumb.items()}
    for finger, called in zip(FINGERS, ("Index", "Middle", "Ring", "Pinky"), strict=True):
        joints = zip(("CMC", "MCP", "PIP", "DIP", "TIP"), with_bases(finger), strict=True)
        names |= {f"{called}_{joint}": name for joint, name in joints}
    return names


def manus_table(hand: Hand, infix: str = "", p: np.ndarray | None = None) -> list[list]:
    """The rows of MANUS Core's export, header first; in metres in the world, or of points (T, 25, 3)."""
    names = _manus_joints()
    header = ["Frame", "Elapsed_Time_In_Milliseconds", "Time"]
    header += [f"{joint}{infix}_{axis}" for joint in names for axis in "XYZ"]
    p = (stacked(hand.joints(), names.values()) if p is None else p).reshape(len(hand.t), -1)
    rows = [
        [i, 1e3 * t, "03:08:42:2042", *row] for i, (t, row) in enumerate(zip(hand.t, p.tolist(), strict=True))
    ]
    return [header, *rows]


def published_manus_table(hand: Hand) -> list[list]:
    """As in exports that people publish: centimetres from the hand, y out of its back, z along the fingers.

    x then is on the right of a hand whose palm looks down, so these axes are left-handed.
    """
    p = stacked(hand.joints(world=False), _manus_joints().values())
    given = np.stack([-p[..., 1], -p[..., 0], p[..., 2]], axis=-1)
    table = manus_table(hand, "_Position", np.round(100.0 * given, 6))
    table[0] += [f"{joint}_Rotation_{axis}" for joint in _manus_joints() for axis in "XYZ"]
    return [table[0], *(row + [0.0] * 75 for row in table[1:])]


def write_manus_csv(
    folder: Path, hand: Hand, table: list[list] | None = None, delimiter: str = ",", name: str = "manus"
) -> Path:
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as file:
        csv.writer(file, delimiter=delimiter).writerows(manus_table(hand) if table is None else table)
    return path


def mediapipe_frames(hand: Hand) -> list[dict]:
    """Results as JavaScript gives them: about the middle of the hand, turned as the camera sees it."""
    label = [[{"categoryName": hand.side.title(), "score": 0.98}]]
    return [
        {"timestampMs": 1e3 * t, "handedness": label, "worldLandmarks": [[xyz(x) for x in points]]}
        for t, points in zip(hand.t.tolist(), mediapipe_points(hand).tolist(), strict=True)
    ]


def mediapipe_points(hand: Hand) -> np.ndarray:
    """(T, 21, 3) world landmarks, about the middle of the hand."""
    p = stacked(hand.joints(), KEYPOINTS)
    return p - p.mean(axis=1, keepdims=True)


def openxr_order() -> list[str]:
    return ["palm", *FROM_WRIST_25]


def openxr_fields(hand: Hand) -> dict:
    """joints (T, 26, 7), quaternions x y z w."""
    joints = poses(stacked(hand.joints(), openxr_order()), [0, 0, 0, 1.0])
    return {"joints": joints, "t": hand.t, "hand": np.array(hand.side)}


def openxr_frames(hand: Hand) -> dict:
    p = stacked(hand.joints(), openxr_order()).tolist()
    start, seen = 1_700_000_000_000_000_000, {"locationFlags": 15, "radius": 0.01}
    frames = [
        {"time": start + round(1e9 * t), "joints": [seen | {"pose": {"position": xyz(x)}} for x in points]}
        for t, points in zip(hand.t.tolist(), p, strict=True)
    ]
    return {"hand": hand.side, "frames": frames}


def webxr_names() -> dict[str, str]:
    """The names of XRHandJoint and what they are here."""
    bones = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
    names = {"wrist": "wrist"}
    names |= dict(zip((f"thumb-{bone}" for bone in (*bones[:2], *bones[3:])), THUMB, strict=True))
    for called, finger in zip(("index", "middle", "ring", "pinky"), FINGERS, strict=True):
        names |= dict(zip((f"{called}-finger-{bone}" for bone in bones), with_bases(finger), strict=True))
    return names


def webxr_frames(hand: Hand) -> dict:
    names = webxr_names()
    p = stacked(hand.joints(), names.values()).tolist()
    joints = [{n: {"position": xyz(x)} for n, x in zip(names, points, strict=True)} for points in p]
    frames = [{"time": 5000.0 + 1e3 * t, "joints": j} for t, j in zip(hand.t.tolist(), joints, strict=True)]
    return {"handedness": hand.side, "frames": frames}


def webxr_fields(hand: Hand) -> dict:
    """What fillPoses fills: 16 numbers per joint, column by column."""
    X = transforms(stacked(hand.joints(), webxr_names().values()), hand.R_WH[:, None])
    joints = np.swapaxes(X, -1, -2).reshape(len(X), 400)
    return {"joints": joints, "t": hand.t, "handedness": np.array(hand.side)}


def vision_pro_arrays(hand: Hand, joints: int = 25) -> dict[str, np.ndarray]:
    """Joints in the wrist's frame J, whose axes are not H's, and the wrist in the world."""
    R_HJ = Rotation.from_euler("xyz", [0.3, 1.2, -2.0]).as_matrix()
    order = {25: FROM_WRIST_25, 27: [*FROM_WRIST_25, "wrist", "elbow"]}[joints]
    X = transforms(stacked(hand.joints(world=False), order) @ R_HJ)
    if joints == 27:
        X[:, 25, :3, :3] = R_HJ  # the forearm's frame at the wrist has another orientation
    return {
        f"{hand.side}_fingers": X,
        f"{hand.side}_wrist": transforms(hand.p_WH, hand.R_WH @ R_HJ)[:, None],
        "timestamps": 12.5 + hand.t,
    }


write_own = writer("own.npz", own_fields)
write_geort = writer("geort.npy", lambda hand: hand.seen)  # (T, 21, 3) in the wrist frame
write_manus = writer("manus.npz", manus_fields)
write_mediapipe = writer("mediapipe.json", mediapipe_frames)
write_openxr = writer("openxr.npz", openxr_fields)
write_openxr_json = writer("openxr.json", openxr_frames)
write_webxr = writer("webxr.npz", webxr_fields)
write_vision_pro = writer("avp.npz", vision_pro_arrays)
# One writer for each kind of file.
WRITERS = {
    "own": write_own,
    "geort": write_geort,
    "manus": write_manus,
    "manus_csv": write_manus_csv,
    "mediapipe": write_mediapipe,
    "mediapipe_npy": writer("world.npy", mediapipe_points),
    "openxr": write_openxr,
    "openxr_json": write_openxr_json,
    "webxr": write_webxr,
    "webxr_json": writer("webxr.json", webxr_frames),
    "vision_pro": write_vision_pro,
}
# The name under which `formats` knows each.
NAMES = {name: name.removesuffix("_json") for name in WRITERS} | {"mediapipe_npy": "geort"}
TIMED = tuple(name for name in WRITERS if name not in ("geort", "mediapipe_npy"))

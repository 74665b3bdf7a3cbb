"""Recordings in every format that is read, written from a hand model by the formats' own documentation.

Joints are called by name here and put in order by each writer, so that nothing of a reader is used.
"""

import csv
import json
import pickle
from pathlib import Path

import numpy as np
from moving_hands import FINGERS, KEYPOINTS, Hand
from scipy.spatial.transform import Rotation


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


def with_bases(name: str) -> list[str]:
    """Five joints of a finger from the metacarpal's base to the tip."""
    return [f"{name}_{j}" for j in ("base", "mcp", "pip", "dip", "tip")]


THUMB = [f"thumb_{j}" for j in ("cmc", "mcp", "ip", "tip")]
FROM_WRIST_25 = ["wrist", *THUMB, *(joint for finger in FINGERS for joint in with_bases(finger))]


def write_own(folder: Path, hand: Hand, **changes) -> Path:
    """docs/reference/recording-formats.md: t, p_HK, valid, X_WH, metadata."""
    metadata = {"side": hand.side, "convention": 1}
    quaternions = Rotation.from_matrix(hand.R_WH).as_quat(scalar_first=True)
    fields = {
        "t": hand.t,
        "p_HK": hand.p_HK.astype(np.float32),
        "valid": np.ones(len(hand.t), bool),
        "X_WH": np.column_stack([quaternions, hand.p_WH]),
        "metadata": np.array(json.dumps(metadata)),
    }
    return _npz(folder / "own.npz", fields, changes)


def write_geort(folder: Path, hand: Hand) -> Path:
    """(T, 21, 3) in the wrist frame."""
    np.save(folder / "geort.npy", hand.seen)
    return folder / "geort.npy"


def write_manus(folder: Path, hand: Hand, **changes) -> Path:
    """25 nodes with quaternions, Unix time."""
    fields = {
        "data": poses(stacked(hand.joints(), FROM_WRIST_25), [1.0, 0, 0, 0]).astype(np.float64),
        "timestamps": 1.7e9 + hand.t,
        "keypoint_ids": np.arange(25, dtype=np.int32),
        "chirality": np.array(hand.side.upper()),
    }
    return _npz(folder / "manus.npz", fields, changes)


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
    folder: Path,
    hand: Hand,
    table: list[list] | None = None,
    delimiter: str = ",",
    name: str = "manus",
) -> Path:
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as file:
        csv.writer(file, delimiter=delimiter).writerows(manus_table(hand) if table is None else table)
    return path


def mediapipe_frames(hand: Hand) -> list[dict]:
    """Results as JavaScript gives them: about the middle of the hand, turned as the camera sees it."""
    p = stacked(hand.joints(), KEYPOINTS)
    p = p - p.mean(axis=1, keepdims=True)
    label = [[{"categoryName": hand.side.title(), "score": 0.98}]]
    return [
        {
            "timestampMs": 1e3 * t,
            "handedness": label,
            "worldLandmarks": [[dict(zip("xyz", point, strict=True)) for point in points]],
        }
        for t, points in zip(hand.t.tolist(), p.tolist(), strict=True)
    ]


def write_mediapipe(folder: Path, hand: Hand, frames: list | None = None) -> Path:
    return _json(folder / "mediapipe.json", mediapipe_frames(hand) if frames is None else frames)


def write_mediapipe_npy(folder: Path, hand: Hand) -> Path:
    p = stacked(hand.joints(), KEYPOINTS)
    np.save(folder / "world.npy", p - p.mean(axis=1, keepdims=True))
    return folder / "world.npy"


def openxr_order() -> list[str]:
    return ["palm", *FROM_WRIST_25]


def write_openxr(folder: Path, moved: Hand, **changes) -> Path:
    """joints (T, 26, 7), quaternions x y z w."""
    fields = {
        "joints": poses(stacked(moved.joints(), openxr_order()), [0, 0, 0, 1.0]),
        "t": moved.t,
        "hand": np.array(moved.side),
    }
    return _npz(folder / "openxr.npz", fields, changes)


def openxr_frames(hand: Hand) -> dict:
    p = stacked(hand.joints(), openxr_order()).tolist()
    start = 1_700_000_000_000_000_000
    return {
        "hand": hand.side,
        "frames": [
            {
                "time": start + round(1e9 * t),
                "joints": [
                    {
                        "locationFlags": 15,
                        "radius": 0.01,
                        "pose": {"position": dict(zip("xyz", x, strict=True))},
                    }
                    for x in points
                ],
            }
            for t, points in zip(hand.t.tolist(), p, strict=True)
        ],
    }


def write_openxr_json(folder: Path, hand: Hand, contents: dict | None = None) -> Path:
    return _json(folder / "openxr.json", openxr_frames(hand) if contents is None else contents)


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
    return {
        "handedness": hand.side,
        "frames": [
            {
                "time": 5000.0 + 1e3 * t,
                "joints": {
                    name: {"position": dict(zip("xyz", x, strict=True))}
                    for name, x in zip(names, points, strict=True)
                },
            }
            for t, points in zip(hand.t.tolist(), p, strict=True)
        ],
    }


def write_webxr_json(folder: Path, hand: Hand, contents: dict | None = None) -> Path:
    return _json(folder / "webxr.json", webxr_frames(hand) if contents is None else contents)


def write_webxr(folder: Path, hand: Hand, **changes) -> Path:
    """What fillPoses fills: 16 numbers per joint, column by column."""
    X = transforms(stacked(hand.joints(), webxr_names().values()), hand.R_WH[:, None])
    fields = {
        "joints": np.swapaxes(X, -1, -2).reshape(len(X), 400),
        "t": hand.t,
        "handedness": np.array(hand.side),
    }
    return _npz(folder / "webxr.npz", fields, changes)


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


def write_vision_pro(folder: Path, hand: Hand, joints: int = 25, **changes) -> Path:
    return _npz(folder / "avp.npz", vision_pro_arrays(hand, joints), changes)


def write_vision_pro_pkl(folder: Path, hand: Hand, frames: list | None = None) -> Path:
    """A list of dicts, with the 27 transforms of the releases that put the forearm first."""
    arrays = vision_pro_arrays(hand, 27)
    joints = f"{hand.side}_fingers"
    arrays[joints] = np.roll(arrays[joints], 2, axis=1)[:, [1, 0, *range(2, 27)]]
    times = arrays.pop("timestamps")
    made = [
        {name: v[i] for name, v in arrays.items()} | {"timestamp": t} for i, t in enumerate(times.tolist())
    ]
    return _pickle(folder / "avp.pkl", made if frames is None else frames)


def vision_pro_app_frames(hand: Hand) -> list[dict]:
    """Lines of the app's own recording: joints by name from the wrist, and the wrist in the world."""
    arrays = vision_pro_arrays(hand, 27)
    names = ["wrist", *(f"thumb{j}" for j in ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip"))]
    joints = ("Metacarpal", "Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
    names += [f"{finger}{joint}" for finger in FINGERS for joint in joints] + ["forearmWrist", "forearmArm"]
    X = arrays[f"{hand.side}_fingers"]
    X[:, 0] = arrays[f"{hand.side}_wrist"][:, 0]
    columns = np.swapaxes(X, -1, -2).reshape(len(X), 27, 16).tolist()
    return [
        {
            "timestamp": t,
            "systemTime": 1.76e9 + t,
            f"{hand.side}Hand": dict(zip(names, row, strict=True)),
            "videoFrameIndex": -1,
        }
        for t, row in zip(hand.t.tolist(), columns, strict=True)
    ]


def write_vision_pro_app(folder: Path, hand: Hand, frames: list | None = None) -> Path:
    path = folder / "tracking.jsonl"
    made = vision_pro_app_frames(hand) if frames is None else frames
    path.write_text("".join(json.dumps(frame) + "\n" for frame in made))
    return path


def mano_order() -> list[str]:
    """MANO's joints, then the tips."""
    inner = [
        f"{finger}_{j}" for finger in ("index", "middle", "little", "ring") for j in ("mcp", "pip", "dip")
    ]
    tips = [f"{finger}_tip" for finger in ("thumb", "index", "middle", "ring", "little")]
    return ["wrist", *inner, "thumb_cmc", "thumb_mcp", "thumb_ip", *tips]


def write_mano(folder: Path, hand: Hand, **changes) -> Path:
    fields = {"handJoints3D": stacked(hand.joints(), mano_order()), "t": hand.t, "side": np.array(hand.side)}
    return _npz(folder / "mano.npz", fields, changes)


def write_mano_npy(folder: Path, hand: Hand) -> Path:
    np.save(folder / "mano.npy", stacked(hand.joints(), mano_order()))
    return folder / "mano.npy"


def write_ho3d(folder: Path, hand: Hand, annotations: list | None = None) -> Path:
    """HO-3D's folder meta, one pickle per frame."""
    joints = stacked(hand.joints(), mano_order()).astype(np.float32)
    made = [{"handJoints3D": p, "camMat": np.eye(3), "objName": "006_mustard"} for p in joints]
    (folder / "meta").mkdir()
    for i, annotation in enumerate(made if annotations is None else annotations):
        _pickle(folder / "meta" / f"{i:04}.pkl", annotation, protocol=2)
    return folder / "meta"


def operator_axes(hand: Hand) -> np.ndarray:
    """dex-retargeting's joint_pos: from the wrist, in axes that the palm gives."""
    return hand.seen @ Rotation.from_euler("z", 4, degrees=True).as_matrix()


def write_dex_retargeting(folder: Path, hand: Hand, frames: list | None = None) -> Path:
    return _pickle(folder / "dex.pkl", list(operator_axes(hand)) if frames is None else frames)


# One writer for each kind of file.
WRITERS = {
    "own": write_own,
    "geort": write_geort,
    "manus": write_manus,
    "manus_csv": write_manus_csv,
    "mediapipe": write_mediapipe,
    "mediapipe_npy": write_mediapipe_npy,
    "openxr": write_openxr,
    "openxr_json": write_openxr_json,
    "webxr": write_webxr,
    "webxr_json": write_webxr_json,
    "vision_pro": write_vision_pro,
    "vision_pro_pkl": write_vision_pro_pkl,
    "vision_pro_app": write_vision_pro_app,
    "mano": write_mano,
    "mano_npy": write_mano_npy,
    "ho3d": write_ho3d,
    "dex_retargeting": write_dex_retargeting,
}
# The name under which `formats` knows each.
NAMES = {name: name.removesuffix("_json").removesuffix("_npy").removesuffix("_pkl") for name in WRITERS} | {
    "own": "geort_drake",
    "ho3d": "mano",
    "vision_pro_app": "vision_pro",
}
TIMED = tuple(
    name for name in WRITERS if name not in ("geort", "mediapipe_npy", "mano_npy", "ho3d", "dex_retargeting")
)


def _npz(path: Path, fields: dict, changes: dict) -> Path:
    fields = {**fields, **changes}
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})
    return path


def _json(path: Path, contents) -> Path:
    path.write_text(json.dumps(contents))
    return path


def _pickle(path: Path, contents, protocol: int = 4) -> Path:
    path.write_bytes(pickle.dumps(contents, protocol=protocol))
    return path

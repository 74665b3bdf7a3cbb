"""A family of invented hands in URDF, SDF and MJCF: 2 to 5 fingers, odd names and frames."""

import dataclasses as dc
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

TIP_RADIUS = 0.008  # m
LENGTHS = (0.0, 0.042, 0.028, 0.02)  # m, of the links of a finger
THUMB_LENGTHS = (0.0, 0.045, 0.032)


@dc.dataclass(frozen=True)
class HandSpec:
    """A hand of the family.

    Attributes:
        fingers: 2 to 5, the thumb among them.
        kind: "urdf", "sdf" or "xml".
        mimic: whether the last joint of each finger but the thumb follows the one before.
        names: "plain", or "odd", which do not identify the fingers.
        turn: roll, pitch, yaw in degrees of the palm's frame in the hand base B.
        side: "right" or "left".
        collision: whether the fingers have collision geometry.
        forearm: length of a link behind the palm, thicker than it, m; 0: none. Of a URDF without a turn.
    """

    fingers: int = 3
    kind: str = "urdf"
    mimic: bool = True
    names: str = "plain"
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    side: str = "right"
    collision: bool = True
    forearm: float = 0.0

    @property
    def finger_names(self) -> list[str]:
        return ["thumb", "index", "middle", "ring", "little"][: self.fingers]

    @property
    def R_BP(self) -> np.ndarray:
        """(3, 3) orientation of the palm's frame in B."""
        return Rotation.from_euler("xyz", self.turn, degrees=True).as_matrix()


@dc.dataclass(frozen=True)
class _Joint:
    name: str
    parent: str
    link: str
    xyz: np.ndarray
    axis: np.ndarray
    lower: float
    upper: float
    length: float
    along: np.ndarray  # unit vector, where the link lies
    last: bool
    follows: tuple[str, float, float] | None


def write_hand(folder: Path, spec: HandSpec, stem: str = "hand", changes: Mapping[str, str] = {}) -> Path:
    """Writes the model, with `changes` of what matches their patterns, and returns its file."""
    text = {"urdf": _urdf, "sdf": _sdf, "xml": _mjcf}[spec.kind](spec, _joints(spec))
    for pattern, replacement in changes.items():
        text, count = re.subn(pattern, replacement, text)
        assert count, f"nothing in the model is {pattern}"
    path = folder / f"{stem}.{spec.kind}"
    path.write_text(text, encoding="utf-8")
    return path


def joint_name(spec: HandSpec, finger: int, number: int) -> str:
    return f"{_label(spec, finger)}_{'j' if spec.names == 'plain' else 'ax'}{number}"


def _label(spec: HandSpec, finger: int) -> str:
    # The odd ones are not in the order of the fingers either.
    return spec.finger_names[finger] if spec.names == "plain" else f"m{(3 * finger + 2) % 7}"


def _joints(spec: HandSpec) -> list[_Joint]:
    R_PB = spec.R_BP.T
    flip = np.array([1.0, -1.0 if spec.side == "left" else 1.0, 1.0])
    joints = []
    for finger in range(spec.fingers):
        thumb = finger == 0
        # In B, of a right hand: knuckles side by side, the thumb beside the palm.
        knuckle = [0.0, 0.022 * ((spec.fingers - 2) / 2 - finger + 1), 0.09]
        origin = np.array([0.015, 0.04, 0.03] if thumb else knuckle)
        along = np.array([0.35, 0.75, 0.55]) if thumb else np.array([0.0, 0.0, 1.0])
        along /= np.linalg.norm(along)
        flexion = np.cross(along, [1.0, -1.0, 0.3] if thumb else [1.0, 0.0, 0.0])
        flexion /= np.linalg.norm(flexion)
        spread = np.cross(flexion, along)
        lengths = THUMB_LENGTHS if thumb else LENGTHS
        parent, before = "palm", origin
        for number, length in enumerate(lengths):
            last = number == len(lengths) - 1
            axis = spread if number == 0 else flexion
            low, high = (-0.6, 0.6) if thumb and number == 0 else (-0.3, 0.3) if number == 0 else (0.0, 1.5)
            follows = None
            if spec.mimic and last and not thumb:
                follows = (joint_name(spec, finger, number - 1), 0.8, 0.1)
            link = f"{_label(spec, finger)}_l{number}"
            # An axis is an axial vector.
            axis = R_PB @ (flip * axis) * flip[1]
            name, place, way = joint_name(spec, finger, number), R_PB @ (flip * before), R_PB @ (flip * along)
            joints.append(_Joint(name, parent, link, place, axis, low, high, length, way, last, follows))
            parent, before = link, along * length
    return joints


def _shapes(spec: HandSpec, joint: _Joint | None) -> list[tuple[str, list[float], np.ndarray, np.ndarray]]:
    """Kind, sizes, centre and rpy of the collision shapes of a link; of the palm for None."""
    if joint is None:
        R_PB = spec.R_BP.T
        rpy = Rotation.from_matrix(R_PB).as_euler("xyz")
        return [("box", [0.02, 0.022 * max(spec.fingers - 1, 2), 0.08], R_PB @ [-0.012, 0, 0.04], rpy)]
    if not spec.collision or joint.length == 0:
        return []
    z = joint.along
    x = np.cross([0.3, 0.5, 0.8], z)
    x /= np.linalg.norm(x)
    rpy = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z])).as_euler("xyz")
    room = joint.length - 2 * TIP_RADIUS
    shapes = [("cylinder", [0.006, room], z * joint.length / 2, rpy)]
    if joint.last:
        shapes.append(("sphere", [TIP_RADIUS], z * joint.length, np.zeros(3)))
    return shapes


def _text(values) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _urdf(spec: HandSpec, joints: list[_Joint]) -> str:
    inertia = '<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="0.03"/>{inertia}</inertial>'

    def link(name, joint):
        parts = []
        for kind, size, centre, rpy in _shapes(spec, joint):
            form = {
                "box": f'<box size="{_text(size)}"/>',
                "cylinder": f'<cylinder radius="{size[0]}" length="{size[-1]}"/>',
                "sphere": f'<sphere radius="{size[0]}"/>',
            }[kind]
            place = f'<origin xyz="{_text(centre)}" rpy="{_text(rpy)}"/>'
            parts.append(f"<collision>{place}<geometry>{form}</geometry></collision>")
        return f'<link name="{name}">{inertial}{"".join(parts)}</link>'

    lines = [link("palm", None)]
    if spec.forearm:
        box = f'<geometry><box size="0.1 0.1 {spec.forearm}"/></geometry>'
        place = f'<origin xyz="0 0 {-spec.forearm / 2}"/>'
        lines += [
            f'<link name="forearm">{inertial}<collision>{place}{box}</collision></link>',
            '<joint name="wrist" type="revolute"><parent link="forearm"/><child link="palm"/>'
            '<axis xyz="0 1 0"/><limit lower="-0.5" upper="0.5" effort="5" velocity="2"/></joint>',
        ]
    for joint in joints:
        mimic = ""
        if joint.follows:
            leader, ratio, offset = joint.follows
            mimic = f'<mimic joint="{leader}" multiplier="{ratio}" offset="{offset}"/>'
        lines.append(link(joint.link, joint))
        lines.append(
            f'<joint name="{joint.name}" type="revolute">'
            f'<parent link="{joint.parent}"/><child link="{joint.link}"/>'
            f'<origin xyz="{_text(joint.xyz)}"/><axis xyz="{_text(joint.axis)}"/>'
            f'<limit lower="{joint.lower}" upper="{joint.upper}" effort="0.7" velocity="6"/>{mimic}</joint>'
        )
    return f'<robot name="family_{spec.side}">' + "\n".join(lines) + "</robot>"


def _sdf(spec: HandSpec, joints: list[_Joint]) -> str:
    def link(name, joint, place=""):
        parts = []
        for number, (kind, size, centre, rpy) in enumerate(_shapes(spec, joint)):
            form = {
                "box": f"<box><size>{_text(size)}</size></box>",
                "cylinder": f"<cylinder><radius>{size[0]}</radius><length>{size[-1]}</length></cylinder>",
                "sphere": f"<sphere><radius>{size[0]}</radius></sphere>",
            }[kind]
            pose = f"<pose>{_text([*centre, *rpy])}</pose>"
            parts.append(f'<collision name="c{number}">{pose}<geometry>{form}</geometry></collision>')
        inertia = "<ixx>1e-5</ixx><iyy>1e-5</iyy><izz>1e-5</izz>"
        inertial = f"<inertial><mass>0.03</mass><inertia>{inertia}</inertia></inertial>"
        return f'<link name="{name}">{place}{inertial}{"".join(parts)}</link>'

    lines = [link("palm", None)]
    for joint in joints:
        mimic = ""
        if joint.follows:
            leader, ratio, offset = joint.follows
            # Of the leader less a reference, here -0.1 rad.
            numbers = f"<multiplier>{ratio}</multiplier><offset>{offset - 0.1 * ratio}</offset>"
            numbers += "<reference>-0.1</reference>"
            mimic = f'<mimic joint="{leader}">{numbers}</mimic>'
        lines.append(
            link(joint.link, joint, f'<pose relative_to="{joint.parent}">{_text(joint.xyz)} 0 0 0</pose>')
        )
        limit = f"<limit><lower>{joint.lower}</lower><upper>{joint.upper}</upper><effort>0.7</effort></limit>"
        lines.append(
            f'<joint name="{joint.name}" type="revolute">'
            f"<parent>{joint.parent}</parent><child>{joint.link}</child>"
            f"<axis><xyz>{_text(joint.axis)}</xyz>{limit}{mimic}</axis></joint>"
        )
    return f'<sdf version="1.11"><model name="family_{spec.side}">' + "\n".join(lines) + "</model></sdf>"


def _mjcf(spec: HandSpec, joints: list[_Joint]) -> str:
    def geoms(joint):
        lines = []
        for kind, size, centre, rpy in _shapes(spec, joint):
            half = (
                [0.5 * value for value in size] if kind == "box" else [size[0], *[0.5 * s for s in size[1:]]]
            )
            x, y, z, w = Rotation.from_euler("xyz", rpy).as_quat()
            place = f'pos="{_text(centre)}" quat="{_text([w, x, y, z])}"'
            lines.append(f'<geom type="{kind}" size="{_text(half)}" {place}/>')
        return "".join(lines)

    def body(name, joint):
        inside = geoms(joint) + "".join(body(child.link, child) for child in joints if child.parent == name)
        inertial = '<inertial pos="0 0 0" mass="0.03" diaginertia="1e-5 1e-5 1e-5"/>'
        if joint is None:
            return f'<body name="{name}">{inertial}{inside}</body>'
        hinge = f'<joint name="{joint.name}" axis="{_text(joint.axis)}" range="{joint.lower} {joint.upper}"/>'
        return f'<body name="{name}" pos="{_text(joint.xyz)}">{inertial}{hinge}{inside}</body>'

    equality = "".join(
        f'<joint joint1="{j.name}" joint2="{j.follows[0]}" polycoef="{j.follows[2]} {j.follows[1]} 0 0 0"/>'
        for j in joints
        if j.follows
    )
    motors = "".join(f'<position joint="{j.name}" kp="1" ctrlrange="-2 2"/>' for j in joints if not j.follows)
    return (
        f'<mujoco model="family_{spec.side}"><compiler angle="radian" autolimits="true"/>'
        f"<worldbody>{body('palm', None)}</worldbody>"
        f"<equality>{equality}</equality><actuator>{motors}</actuator></mujoco>"
    )

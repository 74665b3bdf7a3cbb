"""Prints the SDF model of an average human hand, `models/sdf/human_right.sdf`, from `HumanHand`.

python studies/human_hand_model.py > models/sdf/human_right.sdf
"""

import sys
from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES

# Radii of the three bones with flesh, m, thumb to little; a finger is some 15–20 mm thick.
_RADII = np.array(
    [
        [0.0130, 0.0105, 0.0095],
        [0.0095, 0.0085, 0.0075],
        [0.0095, 0.0085, 0.0075],
        [0.0090, 0.0080, 0.0070],
        [0.0080, 0.0070, 0.0065],
    ]
)
_METACARPAL_RADIUS = 0.0115
_PALM_THICKNESS = 0.026
_KNUCKLE_RADIUS = 0.0075
_DENSITY = 1100.0  # kg/m³, flesh and bone; gives a hand of some 0.4 kg (de Leva 1996: 0.6 % of body mass)
_SKIN = "0.87 0.67 0.55 1"
_LINKS = {"thumb": ("metacarpal", "proximal", "distal")}
_FRAMES = {"thumb": ("cmc", "mcp", "ip", "tip")}

_HEADER = """<?xml version="1.0"?>
<!--
  A human right hand with the kinematics of geort_drake.people.human_hand.HumanHand, from which this
  file is made (studies/human_hand_model.py); the anatomy's sources are named there.

  Link "palm" is the wrist frame H: +x out of the palm, +y towards the index side, +z along the
  fingers. Every finger flexes and then abducts at its base, whence the small link "knuckle" between.
  Frames wrist, thumb_cmc ... little_tip stand at the 21 keypoints.
  Masses and inertias: solid capsules and one box of density 1100 kg/m^3. Units: m, rad, kg.
-->
"""


def human_hand_sdf(hand: HumanHand, name: str) -> str:
    """SDF text of a hand whose joints bear the names of `HumanHand.joint_names`."""
    parts = [_palm(hand)]
    for i, finger in enumerate(FINGER_NAMES):
        parts += _finger(hand, i, finger)
    # Palm and first bones touch one another in every posture.
    first = ["palm"] + [
        f"{finger}_{link}" for finger in FINGER_NAMES for link in ("knuckle", _links(finger)[0])
    ]
    members = "".join(f"<drake:member>{link}</drake:member>" for link in first)
    group = (
        f'<drake:collision_filter_group name="palm_and_first_bones">{members}'
        "<drake:ignored_collision_filter_group>palm_and_first_bones</drake:ignored_collision_filter_group>"
        "</drake:collision_filter_group>"
    )
    body = "\n".join(["\n".join("    " + line for line in part) for part in parts] + ["    " + group])
    return (
        f'{_HEADER}<sdf version="1.11" xmlns:drake="http://drake.mit.edu">\n'
        f'  <model name="{name}">\n{body}\n  </model>\n</sdf>\n'
    )


def _palm(hand: HumanHand) -> list[str]:
    knuckles = hand.p_HB[1:]
    width = np.ptp(knuckles[:, 1]) + 2 * _METACARPAL_RADIUS
    length = knuckles[:, 2].mean()
    size = np.array([_PALM_THICKNESS, width, length])
    mass = _DENSITY * size.prod()
    centre = [0.0, knuckles[:, 1].mean(), length / 2]
    inertia = mass / 12 * (np.sum(size**2) - size**2)
    lines = ['<link name="palm">', _inertial(mass, centre, inertia)]
    for finger, p_HB in zip(FINGER_NAMES[1:], knuckles, strict=True):
        # Metacarpals fan out from the wrist, whose bones lie a sixth of the way to the knuckles.
        start = np.array([p_HB[0], 0.45 * p_HB[1], p_HB[2] / 6])
        axis = p_HB - start
        turn, _ = Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])
        pose = _pose((start + p_HB) / 2, turn)
        lines += _geometry(f"{finger}_metacarpal", pose, _METACARPAL_RADIUS, float(np.linalg.norm(axis)))
    return [*lines, "</link>", _frame("wrist", "palm", _pose(np.zeros(3)))]


def _finger(hand: HumanHand, i: int, finger: str) -> list[list[str]]:
    links, names = _links(finger), hand.joint_names[4 * i : 4 * i + 4]
    abduction, flexion, *hinges = names
    knuckle = f"{finger}_knuckle"
    base = _pose(hand.p_HB[i], Rotation.from_matrix(hand.R_HB[i]))
    mass = _DENSITY * 4 / 3 * np.pi * _KNUCKLE_RADIUS**3
    sphere = 0.4 * mass * _KNUCKLE_RADIUS**2 * np.ones(3)
    parts = [
        [
            f'<link name="{knuckle}">',
            f'<pose relative_to="palm">{base}</pose>',
            _inertial(mass, [0, 0, 0], sphere),
            "</link>",
            _joint(hand, flexion, "palm", knuckle, "0 1 0"),
        ]
    ]
    # Where each link begins in its parent.
    origins = [
        (knuckle, _pose(np.zeros(3))),
        (f"{finger}_{links[0]}", _pose([0, 0, hand.lengths[i, 0]], Rotation.from_euler("z", hand.twist[i]))),
        (f"{finger}_{links[1]}", _pose([0, 0, hand.lengths[i, 1]])),
    ]
    joints = [(abduction, "-1 0 0"), (hinges[0], "0 1 0"), (hinges[1], "0 1 0")]
    for k, ((parent, pose), (joint, axis)) in enumerate(zip(origins, joints, strict=True)):
        link, radius, bone = f"{finger}_{links[k]}", _RADII[i, k], hand.lengths[i, k]
        # The last capsule ends with its rounded cap at the tip.
        length = bone - radius if k == 2 else bone
        parts.append(
            [
                f'<link name="{link}">',
                f'<pose relative_to="{parent}">{pose}</pose>',
                _inertial(*_capsule(radius, length)),
                *_geometry(link, _pose([0, 0, length / 2]), radius, length),
                "</link>",
                _joint(hand, joint, parent, link, axis),
                _frame(f"{finger}_{_frames(finger)[k]}", link, _pose(np.zeros(3))),
            ]
        )
    parts[-1].append(_frame(f"{finger}_tip", f"{finger}_{links[2]}", _pose([0, 0, hand.lengths[i, 2]])))
    return parts


def _capsule(radius: float, length: float) -> tuple[float, list[float], np.ndarray]:
    """Mass, centre and principal inertia of a solid capsule standing on the origin along z."""
    rod, caps = _DENSITY * np.pi * radius**2 * length, _DENSITY * 4 / 3 * np.pi * radius**3
    # Each half ball's centre of mass is 3/8 r beyond the end of the rod.
    across = rod * (3 * radius**2 + length**2) / 12 + caps * (
        0.4 * radius**2 + length**2 / 4 + 3 / 8 * radius * length
    )
    along = rod * radius**2 / 2 + caps * 0.4 * radius**2
    return rod + caps, [0.0, 0.0, length / 2], np.array([across, across, along])


def _joint(hand: HumanHand, name: str, parent: str, child: str, axis: str) -> str:
    j = hand.joint_names.index(name)
    return (
        f'<joint name="{name}" type="revolute"><parent>{parent}</parent><child>{child}</child>'
        f"<axis><xyz>{axis}</xyz><limit><lower>{hand.lower[j]:.9g}</lower><upper>{hand.upper[j]:.9g}</upper>"
        "<effort>2</effort></limit><dynamics><damping>0.02</damping></dynamics></axis></joint>"
    )


def _geometry(name: str, pose: str, radius: float, length: float) -> list[str]:
    shape = (
        f"<geometry><capsule><radius>{radius:.9g}</radius><length>{length:.9g}</length></capsule></geometry>"
    )
    return [
        f'<visual name="{name}"><pose>{pose}</pose>{shape}'
        f"<material><diffuse>{_SKIN}</diffuse></material></visual>",
        f'<collision name="{name}"><pose>{pose}</pose>{shape}</collision>',
    ]


def _inertial(mass: float, centre: Iterable[float], inertia: np.ndarray) -> str:
    ixx, iyy, izz = inertia
    return (
        f"<inertial><pose>{_numbers(centre)} 0 0 0</pose><mass>{mass:.6g}</mass><inertia><ixx>{ixx:.6g}</ixx>"
        f"<ixy>0</ixy><ixz>0</ixz><iyy>{iyy:.6g}</iyy><iyz>0</iyz><izz>{izz:.6g}</izz></inertia></inertial>"
    )


def _frame(name: str, link: str, pose: str) -> str:
    return f'<frame name="{name}" attached_to="{link}"><pose>{pose}</pose></frame>'


def _pose(p: Iterable[float], turn: Rotation | None = None) -> str:
    rpy = np.zeros(3) if turn is None else turn.as_euler("xyz")
    return f"{_numbers(p)} {_numbers(rpy)}"


def _numbers(values: Iterable[float]) -> str:
    # Rounded far below a micrometre, so that the text does not depend on the last bits of arithmetic.
    return " ".join(f"{round(float(value), 10) + 0.0:.9g}" for value in values)


def _links(finger: str) -> tuple[str, str, str]:
    return _LINKS.get(finger, ("proximal", "middle", "distal"))


def _frames(finger: str) -> tuple[str, str, str, str]:
    return _FRAMES.get(finger, ("mcp", "pip", "dip", "tip"))


if __name__ == "__main__":
    sys.stdout.write(human_hand_sdf(HumanHand.anatomical(), "human_right"))

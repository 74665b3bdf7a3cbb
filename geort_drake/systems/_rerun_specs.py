"""What else a recorder is asked for, beside the bodies of a plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import OutputPort
from pydrake.systems.sensors import RgbdSensor

from geort_drake.systems._rerun_tracks import Color


@dataclass(frozen=True)
class SignalSpec:
    """A vector output port as one time series per element.

    Attributes:
        port: vector output port of any system of the diagram.
        names: one name per element. A slash opens a level of the tree, and the series that share
            it share a plot: "index/joint_0".
        label: what the legend adds to each name, such as "command".
        faint: drawn thin and pale, for what another signal is compared with.
    """

    port: OutputPort
    names: Sequence[str]
    label: str = ""
    faint: bool = False


@dataclass(frozen=True)
class HandSpec:
    """A human hand as a glove and a tracker give it.

    Attributes:
        keypoints_port: 63 numbers, p_HK, keypoint-major, m.
        wrist_pose_port: abstract `RigidTransform`, X_OH in the tracker's frame O.
        valid_port: size 1; the hand is drawn where it is over 0.5. Without it, always.
        color: red, green, blue, 0–255.
        X_WO: pose of the tracker's frame in the world, to place the hand beside the robot.
    """

    keypoints_port: OutputPort
    wrist_pose_port: OutputPort
    valid_port: OutputPort | None = None
    color: Color = (224, 172, 138)
    X_WO: RigidTransform = field(default_factory=RigidTransform)


@dataclass(frozen=True)
class PointsSpec:
    """A vector output port of 3k coordinates as k small spheres; points with a NaN are not drawn.

    Attributes:
        port: vector output port, point-major, m.
        frame: frame of the plant that the coordinates are measured in; the world by default.
        radius: m.
        color: red, green, blue, 0–255.
    """

    port: OutputPort
    frame: Frame | None = None
    radius: float = 0.006
    color: Color = (255, 80, 200)


@dataclass(frozen=True)
class StateSpec:
    """A port of size 1 that holds an integer code, as a lane of named states.

    Attributes:
        port: vector output port of size 1.
        labels: names of the codes 0, 1, ..., or a mapping from code to name.
    """

    port: OutputPort
    labels: Sequence[str] | Mapping[int, str]


@dataclass(frozen=True)
class ContactSpec:
    """How contact forces are shown.

    Attributes:
        groups: bodies whose contact forces are summed to one time series each, such as the links
            of a finger: {"thumb": [link_12, ...]}. By default every moving body that was touched.
        metres_per_newton: length of the arrows.
        max_length: longer arrows are cut to this, m.
    """

    groups: Mapping[str, Sequence[RigidBody]] | None = None
    metres_per_newton: float = 0.02
    max_length: float = 0.25


@dataclass(frozen=True)
class CameraSpec:
    """Colour pictures of a camera of the diagram, and where it looks.

    Attributes:
        sensor: its colour image is rendered for each picture, which takes far longer than all the rest.
        period: between pictures, s; not less than the recorder's.
    """

    sensor: RgbdSensor
    period: float = 0.1

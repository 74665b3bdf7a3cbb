"""Specifications of data that a recorder adds to the bodies of a plant."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import OutputPort
from pydrake.systems.sensors import RgbdSensor

from geort_drake.colours import SKIN, Color

# Maps the values (T, m) of ports at T times to the recorded values (T, n).
Derive = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class SignalSpec:
    """Records a vector output port as time series, one per element.

    Attributes:
        port: vector output port of any system of the diagram, or several, whose values are concatenated.
        names: one per element. Elements that share the part before the last slash share a plot:
            "index/joint_0".
        label: added to each name in the plot, such as "command".
        faint: drawn thin and pale.
        title: of the plot; by default the part of the names before the slash. Signals with the same title
            and unit share a plot.
        unit: added to the title.
        page: the tab that holds the plot.
        limits: lowest and highest value of the plot; by default those of the data.
        colors: one per element; by default a palette.
        derive: computes the elements from the ports' values when the recording is written.
    """

    port: OutputPort | Sequence[OutputPort]
    names: Sequence[str]
    label: str = ""
    faint: bool = False
    title: str = ""
    unit: str = ""
    page: str = ""
    limits: tuple[float, float] | None = None
    colors: Sequence[Color] | None = None
    derive: Derive | None = None


@dataclass(frozen=True)
class HandSpec:
    """Records a human hand as measured by a glove and a tracker.

    Attributes:
        keypoints_port: 63 numbers, p_HK, keypoint-major, m.
        wrist_pose_port: abstract `RigidTransform`, X_OH in the tracker's frame O.
        valid_port: size 1; the hand is drawn where the value exceeds 0.5. Without the port, always.
        color: of the skin.
        X_WO: pose of the tracker's frame in the world.
    """

    keypoints_port: OutputPort
    wrist_pose_port: OutputPort
    valid_port: OutputPort | None = None
    color: Color = SKIN
    X_WO: RigidTransform = field(default_factory=RigidTransform)


@dataclass(frozen=True)
class PointsSpec:
    """Records a vector output port of 3k coordinates as k spheres; points with a NaN are not drawn.

    Attributes:
        port: vector output port, point-major, m.
        frame: frame of the plant in which the coordinates are measured; by default the world.
        radius: m.
        color: one for all points, or one per point; an opacity below 255 makes them translucent.
        trail: how much of the past is shown, s; `math.inf` for all of it.
        start: time of the first valid value, s.
        derive: computes coordinates from the port's values; see `SignalSpec`.
    """

    port: OutputPort
    frame: Frame | None = None
    radius: float = 0.006
    color: Color | Sequence[Color] = (255, 80, 200)
    trail: float = 0.0
    start: float = 0.0
    derive: Derive | None = None


@dataclass(frozen=True)
class StateSpec:
    """Records a port of size 1 with an integer code as a lane of named states.

    Attributes:
        port: vector output port of size 1.
        labels: names of the codes 0, 1, ..., or a mapping from code to name.
    """

    port: OutputPort
    labels: Sequence[str] | Mapping[int, str]


@dataclass(frozen=True)
class ContactSpec:
    """Options for recording contact forces.

    Attributes:
        groups: bodies whose contact forces are summed to one time series each, such as the links of a
            finger: {"thumb": [link_12, ...]}. By default each moving body that is touched.
        metres_per_newton: length of the arrows.
        max_length: longer arrows are cut to this length, m.
    """

    groups: Mapping[str, Sequence[RigidBody]] | None = None
    metres_per_newton: float = 0.02
    max_length: float = 0.25


@dataclass(frozen=True)
class CloseUpSpec:
    """An additional view of the scene that follows a frame.

    Attributes:
        follows: frame F of the plant; or the key of a human hand, which the view shows alone, with the
            wrist frame H as F.
        eye, target: eye point and target point, m, in F.
        see_through: bodies that this view shows translucent.
    """

    follows: Frame | str
    eye: Sequence[float] | np.ndarray
    target: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    see_through: Sequence[RigidBody] = ()


@dataclass(frozen=True)
class CameraSpec:
    """Records the colour images and the pose of a camera in the diagram.

    Attributes:
        sensor: rendered for each image, which takes far longer than everything else.
        period: between images, s; at least the recorder's.
    """

    sensor: RgbdSensor
    period: float = 0.1

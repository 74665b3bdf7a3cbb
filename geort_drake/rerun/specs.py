"""What else a recorder is asked for, beside the bodies of a plant."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import OutputPort
from pydrake.systems.sensors import RgbdSensor

from geort_drake.colours import SKIN, Color

# From the values (T, m) of ports at several times to what is recorded of them (T, n).
Derive = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class SignalSpec:
    """A vector output port as one time series per element.

    Attributes:
        port: vector output port of any system of the diagram; or several, whose values follow each other.
        names: one name per element. A slash opens a level of the tree, and the series that share
            it share a plot: "index/joint_0".
        label: what the legend adds to each name, such as "command".
        faint: drawn thin and pale, for what another signal is compared with.
        title: of the plot; by default what stands before the slash. Signals share a plot by title and unit.
        unit: what the title of the plot gives in brackets.
        page: the tab that its plots stand on; pages lie on top of each other.
        legend: whether the plot has one; without it, pointing at a line tells its name.
        limits: lowest and highest value of the plot; by default those of the data.
        colors: one per element; by default a palette.
        derive: makes the elements of the ports' values, when they are written: what is computed there does
            not burden the simulation, and a port is read once for all that is derived from it.
    """

    port: OutputPort | Sequence[OutputPort]
    names: Sequence[str]
    label: str = ""
    faint: bool = False
    title: str = ""
    unit: str = ""
    page: str = ""
    legend: bool = False
    limits: tuple[float, float] | None = None
    colors: Sequence[Color] | None = None
    derive: Derive | None = None


@dataclass(frozen=True)
class HandSpec:
    """A human hand as a glove and a tracker give it; its tips have the colours of the fingers.

    Attributes:
        keypoints_port: 63 numbers, p_HK, keypoint-major, m.
        wrist_pose_port: abstract `RigidTransform`, X_OH in the tracker's frame O.
        valid_port: size 1; the hand is drawn where it is over 0.5. Without it, always.
        color: of the skin.
        X_WO: pose of the tracker's frame in the world, to place the hand beside the robot.
    """

    keypoints_port: OutputPort
    wrist_pose_port: OutputPort
    valid_port: OutputPort | None = None
    color: Color = SKIN
    X_WO: RigidTransform = field(default_factory=RigidTransform)


@dataclass(frozen=True)
class PointsSpec:
    """A vector output port of 3k coordinates as k small spheres; points with a NaN are not drawn.

    Attributes:
        port: vector output port, point-major, m.
        frame: frame of the plant that the coordinates are measured in; the world by default.
        radius: m.
        color: of all, or one for each point; with an opacity under 255 one sees through them.
        trail: how much of the past is shown with the present, s; `math.inf` for all of it.
        start: from when on the port holds points, s.
        derive: makes coordinates of the port's values, when they are written; see `SignalSpec`.
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
class CloseUpSpec:
    """One more view of the scene, which moves and turns with a frame.

    Attributes:
        follows: frame F of the plant; or the entity path of a human hand, which is shown alone then, and
            whose wrist frame H is F.
        eye, target: where the eye stands and what it looks at, m, in F.
        see_through: bodies that this view shows as of glass, such as what a hand holds.
    """

    follows: Frame | str
    eye: Sequence[float] | np.ndarray
    target: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    see_through: Sequence[RigidBody] = ()


@dataclass(frozen=True)
class CameraSpec:
    """Colour pictures of a camera of the diagram, and where it looks.

    Attributes:
        sensor: its colour image is rendered for each picture, which takes far longer than all the rest.
        period: between pictures, s; not less than the recorder's.
    """

    sensor: RgbdSensor
    period: float = 0.1

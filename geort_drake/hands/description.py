"""The facts about a robot hand that its model does not hold: fingers, fingertip points, human partners."""

import dataclasses as dc
import os
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_load_typed

from geort_drake.errors import HandError, UnknownNameError
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import SIDES
from geort_drake.resources import PACKAGE_NAME, models_dir


@dc.dataclass
class FingerDescription:
    """One finger of a robot hand."""

    # One of thumb, index, middle, ring, little.
    name: str = ""
    # The human keypoint (0 to 20) that this fingertip follows.
    human_keypoint: int = 0
    # The finger's joints by name, base to tip.
    joints: list[str] = dc.field(default_factory=list)
    # The link that carries the fingertip.
    tip_link: str = ""
    # The fingertip point in the frame of `tip_link`, m.
    tip_point: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    # Radius of the sphere around the fingertip point that touches things, m.
    tip_radius: float = 0.0


@dc.dataclass
class MountDescription:
    """How a hand sits on the arm, or the adapter, that carries it."""

    # Frame or link of the model that meets the carrier, and counts as the hand's wrist; empty: the hand base.
    frame: str = ""
    # Its pose in the carrier's frame, whose z axis points at the hand: m, and roll, pitch, yaw in degrees.
    translation: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy_deg: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])


@dc.dataclass
class BasePoseDescription:
    """The pose of the hand base B, for a model that has no frame of its own there."""

    # Frame or link of the model that B is fixed to; empty: `base_frame` is a frame of the model.
    relative_to: str = ""
    # Its pose in that frame: m, and roll, pitch, yaw in degrees.
    translation: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy_deg: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])


@dc.dataclass
class CouplingDescription:
    """A joint that has no motor of its own: its angle is `ratio` times that of another plus `offset`."""

    # The joint that follows.
    joint: str = ""
    # The joint that it follows, which a finger lists or which itself follows one.
    follows: str = ""
    ratio: float = 1.0
    # rad.
    offset: float = 0.0


@dc.dataclass
class ActuationDescription:
    """PD gains for every joint that a finger lists; 0: those of the model."""

    # N·m/rad, N·m·s/rad, and N·m; without an effort limit the model's is kept.
    stiffness: float = 0.0
    damping: float = 0.0
    effort_limit: float = 0.0


@dc.dataclass
class HandDescription:
    """A robot hand: which model it is and how its parts relate to a human hand.

    `q` of the hand is always in the order of `joint_names`: finger by finger as listed, base to tip.
    """

    name: str = ""
    # SDF, URDF or MJCF file: package://geort_drake/..., an absolute path, or one relative to the description.
    model: str = ""
    # The side of the hand, right or left.
    side: str = "right"
    # Frame or link of the model that is the hand base B: +x out of the palm, +z along the fingers, and so
    # +y towards the index side of a right hand and the ring side of a left one.
    base_frame: str = ""
    # Where that frame is, if the model has none of the name.
    base_pose: BasePoseDescription = dc.field(default_factory=BasePoseDescription)
    # In the order thumb, index, middle, ring, little; fingers that the hand lacks are left out.
    fingers: list[FingerDescription] = dc.field(default_factory=list)
    # Where the joints start, by name, rad. Joints that are not listed start at the model's default, 0.
    # A joint that no finger lists and that follows none is held there.
    default_positions: dict[str, float] = dc.field(default_factory=dict)
    # Joints that follow others; they are not listed with the fingers.
    couplings: list[CouplingDescription] = dc.field(default_factory=list)
    # Pairs of links whose contact does not count, because it is there in every posture.
    ignored_collisions: list[list[str]] = dc.field(default_factory=list)
    actuation: ActuationDescription = dc.field(default_factory=ActuationDescription)
    mount: MountDescription = dc.field(default_factory=MountDescription)
    # Settings of training that suit this hand better than a method's defaults: method, name, number.
    training: dict[str, dict[str, float]] = dc.field(default_factory=dict)

    @property
    def joint_names(self) -> list[str]:
        """The joints that fingers list, in the order of q."""
        return [joint for finger in self.fingers for joint in finger.joints]

    @property
    def finger_names(self) -> list[str]:
        """In the order of fingertips."""
        return [finger.name for finger in self.fingers]

    @property
    def human_keypoints(self) -> list[int]:
        """The human keypoint that each fingertip follows, likewise."""
        return [finger.human_keypoint for finger in self.fingers]

    def validate(self) -> None:
        """Checks what can be checked without the model.

        Raises:
            HandError: a field is missing or wrong; names hand, field, what was wanted and what was given.
        """
        for field in ("name", "model", "base_frame"):
            self._require(getattr(self, field), field, "given", "nothing")
        self._require(self.side in SIDES, "side", f"one of {', '.join(SIDES)}", f"'{self.side}'")
        self._require(self.fingers, "fingers", "a list of at least one finger", "none")
        for number, finger in enumerate(self.fingers):
            self._validate_finger(finger, f"fingers[{number}]")
        names = self.finger_names
        ordered = [name for name in FINGER_NAMES if name in names]
        self._require(names == ordered, "fingers", f"each at most once, as {', '.join(FINGER_NAMES)}", names)
        joints = self.joint_names
        twice = sorted({joint for joint in joints if joints.count(joint) > 1})
        self._require(not twice, "fingers", "every joint once", f"twice: {', '.join(twice)}")
        for joint, position in self.default_positions.items():
            self._require(np.isfinite(position), f"default_positions.{joint}", "finite", position)
        for place in ("mount", "base_pose"):
            for field in ("translation", "rpy_deg"):
                value = getattr(getattr(self, place), field)
                good = len(value) == 3 and np.isfinite(value).all()
                self._require(good, f"{place}.{field}", "three finite numbers", value)
        for field in ("stiffness", "damping", "effort_limit"):
            value = getattr(self.actuation, field)
            self._require(np.isfinite(value) and value >= 0, f"actuation.{field}", "at least 0", value)
        for number, pair in enumerate(self.ignored_collisions):
            good = len(pair) == 2 and pair[0] != pair[1]
            self._require(good, f"ignored_collisions[{number}]", "the names of two links", pair)
        self._validate_couplings()

    def _validate_couplings(self) -> None:
        leaders = {coupling.joint: coupling.follows for coupling in self.couplings}
        twice = len(self.couplings) - len(leaders)
        self._require(not twice, "couplings", "one for each joint that follows", f"{twice} too many")
        for number, coupling in enumerate(self.couplings):
            where = f"couplings[{number}]"
            self._require(coupling.joint and coupling.follows, where, "of two joints", "a name is missing")
            listed = coupling.joint in self.joint_names
            self._require(not listed, f"{where}.joint", "listed with no finger", f"'{coupling.joint}'")
            good = np.isfinite(coupling.ratio) and coupling.ratio != 0
            self._require(good, f"{where}.ratio", "finite and not 0", coupling.ratio)
            self._require(np.isfinite(coupling.offset), f"{where}.offset", "finite", coupling.offset)
            seen, leader = {coupling.joint}, coupling.follows
            while leader in leaders and leader not in seen:
                seen.add(leader)
                leader = leaders[leader]
            self._require(leader not in seen, where, "free of circles", f"'{coupling.joint}' follows itself")

    def _validate_finger(self, finger: FingerDescription, where: str) -> None:
        self._require(
            finger.name in FINGER_NAMES,
            f"{where}.name",
            f"one of {', '.join(FINGER_NAMES)}",
            f"'{finger.name}'",
        )
        self._require(
            0 < finger.human_keypoint <= 20, f"{where}.human_keypoint", "from 1 to 20", finger.human_keypoint
        )
        self._require(finger.joints, f"{where}.joints", "a list of joint names", "none")
        self._require(finger.tip_link, f"{where}.tip_link", "the name of a link", "nothing")
        self._require(
            len(finger.tip_point) == 3 and np.isfinite(finger.tip_point).all(),
            f"{where}.tip_point",
            "three finite coordinates in m",
            finger.tip_point,
        )
        self._require(
            np.isfinite(finger.tip_radius) and finger.tip_radius > 0,
            f"{where}.tip_radius",
            "positive, in m",
            finger.tip_radius,
        )

    def _require(self, condition: object, field: str, wanted: str, given: object) -> None:
        if not condition:
            raise HandError(f"hand '{self.name}': {field} must be {wanted}; given: {given}")


def hand_names() -> list[str]:
    """Names of the hands in models/hands: those that come with the package, and those added to them."""
    return sorted(path.stem for path in (models_dir() / "hands").glob("*.yaml"))


def load_hand(name_or_path: str | os.PathLike) -> HandDescription:
    """Loads a hand description: by name one of `hand_names()`, by path any `.yaml` file.

    Raises:
        UnknownNameError: no hand has that name.
        HandError: the file is missing, malformed or inconsistent.
    """
    text = os.fspath(name_or_path)
    if text in hand_names():
        path = models_dir() / "hands" / f"{text}.yaml"
    elif Path(text).suffix in (".yaml", ".yml") or os.sep in text:
        path = Path(text)
    else:
        raise UnknownNameError("hand", text, hand_names())
    if not path.is_file():
        raise HandError(f"the hand description {path} is missing")
    try:
        hand = yaml_load_typed(schema=HandDescription, filename=str(path))
    except Exception as error:  # the loader raises RuntimeError, YAMLError, TypeError, ValueError, ...
        raise HandError(f"the hand description {path} is malformed: {error}") from error
    try:
        hand.validate()
    except HandError as error:
        raise HandError(f"{path}: {error}") from error
    if not hand.model.startswith(f"package://{PACKAGE_NAME}/"):
        hand.model = str(path.resolve().parent / hand.model)  # an absolute model path replaces the parent
    return hand

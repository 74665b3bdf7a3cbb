"""The description of a robot hand: its model file, fingers, hand base, couplings and mount."""

import copy
import dataclasses as dc
import functools
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from geort_drake.errors import HandError, UnknownNameError, naming
from geort_drake.files import write_text
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import SIDES
from geort_drake.resources import hand_names, models_dir
from geort_drake.settings import check_fields, fault_of


@dc.dataclass
class FingerDescription:
    """One finger of a robot hand."""

    # thumb, index, middle, ring or little.
    name: str = ""
    # The human keypoint (0 to 20) that this fingertip follows.
    human_keypoint: int = 0
    # Names of the finger's joints, base to tip.
    joints: list[str] = dc.field(default_factory=list)
    # The link that carries the fingertip.
    tip_link: str = ""
    # The fingertip point in the frame of `tip_link`, m.
    tip_point: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    # Radius of the contact sphere around the fingertip point, m.
    tip_radius: float = 0.0


@dc.dataclass
class MountDescription:
    """The pose of a hand on the arm or adapter that carries it."""

    # Frame or link of the model that is attached to the carrier; also the wrist. Empty: the hand base.
    frame: str = ""
    # Pose in the carrier's frame, whose z axis points to the hand: m, and roll, pitch, yaw in degrees.
    translation: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy_deg: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])


@dc.dataclass
class BasePoseDescription:
    """The pose of the hand base B, for a model that has no such frame."""

    # Frame or link of the model to which B is fixed. Empty: `base_frame` is a frame of the model.
    relative_to: str = ""
    # Pose of B in that frame: m, and roll, pitch, yaw in degrees.
    translation: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy_deg: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])


@dc.dataclass
class CouplingDescription:
    """A joint without a motor: its angle is `ratio` times the angle of another joint plus `offset`."""

    # The follower.
    joint: str = ""
    # The leader: a joint that a finger lists, or another follower.
    follows: str = ""
    ratio: float = 1.0
    # Angle of the follower where the leader's is 0, rad.
    offset: float = 0.0


@dc.dataclass
class ActuationDescription:
    """PD gains of every joint that a finger lists."""

    # N·m/rad, N·m·s/rad and N·m. Stiffness 0 keeps all of the model's, effort limit 0 the model's limit.
    stiffness: float = 0.0
    damping: float = 0.0
    effort_limit: float = 0.0


@dc.dataclass
class SourceDescription:
    """Where a model is published that does not come with this package."""

    # The command that gets it.
    get: str = ""
    # Package and version, or repository and commit.
    published: str = ""
    # The licence of the model.
    licence: str = ""
    # SHA-256 of the model's file and those that it includes; another one causes a warning.
    sha256: str = ""
    # Other places of the same model, as in `HandDescription.model`.
    also: list[str] = dc.field(default_factory=list)


@dc.dataclass
class HandDescription:
    """A robot hand: its model, and how its parts correspond to a human hand's.

    Joint positions q are in the order of `joint_names`: finger by finger as listed, base to tip.
    """

    name: str = ""
    # SDF, URDF or MJCF file: an absolute path, one relative to the description, or package://NAME/FILE in an
    # installed package or a folder of GEORT_DRAKE_MODELS.
    model: str = ""
    source: SourceDescription = dc.field(default_factory=SourceDescription)
    # The side of the hand, right or left.
    side: str = "right"
    # Frame or link of the model that is the hand base B: +x out of the palm, +z along the fingers, and so
    # +y towards the index side of a right hand and the ring side of a left one.
    base_frame: str = ""
    # The pose of that frame, if the model has no frame of this name.
    base_pose: BasePoseDescription = dc.field(default_factory=BasePoseDescription)
    # In the order thumb, index, middle, ring, little, without missing fingers.
    fingers: list[FingerDescription] = dc.field(default_factory=list)
    # The joints in the order of the manufacturer's software, held ones too; empty if it is that of q.
    motor_order: list[str] = dc.field(default_factory=list)
    # Initial joint positions by name, rad; by default the model's. A joint that no finger lists and that
    # follows no other is held there.
    default_positions: dict[str, float] = dc.field(default_factory=dict)
    # Joints that follow others; fingers do not list them.
    couplings: list[CouplingDescription] = dc.field(default_factory=list)
    # Links without collision geometry that collide as they are drawn, a mesh as its convex hull.
    collide_as_drawn: list[str] = dc.field(default_factory=list)
    # Pairs of links whose contacts are ignored, because they touch in every posture.
    ignored_collisions: list[list[str]] = dc.field(default_factory=list)
    actuation: ActuationDescription = dc.field(default_factory=ActuationDescription)
    mount: MountDescription = dc.field(default_factory=MountDescription)

    @property
    def joint_names(self) -> list[str]:
        """The joints that fingers list, in the order of q."""
        return [joint for finger in self.fingers for joint in finger.joints]

    @property
    def finger_names(self) -> list[str]:
        """Names of the fingers, in the order of fingertips."""
        return [finger.name for finger in self.fingers]

    @property
    def human_keypoints(self) -> list[int]:
        """The human keypoint that each fingertip follows, in the order of fingertips."""
        return [finger.human_keypoint for finger in self.fingers]

    @property
    def followers(self) -> list[CouplingDescription]:
        """The joints that follow those of fingers, directly or through others, each with its first leader."""
        return [c for c in resolved_couplings(self.couplings) if c.follows in self.joint_names]

    def validate(self) -> None:
        """Checks everything that can be checked without the model.

        Raises:
            HandError: a field is missing or wrong; names hand, field, expected and given values.
        """
        for fits, field, expected, value in self._requirements():
            if not fits:
                raise HandError(f"hand '{self.name}': {field} must be {expected}; given: {value}")
        resolved_couplings(self.couplings)

    def _requirements(self) -> Iterator[tuple[object, str, str, object]]:
        """Yields conditions, and of each its field, what is expected, and what is given."""
        for field in ("name", "model", "base_frame"):
            yield getattr(self, field), field, "given", "nothing"
        yield self.side in SIDES, "side", f"one of {', '.join(SIDES)}", f"'{self.side}'"
        yield self.fingers, "fingers", "a list of at least one finger", "none"
        known = ", ".join(FINGER_NAMES)
        for number, finger in enumerate(self.fingers):
            where, radius, keypoint = f"fingers[{number}]", finger.tip_radius, finger.human_keypoint
            yield finger.name in FINGER_NAMES, f"{where}.name", f"one of {known}", f"'{finger.name}'"
            yield 0 < keypoint <= 20, f"{where}.human_keypoint", "from 1 to 20", keypoint
            yield finger.joints, f"{where}.joints", "a list of joint names", "none"
            yield finger.tip_link, f"{where}.tip_link", "the name of a link", "nothing"
            good = _is_vector(finger.tip_point)
            yield good, f"{where}.tip_point", "three finite coordinates in m", finger.tip_point
            yield np.isfinite(radius) and radius > 0, f"{where}.tip_radius", "positive, in m", radius
        names = self.finger_names
        ordered = [name for name in FINGER_NAMES if name in names]
        yield names == ordered, "fingers", f"each at most once, as {known}", names
        joints = self.joint_names
        twice = sorted({joint for joint in joints if joints.count(joint) > 1})
        yield not twice, "fingers", "every joint once", f"twice: {', '.join(twice)}"
        order = self.motor_order
        complete = {*joints} <= {*order} and len({*order}) == len(order)
        yield not order or complete, "motor_order", f"each of {', '.join(joints)} once", order
        for joint, position in self.default_positions.items():
            yield np.isfinite(position), f"default_positions.{joint}", "finite", position
        for place, pose in (("mount", self.mount), ("base_pose", self.base_pose)):
            for field, value in (("translation", pose.translation), ("rpy_deg", pose.rpy_deg)):
                yield _is_vector(value), f"{place}.{field}", "three finite numbers", value
        for field, value in dc.asdict(self.actuation).items():
            yield np.isfinite(value) and value >= 0, f"actuation.{field}", "at least 0", value
        for number, pair in enumerate(self.ignored_collisions):
            good = len(pair) == 2 and pair[0] != pair[1]
            yield good, f"ignored_collisions[{number}]", "the names of two links", pair
        surplus = len(self.couplings) - len({coupling.joint for coupling in self.couplings})
        yield not surplus, "couplings", "one for each joint that follows", f"{surplus} too many"
        for number, c in enumerate(self.couplings):
            where, owner = f"couplings[{number}]", f" of '{c.joint}'"
            yield c.joint and c.follows, f"{where}{owner}", "of two joints", "a name is missing"
            yield c.joint not in joints, f"{where}.joint{owner}", "listed with no finger", f"'{c.joint}'"
            yield np.isfinite(c.ratio) and c.ratio != 0, f"{where}.ratio{owner}", "finite and not 0", c.ratio
            yield np.isfinite(c.offset), f"{where}.offset{owner}", "finite", c.offset


def _is_vector(value: list[float]) -> bool:
    return len(value) == 3 and bool(np.isfinite(value).all())


def resolved_couplings(couplings: list[CouplingDescription]) -> list[CouplingDescription]:
    """Returns the same couplings, each to the first leader of its chain of followers.

    Raises:
        HandError: a joint follows itself.
    """
    by_name = {coupling.joint: coupling for coupling in couplings}

    def resolve(coupling: CouplingDescription, chain: set[str]) -> CouplingDescription:
        if coupling.joint in chain:
            raise HandError(f"couplings must be free of cycles; given: '{coupling.joint}' follows itself")
        if coupling.follows not in by_name:
            return coupling
        leader = resolve(by_name[coupling.follows], chain | {coupling.joint})
        offset = coupling.ratio * leader.offset + coupling.offset
        return CouplingDescription(coupling.joint, leader.follows, coupling.ratio * leader.ratio, offset)

    return [resolve(coupling, set()) for coupling in couplings]


class JointCouplings:
    """The K followers of a hand, with angles ratio · q + offset.

    Attributes:
        names: the K joint names.
        ratio: (K, n) factors on q.
        offset: (K,) constant angles, rad.
    """

    def __init__(self, description: HandDescription):
        followers, joints = description.followers, description.joint_names
        self.names = [coupling.joint for coupling in followers]
        self.ratio = np.zeros((len(followers), len(joints)))
        for row, coupling in zip(self.ratio, followers, strict=True):
            row[joints.index(coupling.follows)] = coupling.ratio
        self.offset = np.array([coupling.offset for coupling in followers], float)

    def with_followers(self, q: np.ndarray) -> np.ndarray:
        """Returns (N, n + K) angles: q (N, n), then those of the followers, rad."""
        return np.hstack([q, q @ self.ratio.T + self.offset]) if self.names else q


def load_hand(name_or_path: str | os.PathLike | HandDescription) -> HandDescription:
    """Loads a hand description by its name or by the path of a `.yaml` file.

    A description is returned unchanged.

    Raises:
        UnknownNameError: no hand has that name.
        HandError: the file is missing, malformed or inconsistent.
    """
    if isinstance(name_or_path, HandDescription):
        return name_or_path
    text = os.fspath(name_or_path)
    if text in hand_names():
        path = models_dir() / "hands" / f"{text}.yaml"
    elif Path(text).suffix in (".yaml", ".yml") or os.sep in text:
        path = Path(text)
    elif Path(text).is_file():
        raise HandError(f"{text}: a hand is described in .yaml; geort-drake hand add describes a model")
    else:
        raise UnknownNameError("hand", text, hand_names())
    if not path.is_file():
        raise HandError(f"the hand description {path} is missing")
    try:
        hand = copy.deepcopy(_parse(path.read_text(encoding="utf-8")))
    except Exception as error:  # the loader raises RuntimeError, YAMLError, TypeError, ValueError, ...
        raise HandError(f"the hand description {path} is malformed: {fault_of(error)}") from error
    with naming(path, HandError):
        hand.validate()
    if not hand.model.startswith("package://"):
        hand.model = str(path.resolve().parent / hand.model)  # an absolute model path replaces the parent
    return hand


@functools.lru_cache(maxsize=32)  # parsing takes 8 ms, and a trial asks for its hand in several places
def _parse(text: str) -> HandDescription:
    check_fields(yaml.compose(text, Loader=yaml.SafeLoader), HandDescription)
    return yaml_load_typed(schema=HandDescription, data=text)


def write_description(description: HandDescription, path: Path, comments: Iterable[str] = ()) -> None:
    """Writes a description as YAML, atomically, without the fields that have their default values.

    A model below the folder of the description is stored with its relative path.

    Args:
        description: the hand.
        path: path of the file.
        comments: comment lines at the beginning of the file.
    """
    model = Path(description.model)
    folder = path.resolve().parent
    if model.is_absolute() and model.is_relative_to(folder):
        description = dc.replace(description, model=os.path.relpath(model, folder))
    head = "".join(f"# {line}\n" for line in comments)
    write_text(path, head + yaml_dump_typed(description, defaults=HandDescription()))

"""The recorded data of the plant itself: poses and contact forces."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import OutputPort

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.rerun.scene import Scene
from geort_drake.rerun.specs import Spec
from geort_drake.rerun.writer import PALETTE, WORLD, Writer, entity_path
from geort_drake.systems.contacts import contact_rows

_CONTACT_COLOR: Color = (255, 200, 40)
_ARROWS, _SERIES = f"/{WORLD}/contact/forces", "/contact/force"


@dataclass(frozen=True)
class ContactSpec:
    """Options for recording contact forces.

    Attributes:
        groups: name → bodies whose contact forces are summed to one time series, such as the links of a
            finger: {"thumb": [link_12, ...]}. By default each touched moving body has its own.
        metres_per_newton: length of the arrows per force, m/N.
        max_length: largest length of the arrows, m.
    """

    groups: Mapping[str, Sequence[RigidBody]] | None = None
    metres_per_newton: float = 0.02
    max_length: float = 0.25


@dataclass(frozen=True)
class Poses(Spec):
    """Records the poses X_WB of all moving bodies, in rows (bodies, 3, 4)."""

    scene: Scene

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {key: plant_port(key)}

    def read(self, body_poses: Sequence[RigidTransform]) -> np.ndarray:
        return np.array([body_poses[i].GetAsMatrix34() for i in self.scene.moving]).reshape(-1, 3, 4)

    def write(self, writer: Writer, key: str, rows: Sequence[np.ndarray]) -> None:
        X_WB = np.reshape(rows, (len(rows), len(self.scene.moving), 3, 4))
        writer.poses([self.scene.paths[i] for i in self.scene.moving], X_WB)


@dataclass(frozen=True)
class Contacts(Spec):
    """Records contact forces, in rows from `contact_rows`."""

    scene: Scene
    options: ContactSpec

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {key: plant_port(key)}

    def read(self, results: ContactResults) -> np.ndarray:
        return contact_rows(results, self.scene.body_of_geometry)

    def write(self, writer: Writer, key: str, rows: Sequence[np.ndarray]) -> None:
        writer.static(_ARROWS, rr.Arrows3D.from_fields(colors=[_CONTACT_COLOR], radii=[0.0025]))
        contacts = np.concatenate([np.empty((0, 8)), *rows])
        counts = np.array([len(row) for row in rows], dtype=int)
        force = contacts[:, 5:]
        arrows = self.options.metres_per_newton * force
        length = np.linalg.norm(arrows, axis=1, keepdims=True)
        arrows *= np.minimum(1.0, self.options.max_length / np.maximum(length, 1e-12))
        # One of the two bodies usually hides one of the two arrows.
        columns = rr.Arrows3D.columns(
            origins=np.repeat(contacts[:, 2:5], 2, axis=0),
            vectors=np.stack([arrows, -arrows], axis=1).reshape(-1, 3),
        )
        writer.columns(_ARROWS, columns.partition(2 * counts))
        bodies, sample = contacts[:, :2].astype(int), np.repeat(np.arange(len(rows)), counts)
        magnitude = np.linalg.norm(force, axis=1)
        for number, (path, (name, members)) in enumerate(self._groups(writer, bodies).items()):
            member = np.zeros(len(self.scene.paths), dtype=bool)
            member[members] = True
            # Only forces that act on the group from outside count.
            crossing = member[bodies[:, 0]] != member[bodies[:, 1]]
            total = np.bincount(sample[crossing], magnitude[crossing], minlength=len(writer.times))
            finger = FINGER_COLOURS.get(name)
            color = PALETTE[number % len(PALETTE)] if finger is None else rgb(finger)
            writer.series(path, [name], total[:, None], [color], 1.5)

    def _groups(self, writer: Writer, bodies: np.ndarray) -> dict[str, tuple[str, list[int]]]:
        """Returns entity path → name and bodies of each series; a body has one from its first contact on."""
        groups: dict[str, tuple[str, list[int]]] = writer.memory.setdefault(_SERIES, {})
        if self.options.groups is not None:
            for name, members in self.options.groups.items():
                groups[entity_path(_SERIES, name)] = name, [int(body.index()) for body in members]
        else:
            for i in sorted({*bodies.ravel()} & {*self.scene.moving}):
                path = self.scene.paths[i].removeprefix(f"/{WORLD}")
                groups.setdefault(_SERIES + path, (path[1:], [i]))
        return groups

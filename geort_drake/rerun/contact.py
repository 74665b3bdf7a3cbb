"""Contact in a Rerun recording: forces as arrows, and how strong they are as time series."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
from pydrake.multibody.plant import ContactResults, PointPairContactInfo

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.rerun.scene import WORLD, Scene, entity_path
from geort_drake.rerun.tracks import PALETTE, Track, scalars
from geort_drake.rerun.writer import Writer

_COLOR: Color = (255, 200, 40)
_NOTHING = np.empty((0, 8))


class ContactTrack(Track):
    """Contact forces: rows (contacts, 8), body A, body B, p_WC (m), f_Bc_W (N)."""

    ARROWS = f"/{WORLD}/contact/forces"
    SERIES = "/contact/force"

    def __init__(
        self,
        scene: Scene,
        groups: Mapping[str, Sequence[int]] | None,
        metres_per_newton: float,
        max_length: float,
    ):
        super().__init__("contact_results")
        self._scene = scene
        self._groups = groups
        self._scale = metres_per_newton
        self._max_length = max_length

    def read(self, results: ContactResults) -> np.ndarray:
        points, patches = results.num_point_pair_contacts(), results.num_hydroelastic_contacts()
        if not points + patches:
            return _NOTHING
        row = np.empty((points + patches, 8))
        # Calls into C++ are what recording costs most: five for each contact, and nothing around them.
        infos = list(map(results.point_pair_contact_info, range(points)))
        row[:points, 0] = np.fromiter(map(PointPairContactInfo.bodyA_index, infos), int, points)
        row[:points, 1] = np.fromiter(map(PointPairContactInfo.bodyB_index, infos), int, points)
        row[:points, 2:5] = np.reshape(list(map(PointPairContactInfo.contact_point, infos)), (points, 3))
        row[:points, 5:] = np.reshape(list(map(PointPairContactInfo.contact_force, infos)), (points, 3))
        of_geometry = self._scene.body_of_geometry
        for i in range(patches):
            patch = results.hydroelastic_contact_info(i)
            surface = patch.contact_surface()
            row[points + i, :2] = of_geometry[surface.id_M()], of_geometry[surface.id_N()]
            row[points + i, 2:5] = surface.centroid()
            # F_Ac_W acts on the body of M, at the centroid.
            row[points + i, 5:] = -patch.F_Ac_W().translational()
        return row

    def early(self) -> bool:
        """Whether the strongest force is in the first half of the samples."""
        contacts = np.concatenate([_NOTHING, *self.rows])
        if not len(contacts):
            return False
        strongest = np.argmax(np.square(contacts[:, 5:]).sum(axis=1))
        before = sum(len(row) for row in self.rows[: len(self.rows) // 2])
        return bool(strongest < before)

    def describe(self, writer: Writer) -> None:
        writer.static(self.ARROWS, rr.Arrows3D.from_fields(colors=[_COLOR], radii=[0.0025]))

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        contacts = np.concatenate([_NOTHING, *rows])
        counts = np.array([len(row) for row in rows], dtype=int)
        length = self._scale * np.linalg.norm(contacts[:, 5:], axis=1, keepdims=True)
        shrink = np.minimum(1.0, self._max_length / np.maximum(length, 1e-12))
        on_B = self._scale * shrink * contacts[:, 5:]
        # Both of the pair are drawn: one of the two bodies usually hides the other arrow.
        columns = rr.Arrows3D.columns(
            origins=np.repeat(contacts[:, 2:5], 2, axis=0),
            vectors=np.stack([on_B, -on_B], axis=1).reshape(-1, 3),
        )
        writer.columns(self.ARROWS, columns.partition(2 * counts))
        self._write_series(writer, contacts, np.repeat(np.arange(len(rows)), counts), len(rows))

    def _write_series(self, writer: Writer, contacts: np.ndarray, sample: np.ndarray, samples: int) -> None:
        """For each group, the sum of the magnitudes of the forces that act on it from outside, N.

        Without groups, every body that moves and that was ever touched is its own.
        """
        begun: dict[str, Sequence[int]] = writer.memory.setdefault(self.SERIES, {})
        groups = dict(begun)
        bodies = contacts[:, :2].astype(int)
        if self._groups is None:
            touched = np.flatnonzero(np.bincount(bodies.ravel()))
            moving = [i for i in self._scene.moving if i in touched]
            groups |= {self._scene.paths[i].removeprefix(f"/{WORLD}/"): [i] for i in moving}
        else:
            groups |= self._groups
        magnitude = np.linalg.norm(contacts[:, 5:], axis=1)
        for name, members in groups.items():
            path = f"{self.SERIES}/{name}" if self._groups is None else entity_path(self.SERIES, name)
            if name not in begun:
                finger = FINGER_COLOURS.get(name)
                color = PALETTE[len(begun) % len(PALETTE)] if finger is None else rgb(finger)
                begun[name] = members
                writer.static(path, rr.SeriesLines(names=[name], colors=[color], widths=[1.5]))
            member = np.zeros(len(self._scene.paths), dtype=bool)
            member[list(members)] = True
            A, B = member[bodies].T
            crossing = A != B
            force = np.bincount(sample[crossing], magnitude[crossing], minlength=samples)
            writer.columns(path, scalars(force[:, None]))

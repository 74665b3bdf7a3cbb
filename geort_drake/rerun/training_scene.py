"""What is drawn of a training: fingertip spaces, the map between them, pinches, collisions and curves."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rerun as rr
import torch
from pydrake.math import RigidTransform
from scipy.spatial import cKDTree

from geort_drake.colours import SKIN
from geort_drake.comparison import metrics
from geort_drake.comparison.exploration import find_pinches, tips_of
from geort_drake.hands.canonical import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import Recording
from geort_drake.rerun.hand import HandTrack
from geort_drake.rerun.posed_hand import (
    RIGHT,
    WRONG,
    PosedHand,
    finger_colors,
    write_balls,
    write_lines,
)
from geort_drake.rerun.scene import WORLD, entity_path
from geort_drake.rerun.tracks import scalars
from geort_drake.rerun.writer import Writer
from geort_drake.retargeting.clouds import voxel_centres, voxel_thinned
from geort_drake.retargeting.training.map_figures import motion_preservation

# From human fingertips (N, F, 3) of a canonical right hand, m, to joint angles (N, n), rad.
Map = Callable[[np.ndarray], np.ndarray]
# What is measured at every step: the title of its plot, and where that begins and ends if it is a share.
_SHARE = (-0.05, 1.08)  # so that 0 and 1 are labelled
CRITERIA: dict[str, tuple[str, tuple[float, float] | None]] = {
    "motion": ("I  motion", _SHARE),
    "coverage": ("II  reach", _SHARE),
    "flatness": ("III  flatness", None),
    "pinch": ("IV  pinches", _SHARE),
    "collision": ("V  collisions", _SHARE),
}
_UNREACHED = (112, 118, 132)
_APART = 0.32  # m; the robot hand stands beside the human one
_FRAMES, _COLLIDING, _PINCHING, _ANCHORS, _SAMPLES = 1000, 150, 40, 300, 20_000
_VOXEL = 0.008  # m, of both clouds
_DOT = 0.001  # m, radius
_REACH = 0.010  # m, as in the coverage that is reported first
_SPACING = 0.012  # m, of the lattices


class TrainingScene:
    """What does not change while a hand learns from a recording, and what any map makes of it.

    Args:
        hand: model of the robot hand.
        recording: of the person.
        seed: of what is sampled.
    """

    def __init__(self, hand: HandModel, recording: Recording, seed: int):
        self._hand, self._seed = hand, seed
        self._kinematics = canonical_kinematics(hand)
        self._fingers = range(len(hand.finger_names))
        self._colors = finger_colors(hand)
        # People are canonical right hands; what is drawn of a left hand is mirrored back.
        self._seen: Callable = mirrored if hand.description.side == "left" else np.asarray
        p_HK = recording.p_HK[recording.valid].astype(float)
        frames = tips_of(p_HK, hand)
        self._frames = frames[_evenly(len(frames), _FRAMES)]
        pinches = find_pinches(frames, hand.finger_names)
        rows = np.flatnonzero(pinches.asked)
        rows = rows[_evenly(len(rows), _PINCHING)]
        self._pinching, self._pairs = frames[rows], pinches.pair[rows]
        self._instant = p_HK[np.argmin(pinches.distance)]
        q = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (_SAMPLES, len(hand.joint_names)))
        p_BF = self._fingertips(q)
        self._reachable = [voxel_thinned(p_BF[:, i], _VOXEL) for i in self._fingers]
        self._lattices = [_Lattice(frames, i) for i in self._fingers]
        self._posed = PosedHand(hand, "robot", RigidTransform([0.0, _APART, -hand.p_BW[2]]))

    def write(self, writer: Writer, maps: Sequence[Map]) -> None:
        """Sends everything; one map for each of the writer's times."""
        writer.static(f"/{WORLD}", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._write_human(writer, len(maps))
        self._posed.describe(writer)
        instant = tips_of(self._instant[None], self._hand)
        self._posed.write(writer, np.concatenate([answer(instant) for answer in maps]))
        self._write_lattices(writer, maps)
        curves = {
            "motion": [self._measure(motion_preservation, answer) for answer in maps],
            "coverage": self._write_reach(writer, maps),
            "flatness": [self._measure(metrics.flatness_and_gain, answer)[0] for answer in maps],
            "pinch": self._write_pinches(writer, maps),
            "collision": self._write_collisions(writer, maps),
        }
        for key, values in curves.items():
            path = f"/criteria/{key}"
            writer.static(path, rr.SeriesLines(names=[key], colors=[(86, 180, 233)], widths=[2.0]))
            writer.columns(path, scalars(np.array(values, dtype=float)[:, None]))

    def _fingertips(self, q: np.ndarray) -> np.ndarray:
        return self._kinematics.fingertips(torch.from_numpy(q)).numpy()

    def _measure(self, metric: Callable, answer: Map) -> Any:
        """A metric with the same random numbers for every map."""

        def fingertips(p_HF: np.ndarray) -> np.ndarray:
            return self._fingertips(answer(p_HF))

        return metric(fingertips, self._frames, np.random.default_rng([self._seed, 1]), anchors=_ANCHORS)

    def _write_human(self, writer: Writer, steps: int) -> None:
        track = HandTrack("human", SKIN, RigidTransform())
        track.describe(writer)
        track.write(writer, [self._seen(self._instant)] * steps)
        path = entity_path(WORLD, "human")
        for i in self._fingers:
            name, color = self._hand.finger_names[i], [self._colors[i]]
            cloud = self._seen(voxel_thinned(self._frames[:, i], _VOXEL))
            writer.static(f"{path}/cloud/{name}", rr.Points3D(cloud, colors=color, radii=[_DOT]))
            lines = self._seen(self._lattices[i].segments(self._lattices[i].nodes))
            writer.static(f"{path}/lattice/{name}", rr.LineStrips3D(lines, colors=color, radii=[0.0006]))

    def _write_lattices(self, writer: Writer, maps: Sequence[Map]) -> None:
        for i in self._fingers:
            lattice = self._lattices[i]
            rows = [lattice.segments(self._fingertips(answer(lattice.hands))[:, i]) for answer in maps]
            path = f"{self._posed.path}/lattice/{self._hand.finger_names[i]}"
            colors = [np.tile(self._colors[i], (len(row), 1)) for row in rows]
            write_lines(writer, path, [self._seen(row) for row in rows], colors, 0.0006)

    def _write_reach(self, writer: Writer, maps: Sequence[Map]) -> list[float]:
        """Sends which places the fingertips come near to, and returns their share."""
        tips = [self._fingertips(answer(self._frames)) for answer in maps]
        shares = np.empty((len(maps), len(self._fingers)))
        for i in self._fingers:
            places = self._reachable[i]
            near = [
                cKDTree(p_BF[:, i]).query(places, distance_upper_bound=_REACH)[0] <= _REACH for p_BF in tips
            ]
            shares[:, i] = np.mean(near, axis=1)
            path = f"{self._posed.path}/reach/{self._hand.finger_names[i]}"
            writer.static(path, rr.Points3D.from_fields(positions=self._seen(places), radii=[_DOT]))
            shades = np.where(np.array(near)[..., None], self._colors[i], _UNREACHED).astype(np.uint8)
            columns = rr.Points3D.columns(colors=shades.reshape(-1, 3))
            writer.columns(path, columns.partition([len(places)] * len(maps)))
        return list(shares.mean(axis=1))

    def _write_pinches(self, writer: Writer, maps: Sequence[Map]) -> list[float]:
        """Sends the robot's answers to pinches, and returns the share of those that close."""
        if len(self._pinching) == 0:
            return [np.nan] * len(maps)
        each = np.arange(len(self._pinching))[:, None]
        rows = [self._fingertips(answer(self._pinching))[each, self._pairs] for answer in maps]
        closed = [np.linalg.norm(row[:, 1] - row[:, 0], axis=-1) <= 2 * self._hand.tip_radius for row in rows]
        colors = [np.where(of_step[:, None], RIGHT, WRONG) for of_step in closed]
        write_lines(writer, f"{self._posed.path}/pinches", [self._seen(row) for row in rows], colors, 0.0012)
        return [float(of_step.mean()) for of_step in closed]

    def _write_collisions(self, writer: Writer, maps: Sequence[Map]) -> list[float]:
        """Sends where the hand hits itself, and returns the share of hands that do."""
        frames = self._frames[_evenly(len(self._frames), _COLLIDING)]
        found = [self._posed.collisions(answer(frames)) for answer in maps]
        rows = [np.concatenate(of_step) for of_step in found]
        write_balls(writer, f"{self._posed.path}/collisions", rows, 0.004, WRONG)
        return [float(np.mean([len(points) > 0 for points in of_step])) for of_step in found]


class _Lattice:
    """A flat square lattice through the places of one human fingertip, where most of them lie in a plane.

    Attributes:
        nodes: (k, 3) where they cross, m.
        hands: (k, F, 3) recorded hands with that fingertip moved to the nodes, m.
    """

    def __init__(self, frames: np.ndarray, finger: int):
        tree = cKDTree(frames[:, finger])
        centres = voxel_centres(frames[:, finger], _SPACING)
        distance, rows = tree.query(centres)
        chosen = distance < _SPACING / 2
        cells = np.round(centres / _SPACING - 0.5).astype(int)
        chosen &= _fullest_plane(cells, chosen)
        self.nodes = centres[chosen]
        self.hands = frames[rows[chosen]].copy()
        self.hands[:, finger] = self.nodes
        numbers = {tuple(cell): k for k, cell in enumerate(cells[chosen])}
        self._edges = np.array(
            [
                (k, numbers[neighbour])
                for node, k in numbers.items()
                for neighbour in _next(node)
                if neighbour in numbers
            ],
            dtype=int,
        ).reshape(-1, 2)

    def segments(self, nodes: np.ndarray) -> np.ndarray:
        """(e, 2, 3) between neighbours, where the nodes (k, 3) went."""
        return nodes[self._edges]


def _fullest_plane(cells: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Which cells (k, 3) lie in that plane across an axis which holds the most of the chosen ones."""
    planes = [cells[:, axis] == number for axis in range(3) for number in np.unique(cells[:, axis])]
    return max(planes, key=lambda plane: np.count_nonzero(plane & chosen))


def _next(node: tuple[int, ...]) -> list[tuple[int, ...]]:
    x, y, z = node
    return [(x + 1, y, z), (x, y + 1, z), (x, y, z + 1)]


def _evenly(count: int, wanted: int) -> np.ndarray:
    """At most `wanted` rows out of `count`."""
    return np.linspace(0, count - 1, min(wanted, count)).astype(int)

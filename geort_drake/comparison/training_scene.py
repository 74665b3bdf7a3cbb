"""What a recording of a training shows: fingertip clouds, the map between them, and the five criteria."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from pydrake.math import RigidTransform
from scipy.spatial import cKDTree

from geort_drake.colours import SKIN
from geort_drake.comparison import metrics
from geort_drake.comparison.exploration import find_pinches, tips_of
from geort_drake.comparison.hand_marks import RIGHT, WRONG, collisions, finger_colors, pinch_closed
from geort_drake.hands.mirror import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import Recording
from geort_drake.rerun.robot_hand import write_robot_hand
from geort_drake.rerun.writer import SOLID, Writer
from geort_drake.retargeting.clouds import voxel_centres, voxel_thinned
from geort_drake.retargeting.training.map_figures import motion_preservation

# From human fingertips (N, F, 3) of a canonical right hand, m, to joint angles (N, n), rad.
Map = Callable[[np.ndarray], np.ndarray]
_SHARE = (-0.05, 1.08)  # limits of a plot that labels 0 and 1
# Criterion → title of its plot, and the plot's limits.
CRITERIA: dict[str, tuple[str, tuple[float, float] | None]] = {
    "motion": ("I  motion", _SHARE),
    "coverage": ("II  reach", _SHARE),
    "flatness": ("III  flatness", None),
    "pinch": ("IV  pinches", _SHARE),
    "collision": ("V  collisions", _SHARE),
}
_CRITERION_COLOR = (86, 180, 233)
_UNREACHED = (112, 118, 132)
_HUMAN, _ROBOT = "/world/human", "/world/robot"
_SPACING = 0.32  # m, from the human to the robot hand
# Numbers of hands: for figures, for collisions, of pinches; of anchors of the metrics; of robot poses.
_FRAMES, _COLLIDING, _PINCHING, _ANCHORS, _SAMPLES = 1000, 150, 40, 300, 20_000
_VOXEL = 0.008  # m, of both clouds
_DOT = 0.001  # m, radius
_REACHED = 0.010  # m, as in the coverage that is reported first
_CELL = 0.012  # m, of the lattices
_LATTICE_RADIUS = 0.0006  # m, of its lines


class TrainingScene:
    """The samples of a recording by which maps are shown and measured.

    Args:
        hand: model of the robot hand.
        recording: of the person.
        seed: of the samples.
    """

    def __init__(self, hand: HandModel, recording: Recording, seed: int):
        self._hand, self._seed = hand, seed
        self._kinematics = canonical_kinematics(hand)
        self._colors = finger_colors(hand)
        # Maps work on canonical right hands; a left hand is drawn mirrored back.
        self._shown: Callable = mirrored if hand.description.side == "left" else np.asarray
        p_HK = recording.p_HK[recording.valid].astype(float)
        frames = tips_of(p_HK, hand)
        self._frames = frames[_evenly(len(frames), _FRAMES)]
        pinches = find_pinches(frames, hand.finger_names)
        rows = np.flatnonzero(pinches.asked)
        rows = rows[_evenly(len(rows), _PINCHING)]
        self._pinching, self._pairs = frames[rows], pinches.pair[rows]
        self._closest_pinch = p_HK[np.argmin(pinches.distance)]
        q = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (_SAMPLES, len(hand.joint_names)))
        p_BF = self._fingertips(q)
        self._reachable = [voxel_thinned(p_BF[:, i], _VOXEL) for i in range(len(self._colors))]
        self._lattices = [Lattice(frames, i) for i in range(len(self._colors))]

    def write(self, writer: Writer, maps: Sequence[Map]) -> None:
        """Sends everything; one map for each of the writer's times."""
        writer.up_axis()
        self._write_human(writer, len(maps))
        instant = tips_of(self._closest_pinch[None], self._hand)
        X_WB = RigidTransform([0.0, _SPACING, -self._hand.p_BW[2]])
        q = np.concatenate([answer(instant) for answer in maps])
        write_robot_hand(writer, _ROBOT, self._hand, q, X_WB)
        self._write_lattices(writer, maps)
        curves = {
            "motion": [self._measure(motion_preservation, answer) for answer in maps],
            "coverage": self._write_reach(writer, maps),
            "flatness": [self._measure(metrics.flatness_and_gain, answer)[0] for answer in maps],
            "pinch": self._write_pinches(writer, maps),
            "collision": self._write_collisions(writer, maps),
        }
        for key, values in curves.items():
            writer.series(f"/criteria/{key}", [key], np.array(values)[:, None], [_CRITERION_COLOR], 2.0)

    def _fingertips(self, q: np.ndarray) -> np.ndarray:
        return self._kinematics.fingertips(torch.from_numpy(q)).numpy()

    def _measure(self, metric: Callable, answer: Map) -> Any:
        """A metric with the same random numbers for every map."""

        def fingertips(p_HF: np.ndarray) -> np.ndarray:
            return self._fingertips(answer(p_HF))

        return metric(fingertips, self._frames, np.random.default_rng([self._seed, 1]), anchors=_ANCHORS)

    def _write_human(self, writer: Writer, steps: int) -> None:
        writer.human_hand(_HUMAN, np.array([self._shown(self._closest_pinch)] * steps), SKIN)
        for i, (name, color) in enumerate(zip(self._hand.finger_names, self._colors, strict=True)):
            cloud = self._shown(voxel_thinned(self._frames[:, i], _VOXEL))
            writer.points(f"{_HUMAN}/cloud/{name}", cloud, _DOT, color)
            lines = self._shown(self._lattices[i].segments(self._lattices[i].nodes))
            writer.lines(f"{_HUMAN}/lattice/{name}", lines, _LATTICE_RADIUS, color)

    def _write_lattices(self, writer: Writer, maps: Sequence[Map]) -> None:
        for i, (name, color) in enumerate(zip(self._hand.finger_names, self._colors, strict=True)):
            lattice = self._lattices[i]
            nodes = [self._fingertips(answer(lattice.hands))[:, i] for answer in maps]
            lines = [self._shown(lattice.segments(of_step)) for of_step in nodes]
            writer.lines(f"{_ROBOT}/lattice/{name}", lines, _LATTICE_RADIUS, color)

    def _write_reach(self, writer: Writer, maps: Sequence[Map]) -> list[float]:
        """Sends which reachable places the fingertips come near to, and returns their share."""
        tips = [self._fingertips(answer(self._frames)) for answer in maps]
        shares = []
        for i, (name, color) in enumerate(zip(self._hand.finger_names, self._colors, strict=True)):
            places = self._reachable[i]
            near = np.array(
                [
                    cKDTree(p_BF[:, i]).query(places, distance_upper_bound=_REACHED)[0] <= _REACHED
                    for p_BF in tips
                ]
            )
            shares.append(near.mean(axis=1))
            colors = list(np.where(near[..., None], color, _UNREACHED))
            writer.points(f"{_ROBOT}/reach/{name}", self._shown(places), _DOT, colors)
        return list(np.mean(shares, axis=0))

    def _write_pinches(self, writer: Writer, maps: Sequence[Map]) -> list[float]:
        """Sends the robot's answers to pinches, and returns the share of those that close."""
        if len(self._pinching) == 0:
            return [np.nan] * len(maps)
        each = np.arange(len(self._pinching))[:, None]
        tips = [self._fingertips(answer(self._pinching))[each, self._pairs] for answer in maps]
        closed = [pinch_closed(self._hand, of_step) for of_step in tips]
        colors = [np.where(of_step[:, None], RIGHT, WRONG) for of_step in closed]
        writer.lines(f"{_ROBOT}/pinches", [self._shown(of_step) for of_step in tips], 0.0012, colors)
        return [float(of_step.mean()) for of_step in closed]

    def _write_collisions(self, writer: Writer, maps: Sequence[Map]) -> list[float]:
        """Sends where the hand hits itself, and returns the share of hands that do."""
        frames = self._frames[_evenly(len(self._frames), _COLLIDING)]
        found = [collisions(self._hand, answer(frames)) for answer in maps]
        rows = [np.concatenate(of_step) for of_step in found]
        writer.points(f"{_ROBOT}/collisions", rows, 0.004, WRONG, SOLID)
        return [float(np.mean([len(points) > 0 for points in of_step])) for of_step in found]


class Lattice:
    """A flat square lattice through the places of one human fingertip, in the plane that holds most of them.

    Attributes:
        nodes: (k, 3), m.
        hands: (k, F, 3) recorded hands with that fingertip moved to the nodes, m.
    """

    def __init__(self, frames: np.ndarray, finger: int):
        centres = voxel_centres(frames[:, finger], _CELL)
        distance, rows = cKDTree(frames[:, finger]).query(centres)
        visited = distance < _CELL / 2
        planes = [centres[:, axis] == place for axis in range(3) for place in np.unique(centres[:, axis])]
        chosen = visited & max(planes, key=lambda plane: np.count_nonzero(plane & visited))
        self.nodes = centres[chosen]
        self.hands = frames[rows[chosen]].copy()
        self.hands[:, finger] = self.nodes
        self._edges = cKDTree(self.nodes).query_pairs(1.1 * _CELL, output_type="ndarray")

    def segments(self, nodes: np.ndarray) -> np.ndarray:
        """(e, 2, 3) between neighbours, for nodes (k, 3) that were moved."""
        return nodes[self._edges]


def _evenly(count: int, wanted: int) -> np.ndarray:
    """At most `wanted` rows out of `count`."""
    return np.linspace(0, count - 1, min(wanted, count)).astype(int)

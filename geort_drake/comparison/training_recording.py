"""Writes a Rerun recording of a training: how the map from a human to a robot hand forms."""

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from pydrake.math import RigidTransform
from scipy.spatial import cKDTree

from geort_drake.colours import SKIN, finger_colors
from geort_drake.comparison.exploration import find_pinches
from geort_drake.comparison.metrics import fingertips_of, flatness_and_gain, pinch, self_collision
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import mirrored
from geort_drake.people.recording import Recording
from geort_drake.rerun import blueprint as views
from geort_drake.rerun.scene import write_robot_hand
from geort_drake.rerun.streams import Property, file_writer
from geort_drake.rerun.writer import PALETTE, STEPS, LineStrips3D, Points3D, Writer
from geort_drake.retargeting.clouds import voxel_centres, voxel_thinned
from geort_drake.retargeting.training.map_figures import coverage, motion_preservation

# Maps human fingertips (N, F, 3) of a canonical right hand, m, to joint angles (N, n), rad.
Map = Callable[[np.ndarray], np.ndarray]
APPLICATION = "geort_drake_training"
_PLAYING_TIME = 10.0  # s
_TEXT = """\
**{method}** learns to move the {hand} without paired poses. Flat lattices among the person's fingertips are
mapped to the robot. The map should preserve directions (I), cover the whole reach of the robot's fingertips
(II), keep cells equal (III), close pinches (IV) and avoid self-collisions (V).

Plots: I mean cosine; II, IV and V fractions; III 0 for an affine map. Both hands show one pinch.
"""
# Title, eye and target (in W, m), and entities of each view.
_VIEWS = (
    ("the person's fingertips", (0.19, 0.18, 0.17), (0.03, 0.01, 0.1), ["/world/human/**"]),
    ("mapped to the robot", (0.22, 0.53, 0.19), (0.04, 0.33, 0.11), ["/world/robot/**"]),
)
_FRACTION_LIMITS = (-0.05, 1.08)  # limits of a plot that shows the labels 0 and 1
# Criterion → title and limits of its plot.
_CRITERIA: dict[str, tuple[str, tuple[float, float] | None]] = {
    "motion": ("I  motion", _FRACTION_LIMITS),
    "coverage": ("II  reach", _FRACTION_LIMITS),
    "flatness": ("III  flatness", None),
    "pinch": ("IV  pinches", _FRACTION_LIMITS),
    "collision": ("V  collisions", _FRACTION_LIMITS),
}
_CRITERION_COLOR = (86, 180, 233)
_HUMAN, _ROBOT = "/world/human", "/world/robot"
_SPACING = 0.32  # m, from the human to the robot hand
# Numbers of hands for motion and coverage, for collisions and for pinches; of anchors; of robot poses.
_FRAMES, _COLLIDING, _PINCHING, _ANCHORS, _SAMPLES = 1000, 150, 40, 300, 20_000
_VOXEL = 0.008  # m, of both clouds
_DOT_RADIUS = 0.001  # m
_CELL = 0.012  # m, edge of the lattices' cells
_LATTICE_RADIUS = 0.0006  # m, of the lattices' lines


class TrainingRecorder:
    """Records a training: pass `observe` to the training as its `Report`, then call `write`.

    `observe` only copies the weights; `write` computes everything else.

    Args:
        hand: model of the robot hand.
        recording: the training recording.
        seed: seed of the samples for the figures.
    """

    def __init__(self, hand: HandModel, recording: Recording, seed: int = 0):
        self._hand, self._recording, self._seed = hand, recording, seed
        self._fingertips = fingertips_of(hand)
        self._network: torch.nn.Module | None = None
        self._weights: dict[int, dict[str, torch.Tensor]] = {}
        self._losses: list[dict[str, float]] = []
        self._steps = 0

    def observe(self, step: int, steps: int, losses: dict[str, float], network: torch.nn.Module) -> None:
        """Copies losses and weights; the network maps fingertips (N, F, 3), m, to joint angles (N, n)."""
        if self._network is None:
            self._network = copy.deepcopy(network).cpu()
        self._steps = steps
        self._losses.append(losses)
        if step < steps:
            weights = network.state_dict().items()
            self._weights[step] = {name: value.detach().cpu().clone() for name, value in weights}

    def write(self, path: str | os.PathLike, trained: Map, properties: Mapping[str, Property]) -> None:
        """Writes the recording, with the criteria measured at every observed step.

        Args:
            path: .rrd file to write.
            trained: the final map, shown last.
            properties: properties of the recording, with at least `method`, `hand` and `seed`.
        """
        maps = {step: self._map(weights) for step, weights in self._weights.items()} | {self._steps: trained}
        keys = dict.fromkeys(name for line in self._losses for name in line)
        names = [name for name in keys if name not in ("step", "seconds", "total")]
        # Some losses are computed only at some of the steps.
        losses = np.array([[line.get(name, np.nan) for name in names] for line in self._losses])
        id = "-".join(str(properties[key]) for key in ("method", "hand", "seed"))
        with file_writer(
            path,
            application_id=APPLICATION,
            recording_id=f"training-{id}-{self._recording.digest}",
            blueprint=_blueprint(self._steps, losses),
            properties=properties,
            timeline=STEPS,
        ) as writer:
            writer.text("/about", _TEXT.format(**properties))
            steps = np.array([line["step"] for line in self._losses], dtype=np.int64)
            for i, name in enumerate(names):
                known = np.isfinite(losses[:, i])
                writer.at(steps[known])
                writer.series(
                    f"/losses/{name}", [name], losses[known][:, [i]], PALETTE[i % len(PALETTE) :], 1.5
                )
            writer.at(np.array(list(maps), dtype=np.int64))
            self._write_maps(writer, list(maps.values()))

    def _write_maps(self, writer: Writer, maps: Sequence[Map]) -> None:
        """Sends hands, clouds, lattices and criteria, with one map for each of the writer's times."""
        hand, keypoints = self._hand, self._hand.description.human_keypoints
        # Maps work on canonical right hands; a left hand is drawn mirrored back.
        shown: Callable = mirrored if hand.description.side == "left" else np.asarray
        p_HK = self._recording.p_HK[self._recording.valid].astype(float)
        frames = p_HK[:, keypoints]
        pinches = find_pinches(frames, hand.finger_names)
        closest = [np.argmin(pinches.distance)]
        writer.human_hand(_HUMAN, np.tile(shown(p_HK[closest]), (len(maps), 1, 1)), SKIN)
        q = np.concatenate([retarget(frames[closest]) for retarget in maps])
        X_WB = RigidTransform([0.0, _SPACING, -hand.p_BW[2]])
        write_robot_hand(writer, _ROBOT, hand, q, X_WB)
        pinching = np.flatnonzero(pinches.closed)
        pinching = frames[pinching[_evenly(len(pinching), _PINCHING)]]
        subset = frames[_evenly(len(frames), _FRAMES)]
        reachable = []
        p_BF = self._fingertips(hand.sample(_SAMPLES, self._seed))
        colors = finger_colors(hand.finger_names)
        for i, (name, color) in enumerate(zip(hand.finger_names, colors, strict=True)):
            reachable.append(voxel_thinned(p_BF[:, i], _VOXEL))
            cloud = shown(voxel_thinned(subset[:, i], _VOXEL))
            writer.static(f"{_HUMAN}/cloud/{name}", Points3D(cloud, radii=_DOT_RADIUS, colors=[color]))
            lattice = Lattice(frames, i)
            lines = shown(lattice.segments(lattice.nodes))
            strips = LineStrips3D(lines, radii=_LATTICE_RADIUS, colors=[color])
            writer.static(f"{_HUMAN}/lattice/{name}", strips)
            nodes = [self._fingertips(retarget(lattice.hands))[:, i] for retarget in maps]
            rows = [shown(lattice.segments(of_step)) for of_step in nodes]
            writer.lines(f"{_ROBOT}/lattice/{name}", rows, _LATTICE_RADIUS, color)
        curves = np.array(
            [self._measure(retarget, subset, pinching, reachable) for retarget in maps], dtype=float
        )
        for key, values in zip(_CRITERIA, curves.T, strict=True):
            writer.series(f"/criteria/{key}", [key], values[:, None], [_CRITERION_COLOR], 2.0)

    def _measure(
        self, retarget: Map, frames: np.ndarray, pinching: np.ndarray, reachable: list[np.ndarray]
    ) -> tuple:
        """Computes the criteria, with the same random numbers for every map."""

        def fingertips(p_HF: np.ndarray) -> np.ndarray:
            return self._fingertips(retarget(p_HF))

        def rng() -> np.random.Generator:
            return np.random.default_rng([self._seed, 1])

        hand, tips = self._hand, fingertips(frames)
        closed = None
        if len(pinching):
            figures = pinch(pinching, fingertips(pinching), hand.finger_names, hand.tip_radius)
            closed = figures and figures["closed"]
        return (
            motion_preservation(fingertips, frames, rng(), anchors=_ANCHORS),
            coverage(reachable, list(np.moveaxis(tips, 1, 0)))["10mm"],
            flatness_and_gain(fingertips, frames, rng(), anchors=_ANCHORS)[0],
            closed,
            self_collision(hand, retarget(frames[_evenly(len(frames), _COLLIDING)]))["deep"],
        )

    def _map(self, weights: Mapping[str, torch.Tensor]) -> Map:
        def retarget(p_HF: np.ndarray) -> np.ndarray:
            network = self._network
            assert network is not None
            network.load_state_dict(weights)
            with torch.no_grad():
                return network(torch.tensor(p_HF, dtype=torch.float32)).numpy().astype(float)

        return retarget


class Lattice:
    """A flat square lattice in the axis-aligned plane with most positions of a human fingertip.

    Attributes:
        nodes: (k, 3) positions in H, m.
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
        """Returns the segments (e, 2, 3) between neighbours for moved nodes (k, 3)."""
        return nodes[self._edges]


def _evenly(count: int, most: int) -> np.ndarray:
    """Returns at most `most` evenly spaced rows out of `count`."""
    return np.linspace(0, count - 1, min(most, count)).astype(int)


def _blueprint(steps: int, losses: np.ndarray) -> Any:
    """Makes the layout; losses (K, L) are those of K observations."""
    scenes = [views.scene_view(eye, target, title, contents) for title, eye, target, contents in _VIEWS]
    criteria = [
        views.time_series(title, [f"/criteria/{key}"], steps=steps, limits=limits)
        for key, (title, limits) in _CRITERIA.items()
    ]
    # The highest peaks are cut off, because they would flatten everything else.
    low, high = np.nanpercentile(losses, [0, 97])
    margin = 0.05 * max(high - low, 1e-6)
    # The axis is longer than the training, to leave room for the legend.
    shown = round(1.7 * steps), (low - margin, high + margin)
    below = views.Horizontal(
        views.TextDocumentView(origin="/about", name="what you see"),
        views.Vertical(views.Horizontal(*criteria[:3]), views.Horizontal(*criteria[3:]), name="criteria"),
        views.time_series("losses", ["/losses/**"], "right", *shown),
        column_shares=[4, 6, 4],
    )
    layout = views.Vertical(views.Horizontal(*scenes), below, row_shares=[5, 4])
    return views.blueprint(layout, STEPS, max(steps / _PLAYING_TIME, 1.0))

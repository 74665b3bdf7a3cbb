"""Trains the universal map of a robot hand on synthetic people."""

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from geort_drake.errors import TrainingError
from geort_drake.files import atomic_path
from geort_drake.hands.kinematics import CollisionShapes, HandKinematics
from geort_drake.people.keypoints import FINGER_KEYPOINTS, TIP_KEYPOINT
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.base import interface_of, thumb_and_others
from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.collision import CollisionGaps
from geort_drake.retargeting.descent import Report, device_of, one_thread
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.soap import Soap
from geort_drake.retargeting.universal.losses import (
    CONSTRAINTS,
    TOUCH,
    Criteria,
    Hands,
    NearCollisions,
    UniversalSettings,
    of_finger,
)
from geort_drake.retargeting.universal.network import UniversalNetwork
from geort_drake.retargeting.universal.person import UniversalRetargeter, hand_shape

SAVE_EVERY_S = 30.0


class TrainingPeople:
    """People whose hands are drawn in batches with one generator.

    Attributes:
        shapes: (N, K, 4F) shapes of each person's hand, m, measured on different parts of their play.
        p_HF: (N, T, F, 3) fingertips, m.
        closable: (F − 1,) whether the robot's thumb can touch each other finger; no other pinch is asked for.
    """

    def __init__(
        self,
        p_HK: np.ndarray,
        finger_names: Sequence[str],
        settings: UniversalSettings,
        generator: torch.Generator,
        rng: np.random.Generator,
        device: torch.device,
    ):
        """Takes keypoints p_HK (N, T, 21, 3), m; `rng` draws anchors and shapes, `generator` the batches."""
        people, self._settings, self._generator, self._device = len(p_HK), settings, generator, device
        thumb, others = thumb_and_others(finger_names)
        self._thumb, self._others = thumb, torch.tensor(others, device=device)
        p_HF, directions = tips_and_directions(p_HK, finger_names)
        anchors = np.zeros((people, len(finger_names), settings.anchors), dtype=int)
        for i, finger in np.ndindex(*anchors.shape[:2]):
            rows = np.sort(first_in_voxels(p_HF[i, :, finger], settings.anchor_voxel_m))
            anchors[i, finger] = rng.choice(rows, settings.anchors)
        shapes = [[hand_shape(part, finger_names) for part in self._parts(each, rng)] for each in p_HK]
        self._anchors = torch.tensor(anchors, device=device)
        self.shapes = torch.tensor(np.array(shapes), device=device)
        self._hands = torch.tensor(np.concatenate([p_HF, directions], -1), dtype=torch.float32, device=device)
        self.p_HF = self._hands[..., :3]
        self.closable = torch.ones(len(others), dtype=torch.bool, device=device)
        d = self.p_HF[:, :, [thumb]] - self.p_HF[:, :, others]
        self._distance, self._pair = d.norm(dim=-1).min(-1)
        self._pinching = [torch.nonzero(row < PINCH_M)[:, 0] for row in self._distance]
        self._near = [torch.nonzero(row < settings.pinch_reach_m)[:, 0] for row in self._distance]

    def _parts(self, p_HK: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
        """Draws parts of a play (T, 21, 3): the whole, a frame, and windows of log-uniform lengths."""
        total, count = len(p_HK), self._settings.shapes_per_person
        lengths = [total, 1, *np.exp(rng.uniform(0.0, np.log(total), max(count - 2, 0))).astype(int)][:count]
        starts = [rng.integers(total - length + 1) for length in lengths]
        return [p_HK[start : start + length] for start, length in zip(starts, lengths, strict=True)]

    def draw(self) -> Hands:
        """Draws a batch."""
        s, (_, frames, fingers, _) = self._settings, self._hands.shape
        people = self._below(len(self._hands), s.people_per_batch)
        G, rows = len(people), people[:, None]
        finger = self._below(fingers, G, s.moved)
        moved = self._hands[rows, self._anchors[rows, finger, self._below(s.anchors, G, s.moved)]]
        other = self._below(frames, G, s.moved, fingers)
        other = self._hands[rows[..., None], other, torch.arange(fingers, device=self._device)]
        mixed = (self._uniform(G, s.moved, 1) < s.mixed) & ~self._one_hot(finger)
        moved = torch.where(mixed[..., None], other, moved)
        shortest, longest = s.step_m
        d = torch.nn.functional.normalize(self._normal(G, s.moved, 3), dim=-1)
        d = d * (shortest + (longest - shortest) * self._uniform(G, s.moved, 1))
        start = self._below(frames - max(s.step_lags), G, s.steps_per_person)
        lags = torch.tensor(s.step_lags, device=self._device)
        lag = lags[self._below(len(lags), G, s.steps_per_person)]
        before, after = self._hands[rows, start], self._hands[rows, start + lag]
        recorded = self._choose(self._pinching, people)
        synthetic, synthetic_rows = self._synthetic_pinches(people)
        pinching = torch.cat([self._hands[rows, recorded], synthetic], 1)
        chosen = torch.cat([recorded, synthetic_rows], 1)
        pair, distance = self._pair[rows, chosen], self._distance[rows, chosen]
        reach = torch.full_like(distance, s.pinch_reach_m)
        reach[:, : s.pinches] = PINCH_M
        groups = [moved, after, pinching]
        offset = self._offset(G, sum(part.shape[1] for part in groups))
        offset[:, -2 * s.pinches : -s.pinches] = 0.0  # recorded pinches stay as they are
        moved_offset, step_offset, pinch_offset = offset.split([part.shape[1] for part in groups], dim=1)
        # Synthetic pinches are displaced before their fingertips are brought together.
        pinch_offset = torch.where(self._in_pair(pair)[..., None], 0.0, pinch_offset)
        return Hands(
            self.shapes[people, self._below(self.shapes.shape[1], G)],
            moved=moved[..., :3] + moved_offset,
            finger=finger,
            d=d,
            before=before[..., :3] + step_offset,
            after=after[..., :3] + step_offset,
            pinching=pinching[..., :3] + pinch_offset,
            pinch_pair=pair,
            pinched=(distance < reach) & self.closable[pair],
            directions=torch.cat(groups, 1)[..., 3:],
        )

    def _synthetic_pinches(self, people: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Moves the nearest pair of hands together; the other fingers may be from other frames.

        Returns the hands, and the frames (G, ·) of the pairs.
        """
        s, rows, shape = self._settings, people[:, None], (len(people), self._settings.pinches)
        chosen = self._choose(self._near, people)
        hands, pair = self._hands[rows, chosen], self._pair[rows, chosen]
        first, second = torch.full_like(pair, self._thumb), self._others[pair]
        a, b = (of_finger(hands, finger) for finger in (first, second))
        half = 0.5 * (b - a)[..., :3] + s.pinch_turn_m * self._normal(*shape, 3)
        length = half.norm(dim=-1, keepdim=True) + 1e-9
        half = half * (0.5 * PINCH_M * self._uniform(*shape, 1) / length).clamp(max=1)
        middle = 0.5 * (a + b)[..., :3] + s.pinch_spread_m * self._normal(*shape, 3)
        elsewhere = self._hands[rows, self._below(self._hands.shape[1], *shape)]
        hands = torch.where(self._uniform(*shape, 1, 1) < s.pinch_mixed, elsewhere, hands)
        for finger, point, direction in ((second, middle + half, b), (first, middle - half, a)):
            new = torch.cat([point, direction[..., 3:]], -1)[:, :, None]
            hands = torch.where(self._one_hot(finger)[..., None], new, hands)
        return hands, chosen

    def _choose(self, candidates: Sequence[torch.Tensor], people: torch.Tensor) -> torch.Tensor:
        """Draws frames (G, pinches) of each person's candidates, or of all if there are none."""
        count = self._settings.pinches
        rows = [
            candidates[i][self._below(len(candidates[i]), count)]
            if len(candidates[i])
            else self._below(self._hands.shape[1], count)
            for i in people.tolist()
        ]
        return torch.stack(rows)

    def _in_pair(self, pair: torch.Tensor) -> torch.Tensor:
        fingers = self._one_hot(self._others[pair])
        fingers[..., self._thumb] = True
        return fingers

    def _offset(self, *shape: int) -> torch.Tensor:
        chosen = (self._uniform(*shape, 1, 1) < self._settings.spread).float()
        return chosen * self._settings.spread_m * self._normal(*shape, self._hands.shape[2], 3)

    def _one_hot(self, finger: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.one_hot(finger, self._hands.shape[2]).bool()

    def _below(self, limit: int, *shape: int) -> torch.Tensor:
        return torch.randint(limit, shape, generator=self._generator).to(self._device)

    def _uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=self._generator).to(self._device)

    def _normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=self._generator).to(self._device)


def affine_size(p_HF: np.ndarray, lengths: np.ndarray, tips: np.ndarray, quantile: float) -> np.ndarray:
    """Returns for each finger the gain of the affine fit times the finger's length (F,), m.

    The fit is that of `AffineIK`: its gain is the ratio of the root mean square distances from the mean of
    the robot's fingertips at uniform joint angles and of the person's in their play.

    Args:
        p_HF: (N, T, F, 3) fingertips of N people, m.
        lengths: (N, F) lengths of their fingers, m.
        tips: (M, F, 3) robot fingertips at uniform joint angles, m.
        quantile: quantile over the people.
    """
    human = np.sqrt(p_HF.var(axis=1).sum(axis=-1))
    robot = np.sqrt(tips.var(axis=0).sum(axis=-1))
    return np.quantile(robot / human * lengths, quantile, axis=0)


class Training:
    """A training, whose state can be saved and restored between any two steps.

    Attributes:
        step: number of steps done.
        seconds: wall time of the steps so far, s.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        shapes: CollisionShapes,
        settings: UniversalSettings,
        p_HK: np.ndarray,
        seed: int,
        device: torch.device,
        start: Mapping[str, np.ndarray],
    ):
        names = kinematics.finger_names
        self._generator, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self.settings, self.step, self.seconds = settings, 0, 0.0
        postures = torch.tensor(np.linspace(kinematics.lower, kinematics.upper, 5))
        facts = json.dumps([seed, dataclasses.asdict(settings)]).encode(), p_HK.tobytes()
        weights = [start[name].tobytes() for name in sorted(start)]
        of_hand = fingertips(kinematics, postures).numpy().round(9).tobytes()
        self._key = hashlib.sha256(b"".join([*facts, of_hand, *weights])).hexdigest()
        self.people = people = TrainingPeople(p_HK, names, settings, self._generator, rng, device)
        lower, upper = torch.tensor(kinematics.lower).float(), torch.tensor(kinematics.upper).float()
        uniform = torch.rand(settings.robot_samples, len(lower), generator=self._generator)
        q = lower + (upper - lower) * uniform
        tips = fingertips(kinematics, q)
        lengths = people.shapes[:, 0, 3 * len(names) :].cpu().numpy()
        size = affine_size(people.p_HF.cpu().numpy(), lengths, tips.numpy(), settings.size_quantile)
        self.network = UniversalNetwork(
            kinematics,
            people.shapes[:, 0].cpu(),
            people.p_HF.cpu(),
            (settings.finger_units, settings.residual_units, settings.shape_units),
            self._generator,
        ).to(device)
        if start:
            self.network.set_arrays(start)
        size_tensor = torch.tensor(size, dtype=torch.float32, device=device)
        self.criteria = Criteria(kinematics, size_tensor, settings)
        nearest = self.criteria.pair_distances(tips).amin(0)
        people.closable = (nearest < TOUCH * kinematics.tip_radius).to(device)
        gaps = CollisionGaps(kinematics, shapes)
        gaps.keep_pairs_that_meet(q[:4000], settings.collision_margin_m)
        self.collisions = NearCollisions(gaps.to(device), settings, self._generator)
        self._multipliers = dict.fromkeys(CONSTRAINTS, settings.multiplier_start)
        self._figures: dict[str, float] = {}  # running means
        groups = self.network.groups(settings.weight_decay, settings.shared_weight_decay)
        self._optimiser = Soap(groups, lr=settings.learning_rate, betas=settings.momentum, clip=settings.clip)
        decay = max(1.0 - settings.averages / settings.steps, 0.0)
        self.average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(decay**settings.average_every)
        )
        self._posture, self._collided = 1.0, torch.zeros((), device=device)
        # What `save` keeps: states of these parts, and these attributes.
        self._parts: dict[str, Any] = {
            "network": self.network,
            "average": self.average,
            "optimiser": self._optimiser,
        }
        self._attributes: list[tuple[Any, str]] = [
            *((self, name) for name in ("step", "seconds", "_posture", "_collided")),
            (self, "_multipliers"),
            (self, "_figures"),
            (self.collisions, "memory"),
        ]

    def advance(self) -> None:
        """Takes one step.

        Raises:
            TrainingError: the loss is not finite.
        """
        started, s, step = time.perf_counter(), self.settings, self.step
        rate = s.learning_rate * 0.5 * (1.0 + math.cos(math.pi * step / s.steps))
        for group in self._optimiser.param_groups:
            group["lr"] = rate * min((step + 1) / (min(s.warm_up, s.steps // 10) + 1), 1.0)
        hands = self.people.draw()
        posture, terms = self.criteria(self.network, hands)
        losses = {name: loss for name, (loss, _) in terms.items()}
        figures = {name: figure for name, (_, figure) in terms.items()}
        if step % s.collision_search_every == 0:
            self._collided = self.collisions.search(self.network, hands)
        # Of the last search, so that its multiplier is as fast as the others.
        figures["collision"] = self._collided
        if step % s.collision_every == 0 and (loss := self.collisions.loss(self.network)) is not None:
            losses["collision"] = loss
        self._update_multipliers(figures)
        first = max(1.0 - step / (s.posture_first_share * s.steps), 0.0)
        total = s.posture_weight * (1.0 + (s.posture_first - 1.0) * first) * posture
        total = total + sum(self._multipliers[name] * loss for name, loss in losses.items())
        if not torch.isfinite(total):
            raise TrainingError(f"the loss stopped being finite at step {step}")
        self._posture += s.figure_averaging * (float(posture.detach()) - self._posture)
        self.network.zero_grad()
        total.backward()
        self._optimiser.step()
        self.step += 1
        if 2 * self.step >= s.steps and (s.steps - self.step) % s.average_every == 0:
            self.average.update_parameters(self.network)
        self.seconds += time.perf_counter() - started

    def _update_multipliers(self, figures: Mapping[str, torch.Tensor]) -> None:
        """Updates the multiplier of each constraint figure ≤ bound by multiplicative dual ascent.

        The figures of batches are noisy, so each is averaged over about fifty batches.
        """
        s = self.settings
        least, most = s.multiplier_bounds
        lowest, highest = s.violation_bounds
        for name, figure in figures.items():
            value = float(figure.detach())
            mean = self._figures.get(name, value)
            self._figures[name] = mean = mean + s.figure_averaging * (value - mean)
            violation = min(max(mean / getattr(s, name) - 1.0, lowest), highest)
            rate = s.collision_rate if name == "collision" else s.multiplier_rate
            value = self._multipliers[name] * math.exp(rate * violation)
            self._multipliers[name] = min(max(value, least), most)

    def figures(self) -> dict[str, float]:
        """Returns the running mean of each constraint's figure, and of "posture", 1 − cosine."""
        return {**self._figures, "posture": self._posture}

    def save(self, path: Path) -> None:
        """Writes the state, atomically."""
        state = {
            "key": self._key,
            "generator": self._generator.get_state(),
            "parts": {name: part.state_dict() for name, part in self._parts.items()},
            "attributes": [getattr(owner, name) for owner, name in self._attributes],
        }
        with atomic_path(path) as draft, open(draft, "wb") as file:
            torch.save(state, file)

    def restore(self, path: Path) -> None:
        """Restores the state.

        Raises:
            TrainingError: the file is damaged, or of a training with other settings.
        """
        try:
            state = torch.load(path, map_location=self.people.shapes.device, weights_only=True)
            key = state["key"]
        except Exception as error:  # torch raises exceptions of many types for damaged files
            raise TrainingError(f"{path}: not the state of a training; delete it: {error}") from error
        if key != self._key:
            raise TrainingError(
                f"{path}: the state of a training with other settings, people or hand; delete it, or use the "
                "same settings"
            )
        self._generator.set_state(state["generator"].cpu())
        for name, part in self._parts.items():
            part.load_state_dict(state["parts"][name])
        for (owner, name), value in zip(self._attributes, state["attributes"], strict=True):
            setattr(owner, name, value)


def train_universal(
    kinematics: HandKinematics,
    shapes: CollisionShapes,
    settings: UniversalSettings,
    p_HK: np.ndarray,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
    state: Path | None = None,
    start: UniversalRetargeter | None = None,
) -> UniversalRetargeter:
    """Trains a universal map on the population of `geort_drake.people`.

    Args:
        kinematics, shapes: kinematics and collision shapes of the robot hand, mirrored for a left hand.
        settings: settings of the training, which are valid.
        p_HK: (N, T, 21, 3) keypoints of the people, m; see `population.sample_population`.
        seed: seed of the initial weights and all draws.
        device: "cpu" or "cuda".
        report: called as report(steps done, total steps, figures), about a hundred times.
        state: file from which the training resumes, if it exists, and to which it saves its state about every
            half minute; deleted at the end. The result does not depend on interruptions.
        start: map of the same hand, from whose weights the training starts; None starts from random ones.

    Returns:
        The map; its `info` has the settings, and the figures and the time of the training.

    Raises:
        TrainingError: the file is of another training, or the loss is not finite at some step.
    """
    with one_thread():
        weights = {} if start is None else start.arrays
        training = Training(kinematics, shapes, settings, p_HK, seed, device_of(device), weights)
        if state is not None and state.is_file():
            training.restore(state)
        last_save = time.monotonic()
        while training.step < settings.steps:
            training.advance()
            if state is not None and time.monotonic() - last_save > SAVE_EVERY_S:
                training.save(state)
                last_save = time.monotonic()
            if report is not None and (
                training.step % max(settings.steps // 100, 1) == 0 or training.step == settings.steps
            ):
                report(training.step, settings.steps, training.figures())
    network = cast(UniversalNetwork, training.average.module)
    result = UniversalRetargeter(*interface_of(kinematics), network.arrays())
    result.info = {
        "method": "universal",
        "config": {**dataclasses.asdict(settings), "seed": seed, "device": device},
        "figures": {name: round(value, 6) for name, value in training.figures().items()},
        "provenance": {"seconds": round(training.seconds, 1)},
    }
    if state is not None:
        state.unlink(missing_ok=True)
    return result


def tips_and_directions(p_HK: np.ndarray, finger_names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Returns fingertips, m, and unit vectors along the distal bones, (..., F, 3), of p_HK (..., 21, 3)."""
    tips = p_HK[..., [TIP_KEYPOINT[name] for name in finger_names], :]
    u = tips - p_HK[..., [FINGER_KEYPOINTS[name][-2] for name in finger_names], :]
    return tips, u / np.maximum(np.linalg.norm(u, axis=-1, keepdims=True), 1e-9)

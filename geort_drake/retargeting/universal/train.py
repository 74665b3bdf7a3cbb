"""Trains the universal map of a robot hand on synthetic people."""

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from geort_drake.errors import TrainingError
from geort_drake.files import atomic_path
from geort_drake.hands.kinematics import CollisionShapes, HandKinematics
from geort_drake.people.synthetic.population import sample_population
from geort_drake.retargeting.collision import CollisionGaps
from geort_drake.retargeting.descent import device_of, one_thread
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.soap import Soap
from geort_drake.retargeting.universal.batches import TrainingPeople
from geort_drake.retargeting.universal.losses import TOUCH, Criteria, Multipliers, NearCollisions
from geort_drake.retargeting.universal.network import UniversalNetwork
from geort_drake.retargeting.universal.person import UniversalRetargeter
from geort_drake.retargeting.universal.settings import CONSTRAINTS, UniversalSettings

AVERAGE_EVERY = 5  # steps, within which weights hardly move
SAVE_EVERY_S = 30.0
# Called as report(steps done, total steps, figures by name) about a hundred times per training.
Report = Callable[[int, int, dict[str, float]], None]


def _digest(kinematics: HandKinematics, seed: int) -> bytes:
    q = np.linspace(kinematics.lower, kinematics.upper, 5)
    return fingertips(kinematics, torch.tensor(q)).numpy().round(9).tobytes() + str(seed).encode()


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
    ):
        names = kinematics.finger_names
        self._generator, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self.settings, self.step, self.seconds = settings, 0, 0.0
        self._key = hashlib.sha256(
            json.dumps(dataclasses.asdict(settings)).encode() + p_HK.tobytes() + _digest(kinematics, seed)
        ).hexdigest()
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
            people.pairs,
            (settings.finger_units, settings.residual_units, settings.shape_units),
            self._generator,
        ).to(device)
        size_tensor = torch.tensor(size, dtype=torch.float32, device=device)
        self.criteria = Criteria(kinematics, people.pairs, size_tensor, settings)
        nearest = self.criteria.pair_distances(tips).amin(0)
        people.closable = (nearest < TOUCH * kinematics.tip_radius).to(device)
        gaps = CollisionGaps(kinematics, shapes)
        gaps.keep_pairs_that_meet(q[:4000], settings.collision_margin_m)
        self.collisions = NearCollisions(gaps.to(device), settings, self._generator)
        self.multipliers = Multipliers({name: getattr(settings, name) for name in CONSTRAINTS}, settings)
        groups = self.network.groups(settings.weight_decay)
        self._optimiser = Soap(groups, lr=settings.learning_rate, betas=settings.momentum, clip=settings.clip)
        decay = max(1.0 - settings.averaged_steps / settings.steps, 0.0)
        self._average = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(decay**AVERAGE_EVERY))
        self._posture, self._collided = 1.0, torch.zeros((), device=device)

    def start_from(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Sets the weights before the first step."""
        self.network.set_arrays(arrays)
        weights = b"".join(arrays[name].tobytes() for name in sorted(arrays))
        self._key = hashlib.sha256(self._key.encode() + weights).hexdigest()

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
        self.multipliers.update(figures)
        first = max(1.0 - step / (s.posture_first_share * s.steps), 0.0)
        total = s.posture_weight * (1.0 + (s.posture_first - 1.0) * first) * posture
        total = total + sum(self.multipliers.values[name] * loss for name, loss in losses.items())
        if not torch.isfinite(total):
            raise TrainingError(f"the loss stopped being finite at step {step}")
        self._posture += s.figure_averaging * (float(posture.detach()) - self._posture)
        self.network.zero_grad()
        total.backward()
        self._optimiser.step()
        self.step += 1
        if 2 * self.step >= s.steps and (s.steps - self.step) % AVERAGE_EVERY == 0:
            self._average.update_parameters(self.network)
        self.seconds += time.perf_counter() - started

    def figures(self) -> dict[str, float]:
        """Returns the running mean of each constraint's figure, and of "posture", 1 − cosine."""
        return {**self.multipliers.figures, "posture": self._posture}

    def result(self) -> UniversalNetwork:
        """Returns the network, with averaged weights after the second half of the steps."""
        return cast(UniversalNetwork, self._average.module) if self._average.n_averaged > 0 else self.network

    def save(self, path: Path) -> None:
        """Writes the state, atomically."""
        state = {
            "key": self._key,
            "step": self.step,
            "seconds": self.seconds,
            "posture": self._posture,
            "collided": self._collided,
            "network": self.network.state_dict(),
            "average": self._average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "multipliers": self.multipliers.values,
            "figures": self.multipliers.figures,
            "collisions": [self.collisions.hands, self.collisions.shapes],
            "generator": self._generator.get_state(),
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
        self.step, self.seconds, self._posture = state["step"], state["seconds"], state["posture"]
        self.network.load_state_dict(state["network"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.multipliers.values, self.multipliers.figures = state["multipliers"], state["figures"]
        self._collided = state["collided"]
        self.collisions.hands, self.collisions.shapes = state["collisions"]
        self._generator.set_state(state["generator"].cpu())


def train_universal(
    kinematics: HandKinematics,
    shapes: CollisionShapes,
    settings: UniversalSettings | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
    state: Path | None = None,
    start: UniversalRetargeter | None = None,
    p_HK: np.ndarray | None = None,
) -> UniversalRetargeter:
    """Trains a universal map on the population of `geort_drake.people`.

    Args:
        kinematics, shapes: kinematics and collision shapes of the robot hand, mirrored for a left hand.
        settings: settings of the training; None for the defaults.
        seed: seed of the population, the initial weights and all draws.
        device: "cpu" or "cuda".
        report: called as report(steps done, total steps, figures), about a hundred times.
        state: file from which the training resumes, if it exists, and to which it saves its state about every
            half minute; deleted at the end. The result does not depend on interruptions.
        start: map of the same hand, from whose weights the training starts; None starts from random ones.
        p_HK: (N, T, 21, 3) keypoints of the people, m; None samples them, which takes minutes.

    Returns:
        The map; its `info` has the settings, and the figures and the time of the training.

    Raises:
        TrainingError: a setting is out of range, the hand has no thumb or no other finger, the file is of
            another training, or the loss is not finite at some step.
    """
    settings = settings or UniversalSettings()
    settings.validate()
    names = kinematics.finger_names
    if "thumb" not in names or len(names) < 2:
        raise TrainingError(f"the hand needs a thumb and another finger, it has {', '.join(names)}")
    if p_HK is None:
        p_HK = sample_population(settings.people, seed, settings.play_s)
    with one_thread():
        training = Training(kinematics, shapes, settings, p_HK, seed, device_of(device))
        if start is not None:
            training.start_from(start.arrays)
        if state is not None and state.is_file():
            training.restore(state)
        saved = time.monotonic()
        while training.step < settings.steps:
            training.advance()
            if state is not None and time.monotonic() - saved > SAVE_EVERY_S:
                training.save(state)
                saved = time.monotonic()
            if report is not None and (
                training.step % max(settings.steps // 100, 1) == 0 or training.step == settings.steps
            ):
                report(training.step, settings.steps, training.figures())
    limits = (kinematics.lower, kinematics.upper)
    result = UniversalRetargeter(names, kinematics.joint_names, None, *limits, training.result().arrays())
    result.info = {
        "method": "universal",
        "config": {**dataclasses.asdict(settings), "seed": seed, "device": device},
        "figures": {name: round(value, 6) for name, value in training.figures().items()},
        "provenance": {"seconds": round(training.seconds, 1)},
    }
    if state is not None:
        state.unlink(missing_ok=True)
    return result

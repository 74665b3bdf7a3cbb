"""Compares retargeting methods on one hand with the same recordings, protocols and metrics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geort_drake.comparison.metric_table import mean, worst
from geort_drake.comparison.metrics import (
    MIN_FRAMES,
    RobotSpace,
    adapted,
    evaluate_frames,
    pinch,
    robot_space,
)
from geort_drake.comparison.protocols import HELD_OUT, SAME_PERSON, Case, Protocol
from geort_drake.errors import CheckpointError, GeortError, RecordingError
from geort_drake.files import finite_json
from geort_drake.hands.model import HandModel
from geort_drake.methods import PYTHON_SUFFIX, resolve
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.online import AnyTeleop
from geort_drake.retargeting.store import load_retargeter


@dataclass(frozen=True)
class Evaluation:
    """Metrics of a method on a recording, and the fingertips from which they were computed.

    Attributes:
        metrics: metrics from `evaluate_frames`; JSON types only.
        remembers: whether outputs depend on earlier frames.
        p_HF: (T, F, 3) human fingertips of the scored frames in H, m.
        p_BF: (T, F, 3) robot fingertips in B, m; mirrored for a left hand.
    """

    metrics: dict
    remembers: bool
    p_HF: np.ndarray
    p_BF: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """Result of a case of a protocol with one seed: metrics, or the error that prevented them."""

    case: Case
    seed: int
    evaluation: Evaluation | None = None
    error: str = ""


class Comparison:
    """Evaluates methods one by one under the same protocols.

    An online method gets the recorded frames in order, from rest. Metrics of hands that were not recorded use
    its stationary outputs; see `AnyTeleop.settled_map`. A universal map gets only the first second of the
    scored recording to learn the person.

    Args:
        hand: model of the robot hand.
        protocols: protocols that define the training and scored recordings.
        seeds: seeds of training and metrics; all cases run with each of them.
        frame_limit: largest number of valid frames, from the first on, of each scored recording or block.
    """

    def __init__(
        self,
        hand: HandModel,
        protocols: Sequence[Protocol],
        seeds: Sequence[int],
        frame_limit: int | None = None,
    ):
        self.hand, self.protocols, self.seeds = hand, tuple(protocols), tuple(seeds)
        self.frame_limit = frame_limit
        self._spaces: dict[int, RobotSpace] = {}

    @property
    def cases_per_method(self) -> int:
        """Number of cases that `run` evaluates, over all seeds."""
        return len(self.seeds) * sum(len(protocol.cases) for protocol in self.protocols)

    def run(self, name: str, starts: Callable[[str], None] = lambda _note: None) -> dict[str, list[Outcome]]:
        """Evaluates one method under every protocol.

        Args:
            name: name of a method, or path of a checkpoint or map for this hand.
            starts: called with a description before each case.

        Returns:
            Name of each protocol → outcomes. A failed case has an error; the others continue.
        """
        results: dict[str, list[Outcome]] = {}
        for protocol in self.protocols:
            results[protocol.name] = outcomes = []
            for seed in self.seeds:
                for case in protocol.cases:
                    starts(f"{Path(name).name}, {case.part}, seed {seed}")
                    try:
                        outcomes.append(Outcome(case, seed, self._evaluate(name, protocol, case, seed)))
                    except GeortError as error:
                        outcomes.append(Outcome(case, seed, error=str(error)))
        return results

    def summary(self, outcomes: Sequence[Outcome]) -> dict[str, dict | None]:
        """Summarises the metrics of one method under one protocol over parts and seeds.

        Returns:
            `mean`: mean over seeds of the means over parts; pinch metrics use the frames of all parts
                together;
            `worst_part`: each metric's worst value over parts and seeds, or None for a single part;
            `worst_seed`: each metric's worst value over the seeds' means, or None for a single seed.
        """
        done = [outcome.evaluation for outcome in outcomes if outcome.evaluation]
        pooled = [
            self._pooled(parts)
            for seed in self.seeds
            if (parts := [o.evaluation for o in outcomes if o.seed == seed and o.evaluation])
        ]
        several_parts = len({outcome.case.part for outcome in outcomes}) > 1
        return {
            "mean": mean(pooled) if pooled else None,
            "worst_part": worst([evaluation.metrics for evaluation in done])
            if done and several_parts
            else None,
            "worst_seed": worst(pooled) if pooled and len(self.seeds) > 1 else None,
        }

    def _pooled(self, parts: Sequence[Evaluation]) -> dict:
        frames = np.concatenate([part.p_HF for part in parts])
        p_BF = np.concatenate([part.p_BF for part in parts])
        pinches = pinch(frames, p_BF, self.hand.finger_names, self.hand.tip_radius)
        return {**mean([part.metrics for part in parts]), "pinch": pinches}

    def _evaluate(self, name: str, protocol: Protocol, case: Case, seed: int) -> Evaluation:
        source = case.scored_on
        frames = source.fingertips(self.hand.description.human_keypoints)[: self.frame_limit]
        if len(frames) < MIN_FRAMES:
            raise RecordingError(f"{case.part}: {len(frames)} valid frames, at least {MIN_FRAMES} are needed")
        retarget = self._retargeter(name, protocol, case, seed)
        settled = None
        if isinstance(retarget, AnyTeleop):
            settled = retarget.settled_map(frames)
            retarget.reset()
        metrics, p_BF = evaluate_frames(
            retarget,
            self.hand,
            frames,
            source.rate_hz,
            seed,
            self.space(seed) if protocol.with_coverage else None,
            settled,
        )
        return Evaluation(finite_json(metrics), settled is not None, frames, p_BF)

    def _retargeter(self, name: str, protocol: Protocol, case: Case, seed: int) -> Callable:
        if name not in METHODS and Path(name).suffix != PYTHON_SUFFIX:
            _check_training(name, protocol, case)
        retarget, _ = resolve(name, self.hand, case.trained_on, seed)
        return adapted(retarget, case.scored_on)

    def space(self, seed: int) -> RobotSpace:
        """Returns the C-space of the hand, sampled with this seed."""
        if seed not in self._spaces:
            self._spaces[seed] = robot_space(self.hand, seed)
        return self._spaces[seed]


def _check_training(name: str, protocol: Protocol, case: Case) -> None:
    """Raises CheckpointError unless the training of a map of one person fits the protocol."""
    recording = load_retargeter(name).info.get("provenance", {}).get("recording")
    if recording is None:
        return  # a universal map
    if protocol.name == HELD_OUT:
        raise CheckpointError(f"{name}: a map cannot be trained without the block; name its method instead")
    known = recording["sha256"] == case.scored_on.digest
    if protocol.name == SAME_PERSON and not known:
        raise CheckpointError(
            f"{name}: was trained on another recording than {case.part}; give that one to --recording, "
            "and this one to --score-on"
        )
    if protocol.name != SAME_PERSON and known:
        raise CheckpointError(f"{name}: was trained on {case.part}; give another person's recording")

"""Trains the universal map of a robot hand and writes its file."""

import dataclasses
import os

import numpy as np
import torch

from geort_drake.console import progress_bar
from geort_drake.errors import UnknownNameError
from geort_drake.files import reserved
from geort_drake.hands.collision_shapes import canonical_shapes
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.map_file import MAX_BYTES, MapFile
from geort_drake.retargeting.methods.coupled import UNIVERSAL_CONFIG, CoupledConfig
from geort_drake.retargeting.methods.coupled.training import train_universal
from geort_drake.versions import git_state, versions

_MIRRORED = {"right": "left", "left": "right"}


def pretrain(
    description: HandDescription,
    output: str | os.PathLike,
    config: CoupledConfig = UNIVERSAL_CONFIG,
    people: int = 800,
    seed: int = 0,
    device: str = "cpu",
    show_progress: bool = True,
) -> dict[str, float]:
    """Trains the universal map of a hand and writes it to a file; see `MapFile`.

    The map also serves the hand's mirror image, if there is one whose name has the other side.

    Args:
        description: the robot hand.
        output: path of the file.
        config: settings of the training.
        people: number of people in the population.
        seed: seed of the population and the training.
        device: "cpu" or "cuda".
        show_progress: draw progress bars on stderr.

    Returns:
        The final figures of the training; see `UniversalTraining`.

    Raises:
        HandError, TrainingError: the hand or a setting is unusable.
        OutputError: the file cannot be written; found before the training.
    """
    hand = HandModel(description)
    with reserved(output, MAX_BYTES), progress_bar(show_progress) as bars:
        result = train_universal(
            canonical_kinematics(hand),
            canonical_shapes(hand),
            config,
            people,
            seed,
            device,
            bars.losses("training", None),
        )
    MapFile(
        result.arrays,
        hands={description.name: hand.digest} | _mirror_image(hand),
        finger_names=hand.finger_names,
        joint_names=hand.joint_names,
        human_keypoints=description.human_keypoints,
        lower=hand.lower.tolist(),
        upper=hand.upper.tolist(),
        training={**dataclasses.asdict(config), "people": people, "seed": seed},
        provenance={
            "versions": versions(),
            "git": git_state(),
            "seconds": round(result.seconds, 1),
            "figures": {name: round(value, 6) for name, value in result.figures.items()},
        },
    ).save(output)
    return result.figures


def _mirror_image(hand: HandModel) -> dict[str, str]:
    """Returns name → digest of the hand's mirror image; empty if there is none."""
    side = hand.description.side
    try:
        other = HandModel(hand.description.name.replace(side, _MIRRORED[side]))
    except UnknownNameError:
        return {}
    if other.joint_names != hand.joint_names or other.description.side == side:
        return {}
    q = torch.tensor(np.random.default_rng(0).uniform(hand.lower, hand.upper, (100, len(hand.lower))))
    tips, mirrored = (canonical_kinematics(each).fingertips(q).numpy() for each in (hand, other))
    same = np.allclose(tips, mirrored, atol=1e-6) and np.allclose(hand.lower, other.lower)
    return {other.description.name: other.digest} if same and np.allclose(hand.upper, other.upper) else {}

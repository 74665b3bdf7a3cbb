"""Codes of the population's people, and their plays transferred to another person's hand."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.population import sample_population
from geort_drake.retargeting.person_code import AveragePerson, Observation, average_person, observe

CODES = 8  # per person: of one frame, of the whole play and of windows of random lengths
WHOLE = 1  # index of the code of the whole play


@dataclass(frozen=True)
class CodedPeople:
    """Codes of N people with F fingers, from their plays.

    Attributes:
        codes: (N, CODES, C) codes of each person.
        reach: (N, F) number of places that a fingertip visits, over the average person's; at most 1.
        average: the average person, the prior of the codes.
    """

    codes: torch.Tensor
    reach: torch.Tensor
    average: AveragePerson


def code_people(p_HK: np.ndarray, finger_names: Sequence[str], rng: np.random.Generator) -> CodedPeople:
    """Computes the codes of N people from keypoints p_HK (N, T, 21, 3), m, of whole plays and their parts."""
    observations = [[observe(part, finger_names) for part in _parts(each, rng)] for each in p_HK]
    whole = [row[WHOLE] for row in observations]
    average = average_person(whole, observations)
    codes = torch.tensor(np.array([[average.code(one) for one in row] for row in observations]))
    return CodedPeople(codes, _relative_reach(whole), average)


def likely_plays(
    p_HK: np.ndarray, finger_names: Sequence[str], seed: int, people: int = 8, duration_s: float = 60.0
) -> np.ndarray:
    """Transfers plays of the population to the hand of the person in keypoints p_HK (T, 21, 3), m.

    Knuckles are aligned, and each fingertip's offset from its knuckle is scaled with the finger's length.

    Returns:
        Fingertips (people, frames, F, 3) in H, m.
    """
    person, tips = observe(p_HK, finger_names), [TIP_KEYPOINT[name] for name in finger_names]
    centred = person.knuckles - person.knuckles.mean(axis=0)
    plays = []
    for play in sample_population(people, seed, duration_s):
        other = observe(play.astype(float), finger_names)
        R, _ = Rotation.align_vectors(centred, other.knuckles - other.knuckles.mean(axis=0))
        x = (play[:, tips] - other.knuckles) / other.lengths[:, None]
        plays.append(person.knuckles + person.lengths[:, None] * (x @ R.as_matrix().T))
    return np.array(plays)


def _parts(p_HK: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Draws CODES parts of a play (T, 21, 3): a frame, the whole, and windows of log-uniform lengths."""
    total = len(p_HK)
    lengths = [1, total, *np.exp(rng.uniform(0.0, np.log(total), CODES - 2)).astype(int)]
    starts = [rng.integers(total - length + 1) for length in lengths]
    return [p_HK[start : start + length] for start, length in zip(starts, lengths, strict=True)]


def _relative_reach(whole: Sequence[Observation]) -> torch.Tensor:
    places = torch.tensor(np.array([each.places for each in whole]), dtype=torch.float32)
    return (places / places.mean(0)).clamp(max=1.0)

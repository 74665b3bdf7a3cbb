"""The person code: numbers that describe a person to the universal map, in addition to the fingertips.

The code contains the shape of the hand and the reach of each fingertip. Reach is the mean and covariance of
the places that a fingertip visited, regardless of how long it stayed there. A Bayesian estimate starts at the
average person's reach and approaches the observed one as places are added.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geort_drake.people.keypoints import BASE_KEYPOINT, FINGER_KEYPOINTS, TIP_KEYPOINT
from geort_drake.retargeting.clouds import first_in_voxels

PLACE = 0.005  # m; edge of the voxels that count as one place
_WEIGHTS = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0)  # candidate weights of the prior, in places
_LOWER = np.tril_indices(3)
# Parts of the code, and the number of values of each per finger.
CODE_PARTS = {"base": 3, "length": 1, "reach": 3, "spread": 1, "covariance": 6, "places": 1}
CODE_SIZE = sum(CODE_PARTS.values())


@dataclass(frozen=True)
class Observation:
    """Statistics of a person's F fingers over some frames.

    Attributes:
        knuckles: (F, 3) base points of the fingers (the thumb's CMC) in H, m; medians over the frames.
        lengths: (F,) lengths from base to tip along the bones, m; medians over the frames.
        places: (F,) number of places that the tip visited.
        mean: (F, 3) mean of these places relative to the knuckle, over the finger's length.
        scatter: (F, 3, 3) sum over these places of the outer products of their deviations from the mean.
    """

    knuckles: np.ndarray
    lengths: np.ndarray
    places: np.ndarray
    mean: np.ndarray
    scatter: np.ndarray


def observe(p_HK: np.ndarray, finger_names: Sequence[str]) -> Observation:
    """Computes the statistics of a person from finite keypoints p_HK (T, 21, 3), m, with T ≥ 1."""
    chains = np.array([FINGER_KEYPOINTS[name] for name in finger_names])
    bones = np.linalg.norm(np.diff(p_HK[:, chains], axis=2), axis=-1)
    knuckles = np.median(p_HK[:, [BASE_KEYPOINT[name] for name in finger_names]], axis=0)
    lengths = np.median(bones, axis=0).sum(axis=1)
    places, mean, scatter = [], [], []
    for name, knuckle, length in zip(finger_names, knuckles, lengths, strict=True):
        p_HF = p_HK[:, TIP_KEYPOINT[name]]
        x = (p_HF[first_in_voxels(p_HF, PLACE)] - knuckle) / length
        deviation = x - x.mean(axis=0)
        places.append(len(x))
        mean.append(x.mean(axis=0))
        scatter.append(deviation.T @ deviation)
    return Observation(knuckles, lengths, np.array(places), np.array(mean), np.array(scatter))


@dataclass(frozen=True)
class AveragePerson:
    """The reach of an average person and its weight: a normal-inverse-Wishart prior.

    Attributes:
        mean: (F, 3) mean of the places that a tip visits; see `Observation`.
        covariance: (F, 3, 3) covariance of these places.
        mean_weight, covariance_weight: number of observed places to which the prior is equivalent.
    """

    mean: np.ndarray
    covariance: np.ndarray
    mean_weight: float
    covariance_weight: float

    def code(self, observation: Observation) -> np.ndarray:
        """Computes the code (15 F,) of a person, float32.

        Its parts, each for all fingers: knuckle (3), length, mean of the reach (3), its spread (root of the
        mean variance per axis), its covariance as a Cholesky factor (6), log of 1 + places.
        """
        n, weight = observation.places, self.mean_weight
        mean = (n[:, None] * observation.mean + weight * self.mean) / (n + weight)[:, None]
        d = observation.mean - self.mean
        between = (weight * n / (weight + n))[:, None, None] * d[:, :, None] * d[:, None, :]
        prior = self.covariance_weight * self.covariance
        count = (n + self.covariance_weight)[:, None, None]
        covariance = (observation.scatter + between + prior) / count
        factor = np.linalg.cholesky(covariance)[:, _LOWER[0], _LOWER[1]]
        spread = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)
        # In the order of CODE_PARTS.
        parts = (observation.knuckles, observation.lengths, mean, spread, factor, np.log1p(n))
        return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the prior as arrays, for files."""
        weights = np.array([self.mean_weight, self.covariance_weight])
        return {"reach_mean": self.mean, "reach_covariance": self.covariance, "reach_weights": weights}

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray]) -> "AveragePerson":
        """Makes the prior from the result of `arrays`."""
        weights = map(float, arrays["reach_weights"])
        return AveragePerson(arrays["reach_mean"], arrays["reach_covariance"], *weights)


def average_person(whole: Sequence[Observation], parts: Sequence[Sequence[Observation]]) -> AveragePerson:
    """Averages people, and finds the weights with which parts of a play best predict the whole play.

    Args:
        whole: observations of the whole plays of N people.
        parts: observations of parts of each person's play.
    """
    covariances = np.array([each.scatter / each.places[:, None, None] for each in whole])
    means = np.array([each.mean for each in whole])
    mean, covariance = means.mean(axis=0), covariances.mean(axis=0)
    variance = np.trace(covariance, axis1=1, axis2=2)
    log_variances = np.log(np.trace(covariances, axis1=2, axis2=3))
    n = np.array([[each.places for each in row] for row in parts], dtype=float)
    seen = np.array([[each.mean for each in row] for row in parts])
    scatter = np.array([[np.trace(each.scatter, axis1=1, axis2=2) for each in row] for row in parts])

    def mean_error(weight: float) -> float:
        estimate = (n[..., None] * seen + weight * mean) / (n + weight)[..., None]
        return float((np.square(estimate - means[:, None]).sum(axis=-1) / variance).mean())

    mean_weight = min(_WEIGHTS, key=mean_error)
    between = mean_weight * n / (mean_weight + n) * np.square(seen - mean).sum(axis=-1)

    def covariance_error(weight: float) -> float:
        estimate = np.log((scatter + between + weight * variance) / (n + weight))
        return float(np.square(estimate - log_variances[:, None]).mean())

    return AveragePerson(mean, covariance, mean_weight, min(_WEIGHTS, key=covariance_error))

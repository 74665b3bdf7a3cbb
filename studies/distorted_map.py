"""A good map, distorted in known ways after its training, and the design of such maps.

Each distortion spoils one criterion and hardly the others, so a difference in what a person achieves has a
known cause. Differences between methods have no single cause, because their figures are correlated.
"""

import dataclasses as dc
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.retargeting.base import Retarget, Retargeter, forget

RIPPLE_LENGTH = 0.008  # m
# Distances of thumb and finger at which they pinch fully, and not at all, m.
PINCHED, APART = 0.02, 0.06


@dc.dataclass(frozen=True)
class Distortion:
    """How a map is distorted; the defaults do not.

    Attributes:
        rotation: of each finger's motion about an axis of its own, rad.
        gain: largest over smallest factor of the gain along an axis; it varies over a finger's range.
        cross_talk: fraction of every other finger's motion that is added to a finger's.
        gap: added between the thumb and a finger that pinch, in the person's hand, m.
        reach: fraction by which motion about the mean posture is reduced.
        ripple: amplitude of a wave of `RIPPLE_LENGTH` along each axis, m.
        latency: from keypoints to joint targets, s; not part of the map's answers.
    """

    rotation: float = 0.0
    gain: float = 1.0
    cross_talk: float = 0.0
    gap: float = 0.0
    reach: float = 0.0
    ripple: float = 0.0
    latency: float = 0.002


FACTORS = tuple(field.name for field in dc.fields(Distortion))
COPIES = 3  # of each map of the design
# The levels −1, 0 and 1 of each factor. A map's own gain already varies by a factor of about 3.5.
LEVELS = {
    "rotation": (0.0, np.pi / 12, np.pi / 6),
    "gain": (1.0, 2.0, 4.0),
    "cross_talk": (0.0, 0.075, 0.15),
    "gap": (0.0, 0.006, 0.012),
    "reach": (0.0, 0.15, 0.3),
    "ripple": (0.0, 0.00025, 0.0005),
    "latency": (0.002, 0.016, 0.03),
}


def design() -> dict[str, tuple[int, ...]]:
    """Name of each of 96 maps → its level −1, 0 or 1 of each factor.

    A fraction 2^(7−3) of resolution IV; axial maps, with one factor at −1 or 1 and the others at 0; and the
    centre twice: all of it `COPIES` times. All maps differ in their random axes and phases.
    """
    runs: dict[str, tuple[int, ...]] = {}
    for number, (a, b, c, d) in enumerate(itertools.product((-1, 1), repeat=4), start=1):
        runs[f"corner_{number:02}"] = (a, b, c, d, a * b * c, b * c * d, a * c * d)
    for place, factor in enumerate(FACTORS):
        for level, name in ((-1, "low"), (1, "high")):
            runs[f"{factor}_{name}"] = tuple(level * (k == place) for k in range(len(FACTORS)))
    runs |= {f"centre_{k}": (0,) * len(FACTORS) for k in (1, 2)}
    return {f"{name}_{copy}": levels for copy in range(1, COPIES + 1) for name, levels in runs.items()}


def half(runs: dict[str, tuple[int, ...]]) -> list[str]:
    """Names of half the maps of `design`: a fraction 2^(7−4), and the axial maps of every second factor."""
    corners = [name for name, x in runs.items() if all(x) and x[0] * x[1] * x[3] == 1]
    axial = [f"{factor}_{end}" for factor in FACTORS[::2] for end in ("low", "high")]
    return corners + [f"{name}_{copy}" for copy in range(1, COPIES + 1) for name in axial]


def distortion_of(levels: Sequence[int]) -> Distortion:
    """The distortion of levels −1, 0 or 1."""
    return Distortion(*(LEVELS[name][level + 1] for name, level in zip(FACTORS, levels, strict=True)))


class DistortedMap(Retargeter):
    """A map whose inputs are distorted.

    All but ripple and gap vanish where a finger and the thumb pinch, lest every distortion open pinches.
    """

    def __init__(
        self,
        retarget: Retarget,
        frames: np.ndarray,
        keypoints: Sequence[int],
        distortion: Distortion,
        seed: int,
    ):
        """
        Args:
            retarget: the map; has the attributes above.
            frames: (T, F, 3) recorded human fingertips in H, m, around whose mean inputs are distorted.
            keypoints: F numbers of the keypoints that are the fingertips.
            distortion: of the map; its latency has no effect here.
            seed: of axes and phases.
        """
        self._retarget, self._how = retarget, distortion
        names = retarget.finger_names, retarget.joint_names
        super().__init__(*names, keypoints, retarget.lower, retarget.upper)
        self._rest = frames.mean(axis=0)
        # A finger's range along each axis, as the wavelength of its gain, (F, 3) m.
        self._range = np.subtract(*np.percentile(frames, (97.5, 2.5), axis=0))
        fingers, rng = len(self._rest), np.random.default_rng(seed)
        axes = rng.normal(size=(fingers, 3))
        axes *= distortion.rotation / np.linalg.norm(axes, axis=1, keepdims=True)
        self._R = Rotation.from_rotvec(axes).as_matrix()
        self._gain_phase, self._ripple_phase = rng.uniform(0.0, 2 * np.pi, (2, fingers, 3))
        self._thumb = self.finger_names.index("thumb")
        # Directions in which a gap opens; the thumb stays.
        apart = self._rest - self._rest[self._thumb]
        self._apart = apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)

    def reset(self) -> None:
        """Forgets earlier frames, if the map remembers them."""
        forget(self._retarget)

    def settled_map(self, frames: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The answers to hands (N, F, 3) that are held still, see `AnyTeleop.settled_map`."""
        settled = self._retarget
        if hasattr(settled, "settled_map"):
            settled = settled.settled_map(self.inputs(frames))
        return lambda p_HF: settled(self.inputs(p_HF))

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        return self._retarget(self.inputs(p_HF))

    def inputs(self, p_HF: np.ndarray) -> np.ndarray:
        """The fingertips (F, 3) or (N, F, 3), m, that the map gets instead of these."""
        how, before = self._how, p_HF - self._rest
        x = before + how.cross_talk * (before.sum(axis=-2, keepdims=True) - before)
        x = np.einsum("fij,...fj->...fi", self._R, x)
        # The slope of the wave is between ±share of 1.
        share, k = (how.gain - 1.0) / (how.gain + 1.0), 2 * np.pi / self._range
        x = x + share / k * (np.sin(k * x + self._gain_phase) - np.sin(self._gain_phase))
        x = (1.0 - how.reach) * x
        pinching = self._pinching(p_HF)
        x = x + pinching * (before + how.gap * self._apart - x)
        x = x + how.ripple * np.sin(2 * np.pi / RIPPLE_LENGTH * x + self._ripple_phase)
        return self._rest + x

    def _pinching(self, p_HF: np.ndarray) -> np.ndarray:
        """How much each finger takes part in a pinch, from 0 to 1, (..., F, 1)."""
        distance = np.linalg.norm(p_HF - p_HF[..., [self._thumb], :], axis=-1, keepdims=True)
        share = np.clip((APART - distance) / (APART - PINCHED), 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        share[..., self._thumb, :] = 0.0
        share[..., self._thumb, :] = share.max(axis=-2)
        return share

"""Retargeting: maps from human fingertips to the joint angles of a robot hand, without pydrake.

`METHODS` lists the methods; `geort_drake.retargeting.store.load_retargeter` loads trained maps.
"""

import pkgutil
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Method:
    """A retargeting method.

    Attributes:
        summary: one line for --help.
        fitter: module and function, or class, of this package; see `fit`.
        settings: module and class of the settings of its training; empty if it is not trained.
    """

    summary: str
    fitter: str
    settings: str = ""

    @property
    def is_trained(self) -> bool:
        """Whether `fit` trains a network, which takes minutes."""
        return bool(self.settings)

    def fit(self, hand: Any, p_HF: Any = None, **options: Any) -> Any:
        """Makes a `Retargeter`.

        Args:
            hand: model of the robot hand, or its `HandKinematics` if the method samples no collisions.
            p_HF: (T, F, 3) recorded fingertips of a right hand in H, m, in successive frames; methods that
                learn nothing ignore them.
            options: seed of all draws (0), and for trained methods: config (settings), device ("cpu" or
                "cuda") and report, which is called as report(steps done, total steps, row of losses).

        Raises:
            GeortError: the hand or the recording is unsuitable, or the loss is not finite.
        """
        return pkgutil.resolve_name(f"{__name__}.{self.fitter}")(hand, p_HF, **options)

    def config(self) -> Any:
        """Returns the default settings of the training."""
        return pkgutil.resolve_name(f"{__name__}.{self.settings}")()


METHODS = {
    "geort": Method(
        "Algorithm 1 of the paper: a network per finger, five criteria", "geort:fit", "geort:GeortConfig"
    ),
    "telekinesis": Method(
        "Eq. 1 of the paper, learned offline (Robotic Telekinesis)",
        "telekinesis:fit",
        "telekinesis:TelekinesisConfig",
    ),
    "universal": Method("one map for every person, shipped for the hand", "store:fit"),
    "affine_ik": Method("an affine map of each fingertip, and inverse kinematics", "affine_ik:AffineIK"),
    "anyteleop": Method("AnyTeleop's vectors, optimised at every frame", "online:AnyTeleop"),
    "dexpilot": Method("DexPilot's vectors, optimised at every frame", "online:DexPilot"),
    "hold": Method("a constant posture", "affine_ik:Hold"),
}
DEFAULT_METHOD = "geort"

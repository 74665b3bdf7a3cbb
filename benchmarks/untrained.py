"""Maps with random weights of the size of trained ones, for timing."""

import argparse

import numpy as np

from geort_drake.retargeting.geort import GeortConfig
from geort_drake.retargeting.mlp import MlpRetargeter

FINGERS = {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "little": 20}  # name → keypoint
# Widths of the hidden layers: of each finger, and of the network that sees all fingertips.
FORMS = {"universal": (64, 128), "geort": (GeortConfig().hidden, 0)}


def untrained(form: str, fingers: int = 4, joints: int = 4, seed: int = 0) -> MlpRetargeter:
    """Returns a map of a hand of `fingers` fingers with `joints` joints each, by default the Allegro's."""
    rng, (h, r), n = np.random.default_rng(seed), FORMS[form], fingers * joints
    shapes: dict[str, tuple[int, ...]] = {}
    for k, (a, b) in enumerate(((3, h), (h, h), (h, joints))):
        shapes |= {f"weight{k}": (fingers, a, b), f"bias{k}": (fingers, 1, b)}
    if r:
        for k, (a, b) in enumerate(((3 * fingers, r), (r, r), (r, n))):
            shapes |= {f"residual_weight{k}": (a, b), f"residual_bias{k}": (b,)}
    arrays = {name: rng.normal(0.0, 1.0 / np.sqrt(shape[-2:][0]), shape) for name, shape in shapes.items()}
    for name in {"weight0", "residual_weight0"} & arrays.keys():
        arrays[name] *= 50.0  # because fingertips move by centimetres
    arrays["columns"] = np.arange(n)
    names, keypoints = list(FINGERS)[:fingers], list(FINGERS.values())[:fingers]
    return MlpRetargeter(names, [f"joint_{j}" for j in range(n)], keypoints, -np.ones(n), np.ones(n), arrays)


def add_form_option(parser: argparse.ArgumentParser) -> None:
    """Adds --method, for `untrained`."""
    parser.add_argument("--method", choices=FORMS, default="universal", help="(default: %(default)s)")

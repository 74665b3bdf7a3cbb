"""Retargeters with random weights of the size of trained ones, for timing."""

import argparse

import numpy as np

from geort_drake.retargeting.methods import trained_method
from geort_drake.retargeting.methods.coupled.network import HIDDEN, RESIDUAL_HIDDEN
from geort_drake.retargeting.methods.geort import GeortConfig
from geort_drake.retargeting.retargeter import BACKENDS, Retargeter

FINGERS = {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "little": 20}  # name → keypoint
FORMS = ("geort_coupled", "geort")


def untrained_arrays(method: str, fingers: int, joints: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Returns the arrays of a checkpoint for a hand of `fingers` fingers with `joints` joints each."""
    rng = np.random.default_rng(seed)
    hidden = HIDDEN if method == "geort_coupled" else GeortConfig().hidden
    widths = (3, hidden, hidden, joints)
    shapes: dict[str, tuple[int, ...]] = {}
    for k in range(3):
        shapes |= {
            f"weight{k}": (fingers, widths[k], widths[k + 1]),
            f"bias{k}": (fingers, 1, widths[k + 1]),
        }
    if method == "geort_coupled":
        r = RESIDUAL_HIDDEN
        widths = (3 * fingers, r, r, fingers * joints)
        for k in range(3):
            shapes |= {
                f"residual_weight{k}": (widths[k], widths[k + 1]),
                f"residual_bias{k}": (widths[k + 1],),
            }
    arrays = {name: rng.normal(0.0, 1.0 / np.sqrt(shape[-2:][0]), shape) for name, shape in shapes.items()}
    for name in ("weight0", "residual_weight0"):
        if name in arrays:
            arrays[name] *= 50.0  # because fingertips move by centimetres
    return arrays | {"columns": np.arange(fingers * joints)}


def untrained(
    method: str, fingers: int = 4, joints: int = 4, seed: int = 0, backend: str = BACKENDS[0]
) -> Retargeter:
    """Returns a retargeter of `untrained_arrays`; by default of the Allegro hand's size."""
    n = fingers * joints
    names, keypoints = list(FINGERS)[:fingers], list(FINGERS.values())[:fingers]
    arrays = untrained_arrays(method, fingers, joints, seed)
    retargeter = trained_method(method).retargeter(
        arrays, names, [f"joint_{j}" for j in range(n)], keypoints, -np.ones(n), np.ones(n)
    )
    if backend == "numba":
        retargeter.compile()
    return retargeter


def add_retargeter_options(parser: argparse.ArgumentParser) -> None:
    """Adds --method and --backend, for `untrained`."""
    parser.add_argument("--method", choices=FORMS, default=FORMS[0], help="(default: %(default)s)")
    parser.add_argument(
        "--backend", choices=BACKENDS, default=BACKENDS[0], help="backend of calls (default: %(default)s)"
    )


def dense_layers(method: str) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray, np.ndarray]:
    """Returns `untrained_arrays` of the Allegro hand's size, with the fingers' layers joined.

    Returns:
        Weights of the layers 0 (12, H) and 2 (H, 16), biases of the layers 0, 1 and 2, and the separate
        weights of layer 1: of the fingers (4, h, h), and of the residual (r, r), which is (0, 0) in `geort`.
    """
    arrays = untrained_arrays(method, 4, 4)
    first, last = (np.zeros((4, a, 4, b)) for a, b in (arrays[f"weight{k}"].shape[1:] for k in (0, 2)))
    for i in range(4):
        first[i, :, i], last[i, :, i] = arrays["weight0"][i], arrays["weight2"][i]
    weights = [first.reshape(12, -1), last.reshape(-1, 16)]
    biases = [arrays[f"bias{k}"].ravel() for k in range(3)]
    residual = np.zeros((0, 0))
    if "residual_weight1" in arrays:
        residual = arrays["residual_weight1"]
        weights[0] = np.hstack([weights[0], arrays["residual_weight0"]])
        weights[1] = np.vstack([weights[1], arrays["residual_weight2"]])
        biases[:2] = [np.concatenate([biases[k], arrays[f"residual_bias{k}"]]) for k in range(2)]
        biases[2] = biases[2] + arrays["residual_bias2"]
    return weights, biases, arrays["weight1"], residual

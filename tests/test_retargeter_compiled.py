"""The call that numba compiles, against NumPy's."""

import pickle

import numpy as np
import pytest

pytest.importorskip("numba")

from faults.sound import checkpoint

from geort_drake.errors import UnknownNameError
from geort_drake.retargeting.compiled import _angles
from geort_drake.retargeting.methods import trained_method
from geort_drake.retargeting.retargeter import Retargeter, load_retargeter

KEYPOINTS = [4, 8, 12, 16, 20]
NAMES = ["thumb", "index", "middle", "ring", "little"]


def retargeter(fingers: int, hidden: int, shared: int, joints: int, scale: float = 1.0) -> Retargeter:
    """A map of random weights; `shared` = 0 is one of independent fingers."""
    rng = np.random.default_rng(fingers * hidden + shared)
    outputs, n = fingers * joints, fingers * joints - 1
    sizes = {
        "weight0": (fingers, 3, hidden),
        "weight1": (fingers, hidden, hidden),
        "weight2": (fingers, hidden, joints),
    }
    sizes |= {f"bias{k}": (fingers, 1, sizes[f"weight{k}"][2]) for k in range(3)}
    if shared:
        widths = (3 * fingers, shared, shared, outputs)
        for k in range(3):
            sizes |= {f"residual_weight{k}": widths[k : k + 2], f"residual_bias{k}": widths[k + 1 : k + 2]}
    arrays = {
        name: scale * rng.normal(0.0, 1.0, size) / np.sqrt(size[-2:][0]) for name, size in sizes.items()
    }
    # One output is no joint, and the others are joints in another order.
    columns = rng.permutation(outputs)[:n]
    lower = rng.uniform(-2.0, 0.0, n)
    return trained_method("geort_coupled" if shared else "geort").retargeter(
        {**arrays, "columns": columns},
        NAMES[:fingers],
        [f"joint_{j}" for j in range(n)],
        KEYPOINTS[:fingers],
        lower,
        lower + rng.uniform(0.1, 3.0, n),
    )


def both(*sizes: int, scale: float = 1.0) -> tuple[Retargeter, Retargeter]:
    """The same map, computed by NumPy and by numba."""
    plain, compiled = retargeter(*sizes, scale=scale), retargeter(*sizes, scale=scale)
    compiled.compile()
    return plain, compiled


def compiled_call(compiled: Retargeter, points) -> np.ndarray:
    """What its call gives for one hand, which has to come from the compiled code."""
    q = compiled(points)
    np.testing.assert_array_equal(q, compiled._one_hand(points))
    return q


@pytest.mark.parametrize("sizes", [(4, 64, 112, 4), (4, 128, 0, 4), (2, 5, 3, 3), (5, 7, 9, 2), (3, 1, 1, 2)])
@pytest.mark.parametrize("scale", [1.0, 30.0, 1e5])
def test_it_answers_as_numpy_does(sizes, scale, rng):
    """To 1e-12 rad, whatever the sizes, also where activations and joints saturate."""
    plain, compiled = both(*sizes, scale=scale)
    for _ in range(50):
        for points in (rng.normal(0.0, 0.1, (sizes[0], 3)), rng.normal(0.0, 0.1, (21, 3))):
            q = compiled_call(compiled, points)
            np.testing.assert_allclose(q, plain(points), rtol=0, atol=1e-12)
            assert (compiled.lower <= q).all() and (q <= compiled.upper).all()


def test_every_kind_of_array_is_taken_and_nothing_is_compiled_for_it(rng):
    """Lists, single precision, strides, read-only and unaligned memory: no loop waits for a compiler."""
    plain, compiled = both(4, 64, 112, 4)
    points = rng.normal(0.0, 0.03, (21, 3))
    known = len(_angles.signatures)
    frozen = points.copy()
    frozen.flags.writeable = False
    shifted = np.zeros(points.nbytes + 1, np.uint8)[1:].view(float).reshape(21, 3)
    shifted[...] = points
    wide = np.zeros((21, 6))
    wide[:, ::2] = points
    for given in (points, points.tolist(), frozen, shifted, wide[:, ::2], np.asfortranarray(points)):
        np.testing.assert_allclose(compiled_call(compiled, given), plain(points), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(plain(given), plain(points))
    single = points.astype(np.float32)
    np.testing.assert_allclose(compiled_call(compiled, single), plain(single), rtol=0, atol=1e-12)
    several = rng.normal(0.0, 0.03, (7, 21, 3))
    np.testing.assert_array_equal(compiled(several), plain(several))
    assert len(_angles.signatures) == known


def test_it_goes_to_other_processes(rng):
    """As the workers of the grasp benchmark get it."""
    _, compiled = both(4, 8, 4, 4)
    points = rng.normal(0.0, 0.1, (4, 3))
    copy = pickle.loads(pickle.dumps(compiled))  # noqa: S301
    np.testing.assert_array_equal(copy(points), compiled(points))
    # joblib gives large arrays to workers as read-only memory.
    copy._one_hand._weights.flags.writeable = False
    np.testing.assert_array_equal(copy(points), compiled(points))


def test_load_retargeter_takes_the_backend_by_name(tmp_path, rng):
    path, points = checkpoint(tmp_path), rng.normal(0.0, 0.03, (21, 3))
    q = compiled_call(load_retargeter(path, backend="numba"), points)
    np.testing.assert_allclose(q, load_retargeter(path)(points), rtol=0, atol=1e-12)
    with pytest.raises(UnknownNameError, match="numba, numpy"):
        load_retargeter(path, backend="numbat")

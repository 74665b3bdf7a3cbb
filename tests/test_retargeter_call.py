"""Calls of the NumPy retargeters, and of the code that numba compiles for them."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from faults.sound import checkpoint

from geort_drake import Retargeter, load_retargeter
from geort_drake.errors import GeortError, UnknownNameError
from geort_drake.people.keypoints import FINGER_NAMES, TIP_KEYPOINT
from geort_drake.retargeting.methods import trained_method


def retargeter(fingers: int, hidden: int, shared: int, joints: int, scale: float = 1.0) -> Retargeter:
    """A map of random weights; `shared` = 0 is one of independent fingers."""
    rng = np.random.default_rng(fingers * hidden + shared)
    outputs, n = fingers * joints, fingers * joints - 1
    layers = {"": (3, hidden, hidden, joints)}
    if shared:
        layers["residual_"] = (3 * fingers, shared, shared, outputs)
    arrays = {}
    for name, widths in layers.items():
        stack = () if name else (fingers,)
        for k in range(3):
            shape = (*stack, *widths[k : k + 2])
            arrays[f"{name}weight{k}"] = scale * rng.normal(0.0, 1.0, shape) / np.sqrt(widths[k])
            arrays[f"{name}bias{k}"] = scale * rng.normal(0.0, 0.3, (*stack, 1, widths[k + 1])[bool(name) :])
        arrays[f"{name}weight0"] *= 20.0  # fingertips move by centimetres
    # One output is no joint, and the others are joints in another order.
    columns = rng.permutation(outputs)[:n]
    lower = rng.uniform(-2.0, 0.0, n)
    kind = trained_method("geort_coupled" if shared else "geort").retargeter
    limits = lower, lower + rng.uniform(0.1, 3.0, n)
    arrays["columns"] = columns
    tips = [TIP_KEYPOINT[name] for name in FINGER_NAMES[:fingers]]
    return kind(arrays, FINGER_NAMES[:fingers], [f"joint_{j}" for j in range(n)], tips, *limits)


def compiled(*sizes: int, scale: float = 1.0) -> Retargeter:
    """The same map, computed by numba."""
    pytest.importorskip("numba")
    made = retargeter(*sizes, scale=scale)
    made.compile()
    return made


@pytest.fixture(params=["independent", "coupled", "compiled"])
def retarget(request) -> Retargeter:
    shared = 0 if request.param == "independent" else 24
    return (compiled if request.param == "compiled" else retargeter)(3, 16, shared, 3)


def test_the_value_and_its_jacobian_come_together(retarget, rng):
    """For fingertips and for whole hands, the value is the call's and the gradient the function's."""
    p_HK = rng.normal(0.0, 0.03, (21, 3))
    p_HF = p_HK[[4, 8, 12]]
    q, J = retarget.value_and_jacobian(p_HK)
    np.testing.assert_allclose(q, retarget(p_HF), atol=1e-12)
    np.testing.assert_array_equal(J, retarget.jacobian(p_HF))
    d = 1e-6 * rng.normal(size=p_HF.shape)
    change = (retarget(p_HF + d) - retarget(p_HF - d)) / 2
    assert np.abs(change).max() > 1e-6
    np.testing.assert_allclose(np.tensordot(J, d, 2), change, atol=1e-11)
    with pytest.raises(ValueError, match="takes one hand"):
        retarget.value_and_jacobian(p_HF[None])


def test_what_is_returned_belongs_to_the_caller(retarget, rng):
    """A later call changes no earlier result, and writing into a result changes no later one."""

    def results(points):
        return [retarget(points), retarget(points[None]), *retarget.value_and_jacobian(points)]

    first, second = rng.normal(0.0, 0.03, (2, 3, 3))
    given, kept = first.copy(), results(first)
    copies = [array.copy() for array in kept]
    results(second)
    for array, copy in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
        array[...] = np.nan
    for array, copy in zip(results(first), copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    np.testing.assert_array_equal(first, given)


def test_threads_do_not_disturb_each_other(retarget, rng):
    """Four threads share one retargeter and each gets the answers to its own hands."""
    hands = rng.normal(0.0, 0.03, (4, 300, 3, 3))
    expected = [[retarget(p_HF) for p_HF in mine] for mine in hands]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(lambda mine: [retarget(p_HF) for p_HF in mine], hands))
    finally:
        sys.setswitchinterval(before)
    np.testing.assert_array_equal(found, expected)


def test_outputs_stay_within_the_joint_limits(retarget, rng):
    """Saturated outputs are inside to the last bit; no hands give no angles."""
    for scale in (1.0, 1e3, 1e9):
        q = retarget(scale * rng.normal(size=(2000, 3, 3)))
        assert (q >= retarget.lower).all() and (q <= retarget.upper).all()
    assert retarget(np.zeros((0, 3, 3))).shape == (0, len(retarget.lower))


def test_wrong_input_is_refused(retarget):
    """Shapes are listed; NaN and infinity are not passed on."""
    for shape in ((3,), (4, 3), (0, 3), (2, 5, 3), (3, 2), (1, 1, 3, 3)):
        with pytest.raises(ValueError, match=r"\(3, 3\) or \(N, 3, 3\).*thumb, index, middle"):
            retarget(np.zeros(shape))
    for bad in (np.nan, np.inf, -np.inf):
        p = np.zeros((4, 3, 3))
        p[2, 1, 0] = bad
        for points in (p, p[2]):
            with pytest.raises(GeortError, match="must be finite"):
                retarget(points)


def compiled_call(map_: Retargeter, points) -> np.ndarray:
    """What the call gives for one hand, which has to come from the compiled code."""
    q = map_(points)
    np.testing.assert_array_equal(q, map_._one_hand(points))
    return q


@pytest.mark.parametrize("sizes", [(4, 64, 112, 4), (4, 128, 0, 4), (2, 5, 3, 3), (5, 7, 9, 2), (3, 1, 1, 2)])
@pytest.mark.parametrize("scale", [1.0, 30.0, 1e4])
def test_compiled_code_answers_as_numpy_does(sizes, scale, rng):
    """To 1e-12 rad, whatever the sizes, also where activations and joints saturate."""
    plain, fast = retargeter(*sizes, scale=scale), compiled(*sizes, scale=scale)
    for _ in range(50):
        for points in (rng.normal(0.0, 0.1, (sizes[0], 3)), rng.normal(0.0, 0.1, (21, 3))):
            q = compiled_call(fast, points)
            np.testing.assert_allclose(q, plain(points), rtol=0, atol=1e-12)
            assert (fast.lower <= q).all() and (q <= fast.upper).all()


def test_every_kind_of_array_is_taken_and_nothing_is_compiled_for_it(rng):
    """Lists, single precision, strides, read-only and unaligned memory: no loop waits for a compiler."""
    plain, fast = retargeter(4, 64, 112, 4), compiled(4, 64, 112, 4)
    from geort_drake.retargeting.compiled import _angles

    points = rng.normal(0.0, 0.03, (21, 3))
    known = len(_angles.signatures)
    frozen = points.copy()
    frozen.flags.writeable = False
    shifted = np.zeros(points.nbytes + 1, np.uint8)[1:].view(float).reshape(21, 3)
    shifted[...] = points
    wide = np.zeros((21, 6))
    wide[:, ::2] = points
    for given in (points, points.tolist(), frozen, shifted, wide[:, ::2], np.asfortranarray(points)):
        np.testing.assert_allclose(compiled_call(fast, given), plain(points), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(plain(given), plain(points))
    single = points.astype(np.float32)
    np.testing.assert_allclose(compiled_call(fast, single), plain(single), rtol=0, atol=1e-12)
    several = rng.normal(0.0, 0.03, (7, 21, 3))
    np.testing.assert_array_equal(fast(several), plain(several))
    assert len(_angles.signatures) == known


def test_load_retargeter_takes_the_backend_by_name(tmp_path, rng):
    path, points = checkpoint(tmp_path), rng.normal(0.0, 0.03, (21, 3))
    with pytest.raises(UnknownNameError, match="numba, numpy"):
        load_retargeter(path, backend="numbat")
    pytest.importorskip("numba")
    q = compiled_call(load_retargeter(path, backend="numba"), points)
    np.testing.assert_allclose(q, load_retargeter(path)(points), rtol=0, atol=1e-12)

"""Calls of the NumPy retargeters."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from geort_drake.errors import GeortError
from geort_drake.retargeting.methods.coupled import CoupledRetargeter
from geort_drake.retargeting.retargeter import Retargeter

FINGERS, HIDDEN, OUTPUTS, RESIDUAL = ("thumb", "index", "middle"), 16, 3, 24
COLUMNS = np.array([7, 0, 3, 1, 4, 6, 8])  # a finger of two joints, one of three, and q in no order


def retargeter(kind: type[Retargeter], seed: int = 0) -> Retargeter:
    """One with random weights, whose outputs are far from saturated."""
    rng = np.random.default_rng(seed)
    n, f = len(COLUMNS), len(FINGERS)
    shapes = {
        "weight0": (f, 3, HIDDEN), "bias0": (f, 1, HIDDEN),
        "weight1": (f, HIDDEN, HIDDEN), "bias1": (f, 1, HIDDEN),
        "weight2": (f, HIDDEN, OUTPUTS), "bias2": (f, 1, OUTPUTS),
    }  # fmt: skip
    if kind is CoupledRetargeter:
        widths = (3 * f, RESIDUAL, RESIDUAL, f * OUTPUTS)
        for k in range(3):
            shapes |= {f"residual_weight{k}": widths[k : k + 2], f"residual_bias{k}": widths[k + 1 : k + 2]}
    arrays = {name: rng.normal(0.0, 0.3, shape) for name, shape in shapes.items()}
    for name in ("weight0", "residual_weight0"):
        if name in arrays:
            arrays[name] *= 100.0  # fingertips move by centimetres
    joints = [f"joint_{j}" for j in range(n)]
    return kind(arrays | {"columns": COLUMNS}, FINGERS, joints, [4, 8, 12], -np.ones(n), 2 * np.ones(n))


@pytest.fixture(params=["Retargeter", "CoupledRetargeter", "compiled"])
def retarget(request) -> Retargeter:
    made = retargeter(Retargeter if request.param == "Retargeter" else CoupledRetargeter)
    if request.param == "compiled":
        pytest.importorskip("numba")
        made.compile()
    return made


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
    first, second = rng.normal(0.0, 0.03, (2, 3, 3))
    given = first.copy()
    kept = [retarget(first), retarget(first[None]), *retarget.value_and_jacobian(first)]
    copies = [array.copy() for array in kept]
    retarget(second), retarget(second[None]), retarget.value_and_jacobian(second)
    for array, copy in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
        array[...] = np.nan
    again = [retarget(first), retarget(first[None]), *retarget.value_and_jacobian(first)]
    for array, copy in zip(again, copies, strict=True):
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
    assert retarget(np.zeros((0, 3, 3))).shape == (0, len(COLUMNS))


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

"""Calls of the trained map."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from faults.sound import play

from geort_drake.errors import GeortError
from geort_drake.people.keypoints import FINGER_NAMES, TIP_KEYPOINT, mirrored
from geort_drake.retargeting.mlp import MlpRetargeter


def retargeter(fingers: int, hidden: int, shared: int, joints: int, scale: float = 1.0) -> MlpRetargeter:
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
    limits = lower, lower + rng.uniform(0.1, 3.0, n)
    arrays["columns"] = columns
    tips = [TIP_KEYPOINT[name] for name in FINGER_NAMES[:fingers]]
    return MlpRetargeter(FINGER_NAMES[:fingers], [f"joint_{j}" for j in range(n)], tips, *limits, arrays)


@pytest.fixture(params=["independent", "coupled"])
def retarget(request) -> MlpRetargeter:
    return retargeter(3, 16, 0 if request.param == "independent" else 24, 3)


def test_the_jacobian_is_the_calls_gradient(retarget):
    """For fingertips and for whole hands."""
    p_HK = play().p_HK[0].astype(float)
    p_HF = p_HK[[4, 8, 12]]
    J = retarget.jacobian(p_HK)
    np.testing.assert_array_equal(J, retarget.jacobian(p_HF))
    d = 1e-4 * np.sin(np.arange(9)).reshape(3, 3)
    change = (retarget(p_HF + d) - retarget(p_HF - d)) / 2.0
    np.testing.assert_allclose(change, np.einsum("jfk,fk->j", J, d), atol=1e-7)
    assert np.abs(J).max() > 0.1
    with pytest.raises(ValueError, match="takes one hand"):
        retarget.jacobian(p_HF[None])


def test_what_is_returned_belongs_to_the_caller(retarget, rng):
    """A later call changes no earlier result, and writing into a result changes no later one."""

    def results(points):
        return [retarget(points), retarget(points[None]), retarget.jacobian(points)]

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
        q = retarget._angles(scale * rng.normal(size=(2000, 3, 3)))
        assert (q >= retarget.lower).all() and (q <= retarget.upper).all()
    assert retarget(np.zeros((0, 3, 3))).shape == (0, len(retarget.lower))


def test_wrong_input_is_refused(retarget):
    """Shapes are listed; NaN, infinity and other units are not passed on."""
    for shape in ((3,), (4, 3), (0, 3), (2, 5, 3), (3, 2), (1, 1, 3, 3)):
        with pytest.raises(ValueError, match=r"\(3, 3\) or \(N, 3, 3\).*thumb, index, middle"):
            retarget(np.zeros(shape))
    for metres in (1e-3, 1e-2, 0.0254):
        with pytest.raises(GeortError, match="must be in metres from the wrist"):
            retarget(np.full((3, 3), 0.1) / metres)
    for bad in (np.nan, np.inf, -np.inf):
        p = np.zeros((4, 3, 3))
        p[2, 1, 0] = bad
        for points in (p, p[2]):
            with pytest.raises(GeortError, match="must be finite"):
                retarget(points)


def test_a_left_hand_in_its_own_wrist_frame_is_refused_where_it_bends(retarget):
    """There its fingers bend to -x; straight fingers look like those of a right hand."""
    left = play().p_HK.astype(float) * [-1, 1, 1]
    fist = left[:, list(TIP_KEYPOINT.values())[1:], 0].mean(axis=1).argmin()
    for points in (left, left[fist]):
        with pytest.raises(GeortError, match=r"wrist frame H .*as of a left hand.*from_keypoints"):
            retarget(points)


def test_whole_hands_that_are_not_in_the_wrist_frame_or_of_the_other_side_are_refused(retarget):
    """Shifted, turned and mirrored hands, one or many; those of a recording are accepted."""
    hands = play().p_HK.astype(float)
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for bad, message in (
        (hands + 0.05, "off by 50 mm"),
        (hands @ turn.T, "off by .* mm"),
        (hands * [-1.0, -1.0, 1.0], "as of a left hand"),
        (mirrored(hands), "as of a left hand"),
    ):
        for points in (bad, bad[7], np.concatenate([hands[:3], bad[:1]])):
            with pytest.raises(GeortError, match=rf"wrist frame H .*{message}.*from_keypoints"):
                retarget(points)
    np.testing.assert_array_equal(retarget(hands), retarget(hands[:, [4, 8, 12]]))

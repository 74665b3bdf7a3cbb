"""What stands between retargeting and the hand: the guard against self-collision, and a user's policy."""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from grasp_setup import allegro
from system_bench import SystemBench

from geort_drake.errors import HandError, PolicyError
from geort_drake.hands.collision import HandClearance
from geort_drake.systems.corrections import (
    POLICY_FAILED,
    ActionCorrection,
    PolicyCorrection,
    SelfCollisionGuard,
    load_policy,
)
from geort_drake.systems.joint_limits import JointLimits

CLEARANCE = 0.002


@cache
def clearance() -> HandClearance:
    return HandClearance(allegro(), CLEARANCE)


def true_distances(q: np.ndarray) -> dict[frozenset, float]:
    """Drake's distances under 10 mm between the pairs that the guard looks at, by pair of geometries."""
    hand, ours = allegro(), clearance()
    context = hand.diagram.CreateDefaultContext()
    plant_context = hand.plant.GetMyMutableContextFromRoot(context)
    for name, angle in zip(hand.joint_names, q, strict=True):
        hand.plant.GetJointByName(name).set_angle(plant_context, angle)
    query = hand.plant.get_geometry_query_input_port().Eval(plant_context)
    watched = {frozenset((i, j)) for i, j in ours.pairs}
    found = {
        frozenset((pair.id_A, pair.id_B)): pair.distance
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(0.01)
    }
    return {pair: distance for pair, distance in found.items() if pair in watched}


def test_gaps_are_lower_bounds_of_drakes_distances(rng):
    """No pair is missed, no gap is larger than the distance, and few are smaller by over a millimetre."""
    hand, slack = allegro(), []
    for q in rng.uniform(hand.lower, hand.upper, (120, 16)):
        near = clearance().near(q)
        gaps = dict(zip(map(frozenset, near.pairs), near.gap, strict=True))
        for pair, distance in true_distances(q).items():
            if distance < CLEARANCE:
                assert gaps[pair] < distance + 1e-6
                if distance > 0:
                    slack.append(distance - gaps[pair])
    assert len(slack) > 50
    assert np.percentile(slack, 95) < 1e-3


def guard() -> tuple[SelfCollisionGuard, np.ndarray]:
    """A guard of the hand in the plant's order, and the rows of these joints in the description's order."""
    hand = allegro()
    # By number, which is not the order of the description: the thumb comes last.
    joints = sorted(hand.joint_names, key=lambda name: int(name.split("_")[1]))
    start = dict(zip(hand.joint_names, hand.default_position, strict=True))
    rows = np.array([hand.joint_names.index(name) for name in joints])
    limits = JointLimits(hand.lower[rows], hand.upper[rows])
    return SelfCollisionGuard(hand, joints, start, limits), rows


def test_the_guard_lets_fingertips_touch():
    """A pinch of thumb and index is passed on, although the tips press on each other."""
    hand, rng, (system, rows) = allegro(), np.random.default_rng(5), guard()
    q = hand.default_position
    # Drawn until only the tips of thumb and index touch.
    while np.linalg.norm(np.diff(hand.fingertips(q)[:2], axis=0)) >= 0.023 or clearance().near(q).pairs:
        q[:8] = rng.uniform(hand.lower[:8], hand.upper[:8])
    depth, *_, tips = hand.penetrations(q)[0]
    assert tips and depth > 0
    np.testing.assert_array_equal(system.guard(q[rows], q[rows]), q[rows])


def test_the_guard_walks_towards_a_command_and_stays_clear():
    """From update to update; its velocities are those of its positions."""
    hand, (system, rows) = allegro(), guard()
    start = before = hand.default_position[rows]
    wanted = np.clip(np.full(16, 1.4), hand.lower[rows], hand.upper[rows])
    bench = SystemBench(system)
    bench.fix(desired_state=[*wanted, *np.zeros(16)])
    for step in range(60):
        bench.advance()
        q, v = np.split(bench.value("desired_state"), 2)
        assert not clearance().near(q[np.argsort(rows)]).pairs
        if step:
            np.testing.assert_allclose(v, (q - before) / 0.01, atol=1e-9)
        before = q
    assert np.abs(q - wanted).max() > 0.05  # the fist is not clear
    # The joints slide along each other: fingers that only stopped would end at a distance of 0.25 rad.
    assert np.linalg.norm(q - wanted) < 0.2
    assert np.abs(q - start).max() > 0.5


# A graph with inputs `state` (1, 4) and `target` (1, 2), and one node, Identity, from target to output.
IDENTITY = Path(__file__).with_name("identity.onnx").read_bytes()
HALFWAY = "return 0.5 * (hand_state[:, :2] + target)"
# Far outside the limits, and no number at all where the target is negative.
WILD = "return torch.where(target < 0, torch.nan, 1e30 * torch.ones_like(target))"
# Fails where the first joint is past 0.05 rad, as no trial call finds out.
FAILING = """if bool(hand_state[0, 0] > 0.05):
        raise ValueError("no such state")
    return target"""


def torchscript(folder, body: str) -> str:
    """Writes a policy whose call has that body."""

    class Policy(torch.jit.ScriptModule):
        pass

    module, path = Policy(), str(folder / "policy.pt")
    module.define(f"def forward(self, hand_state: Tensor, target: Tensor) -> Tensor:\n    {body}\n")
    module.save(path)
    return path


def run_policy(policy, desired: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Desired states and statuses of two joints in [-1, 1] for commands (T, 2) and positions (T, 2)."""
    limits = JointLimits(np.full(2, -1.0), np.full(2, 1.0), 5.0, 200.0)
    bench = SystemBench(PolicyCorrection(policy, ["a", "b"], {"a": 0.0, "b": 0.0}, limits))
    states, statuses = [], []
    for q_desired, q in zip(desired, measured, strict=True):
        bench.fix(desired_state=[*q_desired, 0.0, 0.0], hand_state=[*q, 0.0, 0.0])
        bench.advance()
        states.append(bench.value("desired_state"))
        statuses.append(bench.value("status"))
    states = np.array(states)
    v = states[:, 2:]
    assert np.abs(states[:, :2]).max() <= 1.0 and np.abs(v).max() <= 5.0 + 1e-9
    assert np.abs(np.diff(v, axis=0)).max() <= 200.0 * 0.01 + 1e-9
    return states, statuses


def test_a_torchscript_policy_sees_hand_and_target(tmp_path):
    """Its output is commanded, within the limits of position, speed and acceleration."""
    policy = load_policy(torchscript(tmp_path, HALFWAY), 2)
    states, _ = run_policy(policy, np.tile([0.4, -0.2], (30, 1)), np.tile([0.2, 0.0], (30, 1)))
    np.testing.assert_allclose(states[-1], [0.3, -0.1, 0, 0], atol=1e-7)
    policy = load_policy(torchscript(tmp_path, WILD), 2)
    states, _ = run_policy(policy, np.full((50, 2), 0.4), np.zeros((50, 2)))
    np.testing.assert_allclose(states[-1, :2], 1.0)


@pytest.mark.parametrize(
    ("body", "reason"), [(FAILING, "no such state"), (WILD, "not finite")], ids=["raises", "not finite"]
)
def test_a_policy_that_fails_while_it_runs_holds_the_joints(body, reason, tmp_path):
    """They brake within the limits; the status says so, and one warning says why."""
    policy = load_policy(torchscript(tmp_path, body), 2)
    bad = (np.arange(90) >= 30) & (np.arange(90) < 60)
    desired = np.where(bad[:, None], [0.4, -0.4], [0.4, 0.4])
    measured = np.where(bad[:, None], [0.1, 0.0], [0.0, 0.0])
    with pytest.warns(RuntimeWarning, match=f"{POLICY_FAILED}: (?s:.*){reason}") as warned:
        states, statuses = run_policy(policy, desired, measured)
    assert len(warned) == 1
    assert statuses == [""] * 30 + [POLICY_FAILED] * 30 + [""] * 30
    np.testing.assert_array_equal(states[40:60, 2:], 0.0)


def test_an_onnx_policy_runs(tmp_path):
    """The same through ONNX Runtime, where it is installed."""
    pytest.importorskip("onnxruntime")
    path = tmp_path / "policy.onnx"
    path.write_bytes(IDENTITY)
    policy = load_policy(path, 2)
    np.testing.assert_allclose(policy(np.array([1.0, 2, 3, 4]), np.array([0.1, 0.2])), [0.1, 0.2])
    with pytest.raises(PolicyError, match="with a hand state"):
        load_policy(path, 3)
    path.write_bytes(b"no model")
    with pytest.raises(PolicyError, match=r"policy\.onnx: cannot be called"):
        load_policy(path, 2)


def test_policies_that_cannot_be_run_are_refused(tmp_path, monkeypatch):
    other = tmp_path / "policy.pickle"
    other.write_bytes(b"x")
    with pytest.raises(PolicyError, match=r"ends with one of \.pt, \.pts, \.onnx"):
        load_policy(other, 2)
    with pytest.raises(PolicyError, match=r"must return \(1, 2\), it returns \(1, 4\)"):
        load_policy(torchscript(tmp_path, "return hand_state"), 2)
    onnx = tmp_path / "policy.onnx"
    onnx.write_bytes(IDENTITY)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ModuleNotFoundError, match="onnxruntime"):
        load_policy(onnx, 2)


class InPlace(ActionCorrection):
    def correct(self, desired_state, hand_state):
        desired_state *= 0.5


def test_a_correction_that_returns_no_state_is_named():
    bench = SystemBench(InPlace(num_joints=2))
    bench.fix(desired_state=np.ones(4), hand_state=np.ones(4))
    with pytest.raises(HandError, match=r"correct must return shape \(4,\); it returned \(\)"):
        bench.value("desired_state")

"""The assembled diagram: hand and arm follow the glove, and ports are described."""

import dataclasses as dc
import gc
import inspect
import re
import weakref

import numpy as np
import pytest
from grasp_setup import allegro, centred_map, human_with, resting_glove, scenario_with, started
from live_messages import station
from loop_bench import LoopBench
from pydrake.systems.framework import System

from geort_drake import Recording, load_retargeter, make_trial_diagram
from geort_drake.simulation.world import HAND
from geort_drake.systems.corrections import SelfCollisionGuard


def glove(p_W_moved=(0.0, 0.0, 0.0), spread: float = 0.0, duration: float = 3.0) -> Recording:
    """A hand held still at rest, its fingertips spread by a share, and a wrist that moves away at once."""
    still = resting_glove(duration)
    p_HK, X_WH = still.p_HK.copy(), still.X_WH.copy()
    p_HK[:, [4, 8, 12, 16, 20]] *= 1 + spread
    # The clutch engages at the first sample; the wrist moves in the half second after it.
    X_WH[:, 4:] = np.clip((still.t - 0.1) / 0.5, 0, 1)[:, None] * np.asarray(p_W_moved)
    return dc.replace(still, p_HK=p_HK, X_WH=X_WH)


def test_the_hand_follows_the_glove():
    """The fingers get to their targets, and the hand base moves as the wrist does, without a turn."""
    shift = (0.05, -0.03, 0.0)
    recording = glove(shift, spread=0.05)
    parts = make_trial_diagram(scenario_with(), centred_map(), recording)
    simulator = started(parts)
    root, plant = simulator.get_context(), parts.plant
    context = plant.GetMyContextFromRoot(root)
    hand = plant.GetModelInstanceByName(HAND)
    base = plant.GetFrameByName(parts.description.base_frame, hand)
    X_WB0 = base.CalcPoseInWorld(context)
    simulator.AdvanceTo(1.5)
    X_WB = base.CalcPoseInWorld(context)
    desired = parts.retargeting.GetOutputPort("desired_state").Eval(
        parts.retargeting.GetMyContextFromRoot(root)
    )
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices(hand)]
    q = np.array([actuator.joint().GetOnePosition(context) for actuator in actuators])
    np.testing.assert_allclose(X_WB.translation() - X_WB0.translation(), shift, atol=3e-3)
    assert abs((X_WB0.rotation().inverse() @ X_WB.rotation()).ToAngleAxis().angle()) < 0.02
    retarget = centred_map()
    for _ in range(200):
        target = retarget(recording.p_HK[0])
    # The targets are far from where the hand starts, so staying there would not pass.
    assert np.abs(target - allegro().default_position).max() > 0.2
    assert len(q) == len(allegro().joint_names)
    np.testing.assert_allclose(q, desired[: len(q)], atol=0.03)


def test_the_retargeting_has_the_scenarios_latency_and_speed():
    """The latency is rounded up to plant steps; no joint is sent further than speed times time."""
    scenario = scenario_with("cylinder", "{retargeting: {latency: 0.0131, max_joint_speed: 0.5}}")
    parts = make_trial_diagram(scenario, centred_map(), glove(spread=0.05))
    simulator = started(parts)
    context = parts.retargeting.GetMyContextFromRoot(simulator.get_context())
    port = parts.retargeting.GetOutputPort("desired_state")
    rest = port.Eval(context).copy()
    simulator.AdvanceTo(0.0149)
    np.testing.assert_array_equal(port.Eval(context), rest)
    simulator.AdvanceTo(0.0151)
    moved = np.abs(port.Eval(context) - rest)[:16].max()
    assert moved == pytest.approx(0.5 * parts.retargeting.period, rel=1e-6)


def test_every_port_is_described_where_it_is_declared():
    """The docstring of each system of ours lists its ports, those inside its diagrams too."""
    parts = [make_trial_diagram(scenario_with(), centred_map(), source) for source in (human_with(), glove())]
    systems, todo = [], [made.diagram for made in parts]
    while todo:
        system = todo.pop()
        if hasattr(system, "GetSystems"):
            todo += system.GetSystems()
        if type(system).__module__.startswith("geort_drake."):
            systems.append(system)
    kinds = {type(system).__name__ for system in systems}
    assert {"RetargetingSystem", "SimulatedOperator", "GloveReplay", "WristToArm", "SceneView"} <= kinds
    for system in systems:
        docstring = inspect.getdoc(type(system)) or ""
        ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
        ports += [system.get_output_port(i) for i in range(system.num_output_ports())]
        names = [port.get_name() for port in ports]
        missing = [name for name in names if not re.search(rf"\b{name} \(", docstring)]
        assert missing == [], type(system).__name__


def test_the_scenarios_correction_has_the_last_word_on_the_hand():
    """Its output is what the plant's hand is asked for."""
    scenario = scenario_with("cylinder", "{correction: {kind: guard}}")
    parts = make_trial_diagram(scenario, centred_map(), glove())
    wanted = parts.plant.get_desired_state_input_port(parts.plant.GetModelInstanceByName(HAND))
    (source,) = [
        system
        for (to, port), (system, _) in parts.diagram.connection_map().items()
        if to is parts.plant and port == wanted.get_index()
    ]
    assert isinstance(source, SelfCollisionGuard)


def systems_in(system: System) -> list[System]:
    return [system, *(inner for part in getattr(system, "GetSystems", list)() for inner in systems_in(part))]


def systems_after_steps(path) -> list[weakref.ref]:
    """The systems of a recorded trial and of a teleoperation."""
    parts = make_trial_diagram(scenario_with(), centred_map(), human_with(), path)
    bench = LoopBench(station(), load_retargeter("allegro_right"))
    with parts.recorder:
        started(parts).AdvanceTo(0.05)
    bench.step()
    return [weakref.ref(each) for root in (parts.diagram, bench.loop.diagram) for each in systems_in(root)]


def test_diagrams_are_freed(tmp_path):
    """When nothing refers to them, though many of their systems are written in Python."""
    systems = systems_after_steps(tmp_path / "trial.rrd")
    for _ in range(2):
        gc.collect()
    assert len(systems) > 35 and not [system() for system in systems if system() is not None]

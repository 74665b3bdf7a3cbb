"""Hostile inputs, faults and kills: refused or survived; and trials obey physics."""

import dataclasses as dc
import gc
import resource
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from faults import kills
from faults.hostile import CASES, faults_of
from faults.physics import ENERGY, watched
from faults.sound import play, smooth_retargeter
from faults.systems import COMMANDS, FAULTS, WRIST_FAULTS, fuzz_arm, fuzz_guard, fuzz_system
from grasp_setup import centred_map, human_with, scenario_with
from system_bench import Bench, Watch

from geort_drake import make_trial_diagram
from geort_drake.simulation.diagram import TrialDiagram


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_hostile_input_is_refused(case, tmp_path):
    """Without a traceback, within bounded time and memory."""
    assert faults_of(case, tmp_path) == []


@pytest.mark.parametrize(
    ("fuzz", "count", "kinds"), [(fuzz_system, 4_000, FAULTS), (fuzz_arm, 2_000, WRIST_FAULTS)]
)
def test_no_faulty_frame_or_wrist_breaks_a_guarantee(fuzz, count, kinds):
    """Commands are finite and within the limits of position, speed and acceleration, for every fault.

    An arm that is held stands still.
    """
    result = fuzz(count, 0)
    assert result["violations"] == 0, result
    assert set(result["faults"]) == set(kinds)
    assert result["held"] > 400 and result.get("speed_when_held", 0.0) == 0.0
    assert result["frames"] == count == result["sound"] + sum(result["faults"].values())


def test_no_command_gets_past_the_guard():
    """For any command, the hand stays clear of itself and within its limits of position and speed."""
    result = fuzz_guard(2_000, 0)
    assert result["violations"] == 0, result
    assert set(result["commands"]) == set(COMMANDS)
    assert all(result["corrected"][kind] > 50 for kind in COMMANDS)


def test_updates_do_not_grow_the_memory():
    """By less than they would if each kept 4 kB."""
    bench, retarget, frames = Bench(), smooth_retargeter(), play().p_HK.astype(float)
    watch, memory = Watch(bench.limits, bench.period), []
    for updates in (300, 3_500):  # the first fill caches and pools
        for number in range(updates):
            q, v, _ = bench.tick(frames[number % len(frames)], float(number % 997 > 5))
            assert watch.broken(q, v) == []
            assert np.isfinite(retarget(frames[number % len(frames)])).all()
        gc.collect()
        memory.append(int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize())
    assert memory[1] - memory[0] <= 10e6


def grasp() -> TrialDiagram:
    scenario = scenario_with("cylinder", "{task_settings: {hold_time: 0.5}}")
    return make_trial_diagram(scenario, centred_map(), human_with())


@pytest.mark.slow
def test_a_grasp_obeys_physics():
    """No energy without work, penetration of at most 3 mm, no motor beyond its limit."""
    seen = watched(grasp(), 6.0)  # until the object is lifted
    assert seen.violations == 0, seen
    assert seen.contacts > 100 and 0.05 < seen.effort <= 1.0 + 1e-6
    assert 0 < seen.penetration <= 3e-3


class Idle:
    """A plant that reports no work of its motors."""

    def __init__(self, plant):
        self._plant = plant

    def __getattr__(self, name: str):
        return getattr(self._plant, name)

    def get_net_actuation_output_port(self):
        return SimpleNamespace(Eval=lambda _context: np.zeros(self._plant.num_actuators()))


@pytest.mark.slow
def test_energy_without_work_is_noticed():
    """The arm's motion has no source if the motors' work is left out."""
    parts = grasp()
    seen = watched(dc.replace(parts, plant=Idle(parts.plant)), 2.0)
    assert seen.gained > ENERGY
    assert seen.violations > 0 == seen.effort


@pytest.mark.parametrize(
    ("work", "by_clock", "new_interpreter"),
    [
        ("training", False, True),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("data generation", False, True),
                ("recording", False, True),
                ("benchmark", False, False),
                ("teleoperation", True, False),
            )
        ),
    ],
)
def test_a_killed_program_resumes(work, by_clock, new_interpreter, tmp_path):
    """Its results equal those of an undisturbed run bit for bit, also with other hashes and more threads.

    docs/results/reliability.md counts many more kills.
    """
    rng, known = np.random.default_rng(len(work)), kills.reference(work, tmp_path / "known")
    assert kills.kill(known, tmp_path / "kill", rng, by_clock, new_interpreter) == []

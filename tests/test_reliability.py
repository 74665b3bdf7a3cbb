"""Killed programs resume, and trials obey physics."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pytest
from faults import kills
from faults.physics import ENERGY, watched
from grasp_setup import centred_map, human_with, scenario_with

from geort_drake import make_trial_diagram
from geort_drake.simulation.diagram import TrialDiagram


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

"""A simulated trial obeys physics, and the checks would notice if it did not."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
from faults.physics import ENERGY, watched
from grasp_setup import centred_map, human_with, scenario_with

from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram


def grasp() -> TrialDiagram:
    human = human_with()
    return make_trial_diagram(scenario_with("cylinder"), centred_map(), human)


class Idle:
    """A plant that reports no work of its motors."""

    def __init__(self, plant):
        self._plant = plant

    def __getattr__(self, name: str):
        return getattr(self._plant, name)

    def get_net_actuation_output_port(self):
        return SimpleNamespace(Eval=lambda _context: np.zeros(self._plant.num_actuators()))


def test_a_grasp_obeys_physics():
    """No energy without work, penetration of at most 3 mm, no motor beyond its limit."""
    seen = watched(grasp(), 8.0)
    assert seen.violations == 0, seen
    assert seen.contacts > 100 and 0.05 < seen.effort <= 1.0 + 1e-6
    assert 0 < seen.penetration <= 3e-3


def test_energy_without_work_is_noticed():
    """The arm's motion has no source if the motors' work is left out."""
    parts = grasp()
    seen = watched(dc.replace(parts, plant=Idle(parts.plant)), 2.0)
    assert seen.gained > ENERGY
    assert seen.violations > 0 == seen.effort

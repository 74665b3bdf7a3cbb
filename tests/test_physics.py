"""Simulated trials obey physics: energy, penetration, motor limits."""

import numpy as np
import pytest
from grasp_setup import centred_map, human_with, scenario_with, started

from geort_drake import make_trial_diagram

PENETRATION = 3e-3  # m
# J: what compliant contacts and joint stops store and give back, and what a step of 2 ms rounds off.
ENERGY = 0.05


def gained(energy: np.ndarray, work: np.ndarray) -> float:
    """The largest energy gained in any interval beyond the work in it; of each step, J."""
    excess = np.append(0.0, np.cumsum(np.diff(energy) - work))
    return float((excess - np.minimum.accumulate(excess)).max())


@pytest.mark.slow
def test_a_grasp_obeys_physics():
    """No energy without work, penetration of at most 3 mm, no motor beyond its limit.

    Only motors add energy, so the energy of all bodies may not rise by more than the motors' work. Because of
    how the plant is stepped, power at the end of a step times its length is an upper bound of that work.
    """
    scenario = scenario_with("cylinder", "{task_settings: {hold_time: 0.5}}")
    parts = make_trial_diagram(scenario, centred_map(), human_with())
    plant, thing = parts.plant, parts.stage.handled.body.index()
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    limits = np.array([actuator.effort_limit() for actuator in actuators])
    places = [actuator.joint().velocity_start() for actuator in actuators]
    energies, efforts, speeds, depths = [], [], [], []

    def look(root) -> None:
        context = plant.GetMyContextFromRoot(root)
        results = plant.get_contact_results_output_port().Eval(context)
        contacts = [results.point_pair_contact_info(n) for n in range(results.num_point_pair_contacts())]
        touching = [info for info in contacts if thing in (info.bodyA_index(), info.bodyB_index())]
        depths.append(max((info.point_pair().depth for info in touching), default=0.0))
        energies.append(plant.CalcKineticEnergy(context) + plant.CalcPotentialEnergy(context))
        # The port is not sampled: it gives what the motors do in the step that follows.
        efforts.append(plant.get_net_actuation_output_port().Eval(context).copy())
        speeds.append(plant.GetVelocities(context)[places])

    simulator = started(parts)
    simulator.set_monitor(look)
    simulator.AdvanceTo(6.0)  # until the object is lifted
    work = np.sum(np.array(efforts[:-1]) * speeds[1:], axis=1) * plant.time_step()
    assert gained(np.array(energies), work) < ENERGY
    assert gained(np.array(energies), 0.0 * work) > ENERGY  # the motion has no source but the motors
    assert 0.05 < (np.abs(efforts) / limits).max() <= 1.0 + 1e-6
    assert np.count_nonzero(depths) > 100 and max(depths) <= PENETRATION

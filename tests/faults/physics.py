"""Checks that a simulated trial obeys physics: energy, penetration, motor limits."""

import dataclasses as dc

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import EventStatus

from geort_drake.simulation.diagram import TrialDiagram

PENETRATION = 3e-3  # m
# J: what compliant contacts and joint stops store and give back, and what a step of 2 ms rounds off.
ENERGY = 0.05


@dc.dataclass
class Invariants:
    """Figures of a trial.

    Attributes:
        steps: of the plant.
        effort: the largest effort relative to a motor's limit.
        penetration: the largest depth of a contact with the object, m.
        contacts: steps with a contact of the object.
        gained: the largest energy gained without work in any interval of the trial, J.
        violations: steps with a figure beyond its bound.
    """

    steps: int = 0
    effort: float = 0.0
    penetration: float = 0.0
    contacts: int = 0
    gained: float = 0.0
    violations: int = 0


def watched(parts: TrialDiagram, duration: float) -> Invariants:
    """Simulates a trial for `duration` seconds, or until it is judged, and checks every step of the plant.

    Only motors add energy, so the energy of all bodies may not rise by more than the motors' work. Because of
    how the plant is stepped, power at the end of a step times its length is an upper bound of that work.
    """
    plant, seen = parts.plant, Invariants()
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    limits = np.array([actuator.effort_limit() for actuator in actuators])
    places = np.array([actuator.joint().velocity_start() for actuator in actuators])
    thing, dt = parts.stage.body.index(), plant.time_step()
    excess = lowest = before = applied = None

    simulator = Simulator(parts.diagram)
    parts.initialize(simulator.get_mutable_context())

    def look(root) -> EventStatus:
        nonlocal excess, lowest, before, applied
        context = plant.GetMyContextFromRoot(root)
        effort = plant.get_net_actuation_output_port().Eval(context)
        share = float((np.abs(effort) / limits).max())
        results = plant.get_contact_results_output_port().Eval(context)
        depth = 0.0
        for number in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(number)
            if thing in (info.bodyA_index(), info.bodyB_index()):
                depth = max(depth, info.point_pair().depth)
        energy = plant.CalcKineticEnergy(context) + plant.CalcPotentialEnergy(context)
        if before is None:
            excess = lowest = 0.0
        else:
            work = float(applied @ plant.GetVelocities(context)[places]) * dt
            excess += energy - before - work
            lowest = min(lowest, excess)
        # The ports are not sampled: what they give now is what the motors do in the step that follows.
        before, applied = energy, effort.copy()
        gained = excess - lowest
        seen.steps += 1
        seen.effort, seen.penetration = max(seen.effort, share), max(seen.penetration, depth)
        seen.contacts += depth > 0
        seen.gained = max(seen.gained, gained)
        seen.violations += share > 1 + 1e-6 or depth > PENETRATION or gained > ENERGY
        over = parts.stage.outcome(root).over
        return (
            EventStatus.ReachedTermination(parts.stage.judge, "judged") if over else EventStatus.Succeeded()
        )

    simulator.set_monitor(look)
    simulator.AdvanceTo(duration)
    return seen

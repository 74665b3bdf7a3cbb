"""Selects the hand of the simulated person."""

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.population import sample_person
from geort_drake.people.recording import Recording
from geort_drake.simulation.scenario import Scenario


def persons_hand(scenario: Scenario, recording: Recording) -> HumanHand:
    """Returns the hand of the scenario's `person`: 0 is fitted to the recording, others are sampled."""
    return sample_person(0, scenario.person).hand if scenario.person else HumanHand.fit(recording)

"""A map for many people is measured once for the person at the glove, and then stays one fixed function."""

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shared import synthesized
from system_bench import Bench, Watch

from geort_drake import GloveReplay, Recording, RetargetingSystem, add_hand_model, load_hand, load_retargeter
from geort_drake.errors import GeortError
from geort_drake.people.synthetic.population import sample_person
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.person import MEASURED_FRAMES, PERSON_FIELDS, PersonMap
from geort_drake.systems.retargeting_status import (
    FOLLOWED,
    HELD_LOST,
    HELD_NOT_FINITE,
    HELD_OTHER_PERSON,
    MEASURING,
    TRACKING,
)

RETARGET = load_retargeter("allegro_right")
PLAY = synthesized(1, 12.0, 100.0).p_HK.astype(float)
OTHER = 1.15 * PLAY


class Session(Bench):
    """A system that is shown hand after hand; every command keeps the limits."""

    def __init__(self):
        limits, start = JointLimits(RETARGET.lower, RETARGET.upper), RETARGET.for_person(PLAY[:1])(PLAY[0])
        super().__init__(RETARGET, start=start, limits=limits, ease_at_start=False)
        self.watch = Watch(limits, 0.01, start)

    def show(self, frames, valid=1.0):
        """Joint targets (T, n) and states."""
        positions, states = [], []
        for p_HK in frames:
            q, v, status = self.tick(p_HK, valid)
            assert not self.watch.broken(q, v)
            positions.append(q)
            states.append(status.state)
        return np.array(positions), states


def test_the_hand_is_held_while_it_is_measured_and_then_follows_the_map_for_these_frames():
    """Frames that repeat, are lost or broken are not among them."""
    session = Session()
    q, states = session.show(PLAY[:13])
    assert set(states) == {MEASURING}
    np.testing.assert_array_equal(q[0], q[-1])
    session.show([PLAY[12]] * 20)
    assert session.show(PLAY[20:22], valid=0.0)[1] == [HELD_LOST] * 2
    assert session.show([np.full((21, 3), np.nan)])[1] == [HELD_NOT_FINITE]
    session.show(PLAY[30:400])
    q, states = session.show(PLAY[400:900])
    person = session.context.get_discrete_state(session.system._person).value()
    measured = person.view(PERSON_FIELDS)[0]["frames"].copy()
    numbers = [int(np.abs(PLAY - p_HK).sum(axis=(1, 2)).argmin()) for p_HK in measured]
    np.testing.assert_array_equal(measured, PLAY[numbers])
    assert len(set(numbers)) == MEASURED_FRAMES and not {20, 21} & set(numbers)
    expected = RETARGET.for_person(measured)
    followed = np.array(states) == TRACKING
    assert followed.mean() > 0.5
    answers = np.array([expected(p_HK) for p_HK in PLAY[400:900]])
    np.testing.assert_array_equal(q[followed], answers[followed])


def test_another_person_is_held_until_the_hand_is_measured_anew():
    """Which is refused while the hand is followed."""
    session = Session()
    session.show(PLAY[:400])
    with pytest.raises(GeortError, match="disengage it first"):
        session.system.measure_person(session.context)
    q, states = session.show(OTHER[400:1000])
    first = states.index(HELD_OTHER_PERSON)
    assert first < 250 and set(states[first:]) == {HELD_OTHER_PERSON}
    np.testing.assert_array_equal(q[-1], q[first + 20])
    session.show(OTHER[1000:1010], valid=0.0)
    session.system.measure_person(session.context)
    states = session.show(OTHER[100:300])[1]
    assert MEASURING in states and HELD_OTHER_PERSON not in states
    q, states = session.show(OTHER[300:1000])
    assert set(states) <= set(FOLLOWED)


def test_points_that_are_no_hand_are_never_followed():
    assert set(Session().show(1e-6 * PLAY[:100])[1][3:]) == {MEASURING}


@pytest.mark.slow
def test_nobody_is_taken_for_another_person_as_devices_measure_them():
    """Of gloves and cameras; and people whose hands differ are told apart within two seconds."""
    people = [sample_person(7, number) for number in range(10)]
    recordings = [person.record(10.0) for person in people]
    noticed = []
    for number, recording in enumerate(recordings):
        hands, memory = PersonMap(lambda p_HK: np.copy), np.zeros(1, PERSON_FIELDS)[0]
        other = recordings[number - 1]
        taken = []
        for each in (recording, other):
            step = max(1, round(0.1 * each.rate_hz))
            for frame, p_HK in enumerate(each.p_HK.astype(float)):
                if hands.measure(memory, p_HK) and frame % step == 0:
                    memory["compared"] = 0.0
                    taken.append(hands.is_other_person(memory, p_HK, 1.0))
            if each is recording:
                assert not any(taken)
        noticed.append(any(taken[-80:]))
    assert np.mean(noticed) >= 0.8


def test_with_engaged_input_the_retargeter_is_one_fixed_function_in_a_diagram():
    """The same hand gives the same joint positions at any time, whatever was shown in between."""
    hand = load_hand("allegro_right")
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.01)
    model = add_hand_model(plant, hand)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.base_frame, model))
    plant.Finalize()
    still, move = np.repeat(PLAY[400:401], 120, axis=0), PLAY[400:800]
    still = still + 1e-12 * np.arange(120)[:, None, None]  # a glove that is not frozen
    frames = np.concatenate([still, move, move[::-1], still, move, move[::-1], still])
    recording = Recording(0.01 * np.arange(len(frames)), frames, np.ones(len(frames), bool))
    replay = builder.AddSystem(GloveReplay(recording))
    retargeting = builder.AddSystem(RetargetingSystem(RETARGET, plant, model))
    builder.Connect(replay.GetOutputPort("keypoints"), retargeting.GetInputPort("keypoints"))
    builder.Connect(retargeting.GetOutputPort("desired_state"), plant.get_desired_state_input_port(model))
    simulator = Simulator(builder.Build())
    context = retargeting.GetMyContextFromRoot(simulator.get_context())
    seen = []
    for end in (1.15, 10.35, 19.55):
        simulator.AdvanceTo(end)
        assert retargeting.GetOutputPort("status").Eval(context).state == TRACKING
        seen.append(retargeting.GetOutputPort("desired_state").Eval(context)[:16].copy())
    np.testing.assert_allclose(seen[1:], [seen[0]] * 2, atol=1e-9)

"""Methods of one's own: a Python file, how it is called, and its faults."""

import copy
import runpy
from pathlib import Path

import numpy as np
import pytest
from grasp_setup import TOO_SHORT, allegro, person_who_plays, reach_goal
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from geort_drake import load_scenario
from geort_drake.benchmark.log import TrialKey
from geort_drake.benchmark.workers import simulate
from geort_drake.cli import run_command
from geort_drake.errors import MethodError
from geort_drake.methods import measure_latency, names_of, resolve
from geort_drake.own_method import OwnMethod
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.trial import Trial

DEX_EXAMPLE = Path(__file__).parents[1] / "examples" / "dex_retargeting_method.py"

FILE = """
import time
import numpy as np

def make(hand):
    calls = []
    middle = 0.5 * (hand.lower + hand.upper)
    def retarget(p_HK):
        calls.append(p_HK)
        q = middle
        {}
        return q
    return retarget
"""


def own(tmp_path, line: str = "pass") -> OwnMethod:
    path = tmp_path / "mine.py"
    path.write_text(FILE.format(line))
    return OwnMethod(path, allegro())


def test_each_trial_and_each_process_makes_the_method_anew(tmp_path, play):
    """What a method remembers ends with its trial."""
    method, p_HK = own(tmp_path, "q = middle + 0.01 * len(calls)"), play.p_HK[0]
    first = method(p_HK)
    assert not np.array_equal(method(p_HK), first)
    assert np.array_equal(copy.copy(method)(p_HK), first)
    method.reset()
    assert np.array_equal(method(p_HK), first) and method.joint_names == allegro().joint_names


FAULTS = {
    "raise ValueError('why')": "raised ValueError",
    "raise SystemExit('no licence')": "raised SystemExit",
    "q = None": "of shape ()",
    "q = q[:-1]": "of shape (15,)",
    "q = q[None]": "of shape (1, 16)",
    "q = q * np.nan": "not finite",
    "q = q + 100": "outside the limits",
    "q = q + 'rad'": "raised UFuncTypeError",
}


@pytest.mark.parametrize(("line", "fault"), list(FAULTS.items())[::3])
def test_a_fault_during_a_trial_is_counted_and_the_trial_goes_on(tmp_path, line, fault):
    """The joints hold, or stay at their limits; the row counts the answers."""
    method = own(tmp_path, f"if len(calls) > 3: {line}")
    scenario = load_scenario(text=TOO_SHORT.replace("}", ", retargeting: {latency: 0.05}}"))
    key = TrialKey("mine.py", 0, "grasp", "servo", "", "cylinder", 0, 0)
    record = simulate(key, Trial(scenario, method, (person_who_plays(), reach_goal())))
    assert record["outcome"].startswith("timeout") and list(record["faults"]) == [fault]
    assert record["faults"][fault] > 1


@pytest.mark.parametrize(("line", "fault"), [*FAULTS.items(), ("time.sleep(0.4)", "may take at most 0.3 s")])
def test_a_method_that_cannot_answer_the_first_frame_is_refused_by_its_file(tmp_path, play, line, fault):
    """Nothing is simulated, and the message says what is wrong."""
    with pytest.raises(MethodError) as error:
        own(tmp_path, line).check(play.p_HK[0])
    assert "mine.py" in str(error.value) and fault in str(error.value)


@pytest.mark.parametrize("text", ["", "make = 3", "import no_module", "def make(:", "def make(hand): pass"])
def test_a_file_without_a_method_is_refused(tmp_path, play, text):
    fault = r"(raised (Mod|Syn)|the file must define|make\(hand\) must return a function; it returned None)"
    (tmp_path / "mine.py").write_text(text)
    with pytest.raises(MethodError, match=rf"mine\.py: {fault}"):
        resolve(str(tmp_path / "mine.py"), allegro(), play)
    with pytest.raises(MethodError, match=r"other\.py: no such file"):
        names_of([str(tmp_path / "other.py")], allegro())


@pytest.mark.parametrize("command", ["grasp --retargeter", "explore --methods geort"])
def test_commands_refuse_an_unusable_file_before_they_plan_or_train(command, tmp_path, monkeypatch):
    monkeypatch.setattr(GraspPlanner, "plans", pytest.fail)
    monkeypatch.setattr("geort_drake.retargeting.train.cached_map", pytest.fail)
    (tmp_path / "mine.py").write_text("make = 3")
    name, *words = command.split()
    output = ["--output", str(tmp_path / ("run" if name == "grasp" else "e.rrd"))]
    with pytest.raises(MethodError, match="must define"):
        run_command(name, [*words, str(tmp_path / "mine.py"), *output])


def test_time_that_a_method_waits_counts_as_latency(tmp_path, play, monkeypatch):
    monkeypatch.setattr("geort_drake.methods._PARTS", 1)
    assert measure_latency(own(tmp_path, "time.sleep(0.005)"), play) >= 0.005


@pytest.fixture
def patient(monkeypatch):
    """A busy machine takes long for a call."""
    monkeypatch.setattr("geort_drake.own_method.MAX_CALL_TIME", 60.0)


def test_the_urdf_of_a_hand_has_its_fingertips(tmp_path):
    """Of the joints' names and limits too."""
    hand = allegro()
    plant = MultibodyPlant(0.0)
    (tmp_path / "hand.urdf").write_text(runpy.run_path(str(DEX_EXAMPLE))["hand_urdf"](hand))
    Parser(plant).AddModels(str(tmp_path / "hand.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    context, q = plant.CreateDefaultContext(), np.linspace(hand.lower, hand.upper, 5)[2]
    for name, angle, low in zip(hand.joint_names, q, hand.lower, strict=True):
        plant.GetJointByName(name).set_angle(context, angle)
        assert plant.GetJointByName(name).position_lower_limit() == low
    tips = [plant.GetBodyByName(f"{name}_tip").EvalPoseInWorld(context) for name in hand.finger_names]
    assert np.allclose([X.translation() for X in tips], hand.fingertips(q), atol=1e-9)


@pytest.mark.usefixtures("patient")
def test_a_method_of_another_package_runs(play):
    """dex-retargeting, by the example in the docs."""
    pytest.importorskip("dex_retargeting")
    OwnMethod(DEX_EXAMPLE, allegro()).check(play.p_HK[0])

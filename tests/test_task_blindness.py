"""The simulated person knows the robot by sight and touch alone: no module and no wire tells more."""

import ast
import dataclasses as dc
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
from grasp_setup import centred_map, goals, person_who_plays, reach_goal
from pydrake.systems.primitives import DiscreteTimeDelay

from geort_drake import load_scenario, make_trial_diagram
from geort_drake.simulation import person
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.person.perception import FreePlay
from geort_drake.simulation.tasks.keys import KeysGoal

# What the person's modules may run through besides each other, directly or not.
HARMLESS = {
    *(
        "errors",
        "files",
        "settings",
        "people.synthetic.hand",
        "people.synthetic.solid",
        "people.checks",
        "people.keypoints",
        "people.recording",
    ),
    *("simulation.wrist_motion", "systems.port_values", "systems.python_system"),
}
DRAKE = {"pydrake.math", "pydrake.common.value", "pydrake.common.eigen_geometry", "pydrake.systems.framework"}
LOAD = """
import importlib, pkgutil, sys
import geort_drake.simulation.person as person
for module in pkgutil.iter_modules(person.__path__):
    importlib.import_module(f"{person.__name__}.{module.name}")
print(*(name for name, module in sys.modules.items() if not hasattr(module, "__path__")))
"""


def test_no_module_of_the_person_runs_through_a_robot_or_a_map():
    """Not even indirectly, nor through a plant of Drake."""
    done = subprocess.run([sys.executable, "-c", LOAD], capture_output=True, text=True, check=True)
    loaded = {name.removeprefix("geort_drake.") for name in done.stdout.split() if "geort_drake." in name}
    assert "people.synthetic.hand" in loaded
    assert {name for name in loaded if not name.startswith("simulation.person.")} <= HARMLESS
    for module in pkgutil.iter_modules(person.__path__):
        tree = ast.parse(Path(person.__path__[0], f"{module.name}.py").read_text("utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                assert node.col_offset == 0 or "TYPE_CHECKING" in ast.unparse(tree), "an import in a function"
                names = [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                assert {name for name in names if name.startswith("pydrake")} <= DRAKE, module.name


def test_goals_tell_places_and_no_postures():
    """Nor the map; free play tells what could be seen then."""
    told = {field.name for goal in (GraspGoal, KeysGoal) for field in dc.fields(goal)}
    assert not told & {"q", "q_open", "q_pressed", "q_held", "joint_names", "retarget"}
    assert set(FreePlay._fields) == {"p_HF", "p_BF", "period"}


HAND = {"fingertips", "hand_pose", "object_pose"}


@pytest.mark.parametrize("hand", ["allegro_right", "allegro_left"])
@pytest.mark.parametrize(
    ("task", "mirrored", "unmirrored"),
    [
        ("grasp", HAND, {"contact"}),
        ("keys", HAND, {"positions", "phase", "contact"}),
        ("cap", HAND, {"positions", "contact"}),
        ("pick_place", HAND | {"place_pose"}, {"contact"}),
        ("peg", HAND | {"place_pose"}, {"contact"}),
    ],
)
def test_the_persons_ports_lead_through_delays_to_what_can_be_seen_and_felt(task, mirrored, unmirrored, hand):
    """Of a left hand in the mirror. The view reads only the plant; cue and keys are shown by the judge."""
    goal = reach_goal() if task == "grasp" else goals(task)[0]
    scenario = load_scenario(task=task, hand=hand)
    given = person_who_plays(), goal if hand == "allegro_right" else goal.mirrored()
    parts = make_trial_diagram(scenario, centred_map(), given)
    sources = {
        (system, system.get_input_port(port).get_name()): source
        for (system, port), source in parts.diagram.connection_map().items()
    }
    systems = ("operator", "scene_view", "judge")
    operator, view, judge = map(parts.diagram.GetSubsystemByName, systems)
    read = {name: source for (system, name), source in sources.items() if system is operator}
    assert set(read) == mirrored | unmirrored

    def before(system):
        return sources[system, system.get_input_port().get_name()]

    for name, (shown, _) in read.items():
        in_mirror = shown.get_name() == f"{name}_mirrored"
        assert in_mirror == (hand == "allegro_left" and name in mirrored)
        late = before(shown)[0] if in_mirror else shown
        assert isinstance(late, DiscreteTimeDelay)
        origin, port = before(late)
        assert origin in (view, judge) and origin.get_output_port(port).get_name() == name
    of_view = {name: source[0] for (system, name), source in sources.items() if system is view}
    assert set(of_view.values()) == {parts.plant}

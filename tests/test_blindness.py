"""The simulated person knows the robot by sight and touch alone: no module and no wire tells more."""

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
from grasp_setup import centred_map, person_and_rest, planned_goal, scenario_with
from pydrake.systems.primitives import DiscreteTimeDelay

from geort_drake.simulation import operators
from geort_drake.simulation.diagram import make_grasp_diagram

# What the person's modules may run through besides each other, directly or not.
HARMLESS = {
    *("errors", "files", "settings", "people.human_hand", "people.keypoints", "people.recording"),
    *("simulation.tasks.grasp.goal", "simulation.wrist_motion", "systems.port_values"),
}
DRAKE = {"pydrake.math", "pydrake.common.value", "pydrake.common.eigen_geometry", "pydrake.systems.framework"}
LOAD = """
import importlib, pkgutil, sys
import geort_drake.simulation.operators as operators
for module in pkgutil.iter_modules(operators.__path__):
    importlib.import_module(f"{operators.__name__}.{module.name}")
print(*(name for name, module in sys.modules.items() if not hasattr(module, "__path__")))
"""


def test_no_module_of_the_person_runs_through_a_robot_or_a_map():
    """Not even indirectly, nor through a plant of Drake."""
    done = subprocess.run([sys.executable, "-c", LOAD], capture_output=True, text=True, check=True)
    loaded = {name.removeprefix("geort_drake.") for name in done.stdout.split() if "geort_drake." in name}
    assert "people.human_hand" in loaded
    assert {name for name in loaded if not name.startswith("simulation.operators.")} <= HARMLESS
    for module in pkgutil.iter_modules(operators.__path__):
        tree = ast.parse(Path(operators.__path__[0], f"{module.name}.py").read_text("utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                assert node.col_offset == 0 or "TYPE_CHECKING" in ast.unparse(tree), "an import in a function"
                names = [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                assert {name for name in names if name.startswith("pydrake")} <= DRAKE, module.name


@pytest.mark.parametrize("hand", ["allegro_right", "allegro_left"])
def test_the_persons_ports_lead_through_delays_to_what_can_be_seen_and_felt(hand):
    """Of a left hand in the mirror; the view itself reads only the plant."""
    scenario = scenario_with("cylinder", f"{{hand: {hand}}}")
    parts = make_grasp_diagram(scenario, centred_map(), (person_and_rest()[0], planned_goal("cylinder")))
    sources = {
        (system, system.get_input_port(port).get_name()): source
        for (system, port), source in parts.diagram.connection_map().items()
    }
    operator, view = (parts.diagram.GetSubsystemByName(name) for name in ("operator", "scene_view"))
    read = {name: source for (system, name), source in sources.items() if system is operator}
    assert set(read) == {"fingertips", "hand_pose", "object_pose", "contact"}

    def before(system):
        return sources[system, system.get_input_port().get_name()]

    for name, (shown, _) in read.items():
        late = before(shown)[0] if shown.get_name() == f"{name}_mirrored" else shown
        assert isinstance(late, DiscreteTimeDelay)
        origin, port = before(late)
        assert origin is view and view.get_output_port(port).get_name() == name
    of_view = {name: source[0] for (system, name), source in sources.items() if system is view}
    assert set(of_view.values()) == {parts.plant}

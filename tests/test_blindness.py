"""The simulated person knows the robot by sight and touch alone: no module and no wire tells more."""

import ast

import pytest
from grasp_setup import centred_map, person_and_rest, planned_goal, scenario_with
from imported_sources import PACKAGE, imported_sources
from pydrake.systems.primitives import DiscreteTimeDelay

from geort_drake.simulation.diagram import make_grasp_diagram

OPERATORS = PACKAGE / "simulation" / "operators"
ROOMS = [path.name for path in PACKAGE.iterdir() if path.is_dir()]
# What the person's modules may run through besides each other, directly or not.
HARMLESS = {
    *("people/human_hand.py", "people/keypoints.py", "people/recording.py"),
    *("simulation/tasks/grasp/goal.py", "simulation/wrist_motion.py", "systems/port_values.py"),
}
DRAKE = {"pydrake.math", "pydrake.common.value", "pydrake.common.eigen_geometry", "pydrake.systems.framework"}


def test_no_module_of_the_person_runs_through_a_robot_or_a_map():
    """Not even indirectly, nor through a plant of Drake."""
    sources = imported_sources(OPERATORS.glob("*.py"), ROOMS)
    inside = {str(path.relative_to(PACKAGE)) for path in sources if OPERATORS not in path.parents}
    assert {"people/human_hand.py"} <= inside <= HARMLESS
    for path in sources:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [node.module] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert {name for name in names if name and name.startswith("pydrake")} <= DRAKE, path


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

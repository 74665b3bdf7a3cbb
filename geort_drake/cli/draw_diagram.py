"""Draw the block diagram of a scenario: systems, ports and connections.

Drawing needs Graphviz's `dot`.
"""

import argparse
from typing import TYPE_CHECKING

from geort_drake.cli.options import CommandParser, finish, output_file, scenario_of

if TYPE_CHECKING:
    from geort_drake.simulation.scenario import Scenario


def add_arguments(parser: CommandParser) -> None:
    parser.add_argument("--output", type=output_file(".svg"), default="diagram.svg", help="picture to write")
    parser.add_scenario()


def run(arguments: argparse.Namespace) -> int:
    import shutil

    import pydot

    from geort_drake.errors import GeortError
    from geort_drake.files import write_text

    if shutil.which("dot") is None:
        raise GeortError(
            "drawing needs Graphviz's program 'dot', which is not on the PATH; install Graphviz, for example "
            "with: apt-get install graphviz, or: brew install graphviz"
        )
    (graph,) = pydot.graph_from_dot_data(graphviz_text(scenario_of(arguments)))
    write_text(arguments.output, graph.create_svg().decode("utf-8"))
    finish({"Diagram": f"{arguments.output} (open it in a browser)"})
    return 0


def graphviz_text(scenario: "Scenario") -> str:
    """Returns Drake's Graphviz description of a scenario's diagram, with a stand-in retargeter and goal."""
    import numpy as np
    from pydrake.math import RigidTransform

    from geort_drake.hands.description import load_hand
    from geort_drake.people.human_hand import HumanHand
    from geort_drake.simulation.diagram import make_grasp_diagram
    from geort_drake.simulation.tasks.grasp.goal import GraspGoal

    description = load_hand(scenario.hand)

    def hold(_keypoints: np.ndarray) -> np.ndarray:
        return np.zeros(len(description.joint_names))

    hold.joint_names = description.joint_names  # type: ignore[attr-defined]
    fingers, X = tuple(description.finger_names), RigidTransform()
    points = np.zeros((len(fingers), 3))
    goal = GraspGoal(fingers, np.ones(len(fingers), bool), X, X, points, points, points, 0.0)
    human = (HumanHand.anatomical(), goal)
    return make_grasp_diagram(scenario, hold, human).diagram.GetGraphvizString(max_depth=1)

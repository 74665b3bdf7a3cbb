"""Draws docs/diagram.svg: the block diagram of a grasp trial, its systems grouped and coloured.

python studies/draw_diagram.py

The picture shows the connected ports and the values between them. Needs Graphviz's `dot`. Run it again when
systems or ports have changed.
"""

import argparse
import dataclasses as dc
import html
import importlib
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import PortDataType

from geort_drake.console import run_main
from geort_drake.errors import GeortError
from geort_drake.files import write_text
from geort_drake.hands.description import load_hand
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.scenario_files import load_scenario

FONT = "Helvetica"
PALE = "#B9B8B0"


@dc.dataclass(frozen=True)
class Group:
    """Systems that are drawn together; groups with the same column are stacked."""

    title: str
    column: int
    fill: str
    color: str
    members: tuple[str, ...] = ()


GROUPS = {
    "human": Group("Human", 0, "#FDF1E3", "#B56A0F", ("operator", "glove_replay", "seen_late")),
    "fingers": Group("Fingers", 1, "#E8F1FB", "#2F6DB3", ("retargeting", "action_correction")),
    "arm": Group("Arm", 1, "#EAF6EC", "#3B8A4E", ("wrist_to_arm",)),
    "physics": Group("Physics", 2, "#F1ECF8", "#6B4BA3", ("plant", "scene_graph")),
    "results": Group("Seeing, judging, recording", 3, "#F3F3F1", "#5F5E58"),
}


PICTURE = Path(__file__).resolve().parents[1] / "docs" / "diagram.svg"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=PICTURE, help="picture to write")
    parser.add_argument("--task", default="grasp", help="task whose scenario is drawn")
    arguments = parser.parse_args(argv)
    write_text(arguments.output, draw_scenario(load_scenario(task=arguments.task)))
    return 0


def draw_scenario(scenario: Scenario) -> str:
    """Returns a scenario's diagram as SVG, drawn with Graphviz.

    Raises:
        GeortError: Graphviz's program `dot` is not installed.
    """
    if shutil.which("dot") is None:
        raise GeortError(
            "drawing needs Graphviz's program 'dot', and it is not on the PATH; install Graphviz, "
            "for example with: apt-get install graphviz, or: brew install graphviz"
        )
    with tempfile.TemporaryDirectory() as folder:
        parts = build(scenario, Path(folder) / "unused.rrd")
        svg = draw(parts.diagram, f"delays of {1e3 * scenario.operator.visual_delay:g} ms")
        if parts.recorder is not None:
            parts.recorder.close()
    return svg


def build(scenario: Scenario, rerun_path: Path) -> TrialDiagram:
    """Returns the scenario's diagram with a dummy retargeter and goal, which do not change the picture."""
    description = load_hand(scenario.hand)
    fingers = len(description.fingers)

    def hold(_keypoints: np.ndarray) -> np.ndarray:
        return np.zeros(len(description.joint_names))

    hold.joint_names = description.joint_names  # type: ignore[attr-defined]
    goal = GraspGoal(
        finger_names=tuple(description.finger_names),
        touches=np.ones(fingers, bool),
        clearance=0.0,
        X_OB=RigidTransform(),
        X_OB_before=RigidTransform(),
        p_BF_open=np.zeros((fingers, 3)),
        p_OF_touch=np.zeros((fingers, 3)),
        n_OF=np.zeros((fingers, 3)),
        yaw_symmetry=0.0,
    )
    return make_trial_diagram(scenario, hold, (HumanHand.anatomical(), goal), rerun_path)


# -- from the diagram to boxes and lines


@dc.dataclass
class Box:
    """A system or several similar ones, with connected ports: name → order, and type of the value."""

    title: str
    kind: str
    group: str
    inputs: dict[str, tuple[int, str]] = dc.field(default_factory=dict)
    outputs: dict[str, tuple[int, str]] = dc.field(default_factory=dict)


@dc.dataclass(frozen=True)
class Line:
    """A connection from an output of one box to an input of another, by key and port name."""

    source: str
    output: str
    target: str
    input: str


def boxes_and_lines(diagram: Any, delay_text: str) -> tuple[dict[str, Box], list[Line]]:
    """Returns boxes and lines, sorted so that a diagram always gives the same picture."""
    found = [
        (source, source.get_output_port(out), target, target.get_input_port(into))
        for (target, into), (source, out) in diagram.connection_map().items()
    ]
    found = [edge for edge in found if not edge[1].get_name().startswith("deformable")]
    found.sort(key=lambda edge: (edge[0].get_name(), edge[1].get_index(), edge[2].get_name()))
    boxes: dict[str, Box] = {}
    lines = []
    for source, out, target, into in found:
        ends = []
        for system, port, others in ((source, out, into), (target, into, out)):
            name, port_name, order = system.get_name(), port.get_name(), port.get_index()
            kind = re.sub(r"[^A-Za-z].*", "", type(system).__name__)
            if kind == "DiscreteTimeDelay":
                # The similar delays are drawn as one box with a port each, in the order of their neighbours.
                port_name, name, kind = name.removesuffix("_seen_late"), "seen_late", delay_text
                order = others.get_index()
            box = boxes.setdefault(name, Box(name.replace("_", " "), kind, group_of(name)))
            (box.outputs if port is out else box.inputs).setdefault(port_name, (int(order), content(out)))
            ends += [name, port_name]
        lines.append(Line(*ends))
    for box in boxes.values():
        box.inputs, box.outputs = (
            dict(sorted(p.items(), key=lambda i: i[1])) for p in (box.inputs, box.outputs)
        )
    return dict(sorted(boxes.items())), lines


def group_of(name: str) -> str:
    """Returns the key of the group of a system; systems without a group go to the last one."""
    return next((key for key, group in GROUPS.items() if name in group.members), "results")


def content(port: Any) -> str:
    """Describes the value of a port: the size of a vector, or the type of an abstract value."""
    if port.get_data_type() == PortDataType.kVectorValued:
        return str(port.size())
    value = port.Allocate().get_value()
    if isinstance(value, list):
        return f"list of {type(value[0]).__name__}" if value else "list"
    return re.sub(r"[^A-Za-z].*", "", type(value).__name__)


# -- drawing


def draw(diagram: Any, delay_text: str) -> str:
    """Returns the diagram as SVG.

    Args:
        delay_text: text on the delays between the scene and the human.
    """
    pydot: Any = importlib.import_module("pydot")  # slow to import, and its types are wrong

    boxes, lines = boxes_and_lines(diagram, delay_text)
    graph = pydot.Dot(
        "diagram",
        rankdir="LR",
        bgcolor="white",
        fontname=FONT,
        fontsize="12",
        fontcolor="#6B6A64",
        label="Next to each output: the size of its vector, or the type of its value. "
        "A thick arrow stands for several connections.",
        nodesep="0.3",
        ranksep="0.4",
        pad="0.1",
    )
    for key, group in GROUPS.items():
        cluster = pydot.Cluster(
            key,
            label=group.title,
            labeljust="l",
            fontname=f"{FONT} bold",
            fontsize="15",
            fontcolor=group.color,
            style="rounded,filled",
            fillcolor=group.fill,
            color=group.color,
            margin="12",
        )
        for name, box in boxes.items():
            if box.group == key:
                cluster.add_node(
                    pydot.Node(name, label=table(box, group.color), shape="plain", fontname=FONT)
                )
        graph.add_subgraph(cluster)
    for attributes in edges(boxes, lines):
        graph.add_edge(pydot.Edge(**attributes))
    svg = graph.create(prog="dot", format="svg").decode("utf-8")
    # Graphviz writes its version in a comment, which must not change the picture.
    return re.sub(r"<!--.*?-->\n?", "", svg, flags=re.DOTALL)


def table(box: Box, color: str) -> str:
    """Returns a box with inputs on the left, and outputs with their types on the right."""

    def cell(prefix: str, name: str, text: str, side: str) -> str:
        return f'<TR><TD PORT="{prefix}{port_id(name)}" ALIGN="{side}">{text}</TD></TR>'

    inputs = [cell("u", name, html.escape(name), "LEFT") for name in box.inputs]
    outputs = [
        cell("y", name, f'{html.escape(name)} <FONT COLOR="{color}">{html.escape(flow)}</FONT>', "RIGHT")
        for name, (_, flow) in box.outputs.items()
    ]
    columns = [
        f'<TD CELLPADDING="4" VALIGN="TOP"><TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0" '
        f'CELLPADDING="2">{"".join(rows)}</TABLE></TD>'
        for rows in (inputs, outputs)
        if rows
    ]
    return (
        f'<<FONT POINT-SIZE="12"><TABLE BORDER="1" CELLBORDER="0" CELLSPACING="0" BGCOLOR="white" '
        f'COLOR="{color}" STYLE="ROUNDED"><TR><TD COLSPAN="{len(columns)}" CELLPADDING="4">'
        f'<B>{html.escape(box.title)}</B><BR/><FONT POINT-SIZE="10" COLOR="#6B6A64">'
        f"{html.escape(box.kind)}</FONT></TD></TR><TR>{''.join(columns)}</TR></TABLE></FONT>>"
    )


def edges(boxes: dict[str, Box], lines: list[Line]) -> Iterator[dict[str, str]]:
    """Yields an arrow per connection, but only one from a box to a recorder or back to the human."""
    bundled = set()
    for line in lines:
        source, target = GROUPS[boxes[line.source].group], GROUPS[boxes[line.target].group]
        recording = line.target.endswith(("recorder", "_positions"))
        seeing = line.target == "seen_late"
        style = {
            "color": PALE if recording else source.color,
            "penwidth": "1.4",
            "arrowsize": "0.8",
            # A line that leads back must not move its target to the right of its source.
            "constraint": "false" if source.column > target.column else "true",
        }
        if not (recording or seeing):
            ends = f"{line.source}:y{port_id(line.output)}:e", f"{line.target}:u{port_id(line.input)}:w"
            yield {"src": ends[0], "dst": ends[1], **style}
        elif (line.source, line.target) not in bundled:
            bundled.add((line.source, line.target))
            ends = (f"{line.source}:s", f"{line.target}:s") if seeing else (line.source, line.target)
            yield {"src": ends[0], "dst": ends[1], **style, "penwidth": "3"}


def port_id(name: str) -> str:
    """Returns a port's name as a Graphviz identifier."""
    return re.sub(r"\W", "_", name)


if __name__ == "__main__":
    run_main(main)

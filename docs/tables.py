"""Tables in the pages that come from the code: `make tables` writes them, and a test compares them.

A page marks such a table by a comment, in which cog (https://cog.readthedocs.io) runs one of these functions:

    <!-- [[[cog cog.outl(fields_table("Scenario")) ]]] -->
    <!-- [[[end]]] -->

The result stands between the two lines and is committed, so that every page is whole wherever it is read.
"""

import ast
import csv
import io
import os
import re
import sys
import tokenize
from pathlib import Path
from unittest import mock

import geort_drake

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "geort_drake"


def field_rows(name: str) -> list[tuple[list[str], list[str], str]]:
    """Names, defaults and meaning of a dataclass's fields, read from its source and its comments.

    A comment above a field that ends with a colon is a heading, and gets a row of its own.
    """
    path, node = find_class(name)
    lines = path.read_text("utf-8").splitlines()
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO("\n".join(lines)).readline)
        if token.type == tokenize.COMMENT
    }
    inherited = {}
    for base in node.bases:
        if isinstance(base, ast.Name):
            inherited = {row[0][0]: row[2] for row in field_rows(base.id)}
    rows: list[tuple[list[str], list[str], str]] = []
    shared = False  # whether the last row's comment stands above it, and so above the fields that follow
    for item in node.body:
        if not isinstance(item, ast.AnnAssign) or not isinstance(item.target, ast.Name):
            continue
        assert item.end_lineno is not None
        line, above = item.lineno, []
        while (line := line - 1) in comments and lines[line - 1].lstrip().startswith("#"):
            above.insert(0, comments[line])
        if above and above[0].endswith(":"):  # a heading of the fields that follow
            rows.append(([f"**{above.pop(0)[:-1]}**"], [""], ""))
            shared = False
        after = comments.get(item.end_lineno, "")
        field, default = f"`{item.target.id}`", default_of(item.value)
        if shared and not above and not after and "](" not in default:
            rows[-1][0].append(field)
            rows[-1][1].append(default)
            continue
        if "](" in default:
            shared = False
            rows.append(([field], ["–"], " ".join([*above, after, f"Fields: {default}."]).strip()))
            continue
        shared = bool(above)
        rows.append(([field], [default], " ".join([*above, after]).strip() or inherited.get(field, "")))
    return rows


def program(name: str) -> str:
    """A Python file of the repository in a fenced block, with its name as title."""
    return f'```python title="{name}"\n{(ROOT / name).read_text("utf-8")}```'


def docstring(name: str) -> str:
    """The docstring of a module, or of a function of it, such as "people.formats.read_openxr".

    The title of a module is left out, because the page has one.
    """
    path = PACKAGE / f"{name.replace('.', '/')}.py"
    if path.is_file():
        text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
        return text.partition("\n\n")[2]
    path, _, function = name.rpartition(".")
    tree = ast.parse((PACKAGE / f"{path.replace('.', '/')}.py").read_text("utf-8"))
    (node,) = (item for item in tree.body if isinstance(item, ast.FunctionDef) and item.name == function)
    return ast.get_docstring(node) or ""


def api_table(names: str) -> str:
    """A Markdown table of public names and the first sentences of their docstrings, with links to the source.

    On the site, the docstrings themselves stand in its place. Of a module, the table has the public contents.

    Args:
        names: dotted names, separated by spaces.
    """
    table = ["| name | what it is |", "|---|---|"]
    for name in names.split():
        path, nodes = _definitions(name)
        for node in nodes:
            text = " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split())
            link = f"[`{node.name}`](../../../{path.relative_to(ROOT)})"
            table.append(f"| {link} | {text.replace('|', chr(92) + '|')} |")
    return "\n".join(table)


def _definitions(name: str) -> tuple[Path, list[ast.ClassDef | ast.FunctionDef]]:
    """The file of a dotted name, and its definition there; those of all public contents for a module."""
    place, _, last = name.rpartition(".")
    if place == "geort_drake" and last in geort_drake._MODULES:
        place = f"geort_drake.{geort_drake._MODULES[last]}"
    module, path = (ROOT / f"{part.replace('.', '/')}.py" for part in (name, place))
    path = module if module.is_file() else path if path.is_file() else path.with_suffix("") / "__init__.py"
    body = ast.parse(path.read_text("utf-8")).body
    defined = [node for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
    if path == module:
        return path, [node for node in defined if not node.name.startswith("_")]
    if found := [node for node in defined if node.name == last]:
        return path, found
    imports = (node for node in body if isinstance(node, ast.ImportFrom))
    (source,) = (node.module for node in imports if last in [alias.name for alias in node.names])
    return _definitions(f"{source}.{last}")


def sources(name: str) -> str:
    """The paragraph of a dataclass's docstring that lists the sources of its values."""
    paragraphs = (ast.get_docstring(find_class(name)[1]) or "").split("\n\n")
    (text,) = (paragraph for paragraph in paragraphs if paragraph.startswith("Sources:"))
    return text


def fields_table(name: str) -> str:
    """A Markdown table of a dataclass's fields."""
    table = ["| field | default | meaning |", "|---|---|---|"]
    for fields, defaults, meaning in field_rows(name):
        shown = ", ".join(defaults) if len(set(defaults)) > 1 else defaults[0]
        text = meaning.replace("|", "\\|")
        text = text if re.match(r"(m|rad|s|N)\b|[^a-z]", text) else text[:1].upper() + text[1:]
        table.append(f"| {', '.join(fields)} | {shown} | {text} |")
    return "\n".join(table)


def find_class(name: str) -> tuple[Path, ast.ClassDef]:
    """The module of the package that defines a class, and its definition."""
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text("utf-8")
        if re.search(rf"^class {name}\b", text, re.MULTILINE):
            for node in ast.parse(text).body:
                if isinstance(node, ast.ClassDef) and node.name == name:
                    return path, node
    raise LookupError(f"no class {name} in geort_drake")


def default_of(value: ast.expr | None) -> str:
    """A field's default as code; for a nested dataclass a link to its own table."""
    if value is None:
        return "required"
    if isinstance(value, ast.Call) and ast.unparse(value.func).endswith("field"):
        (factory,) = (word.value for word in value.keywords if word.arg == "default_factory")
        if isinstance(factory, ast.Lambda):
            text = ast.unparse(factory.body)
            return f"`{text}`" if len(text) < 40 else "see below"
        name = ast.unparse(factory)
        return {"list": "`[]`", "dict": "`{}`"}.get(name, f"[`{name}`](#{name.lower()})")
    return f"`{ast.unparse(value)}`"


def commands_table() -> str:
    """A Markdown table of the subcommands and their summaries."""
    rows = [f"| [`{name}`](#{name.replace(' ', '-')}) | {summary} |" for name, summary, _ in commands()]
    return "\n".join(["| command | does |", "|---|---|", *rows])


def commands_help() -> str:
    """The help of every subcommand under a heading."""
    return "\n\n".join(f"### {name}\n\n```text\n{text}```" for name, _, text in commands())


def commands() -> list[tuple[str, str, str]]:
    """Name, summary and help of every subcommand, in the order of `geort-drake --help`."""
    from geort_drake.cli import COMMANDS, help_of, summary_of

    with mock.patch.dict(os.environ, COLUMNS="100"):  # the width of the help
        return [(name, summary_of(name), help_of(name)) for name in COMMANDS]


def protocol_table() -> str:
    """A Markdown table of the capture protocol's steps."""
    from geort_drake.people.synthetic.protocol import STEPS

    rows, start = ["| start | time | step | what to do |", "|---|---|---|---|"], 0.0
    for step in STEPS:
        clock = f"{start // 60:.0f}:{start % 60:02.0f}"
        rows.append(f"| {clock} | {step.seconds:.0f} s | {step.name} | {step.instruction} |")
        start += step.seconds
    return "\n".join(rows)


def methods_table() -> str:
    """A Markdown table of the retargeting methods."""
    from geort_drake.retargeting import METHODS

    rows = [f"| `{name}` | {method.summary} |" for name, method in METHODS.items()]
    return "\n".join(["| method | description |", "|---|---|", *rows])


def packages_table() -> str:
    """A Markdown table of the subpackages, in the order of their imports."""
    rows = ["| subpackage | contents |", "|---|---|"]
    for node in ast.parse((ROOT / "tests" / "test_layering.py").read_text("utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "SUBPACKAGES":
            for name in ast.literal_eval(node.value):
                module = ast.parse((PACKAGE / name / "__init__.py").read_text("utf-8"))
                rows.append(f"| `{name}` | {(ast.get_docstring(module) or '').splitlines()[0]} |")
    return "\n".join(rows)


def formats_table() -> str:
    """A Markdown table of the formats of recordings."""
    from geort_drake.people.formats import FORMATS

    rows = [f"| `{name}` | {entry.title} | {', '.join(entry.suffixes)} |" for name, entry in FORMATS.items()]
    return "\n".join(["| format | contents | files |", "|---|---|---|", *rows])


def tasks_table() -> str:
    """A Markdown table of the benchmark's tasks."""
    from geort_drake.simulation.tasks import find_task, task_names

    tasks = [find_task(name) for name in task_names()]
    rows = [f"| `{task.name}` | {task.summary} |" for task in tasks]
    return "\n".join(["| task | what the person does |", "|---|---|", *rows])


def objects_table() -> str:
    """A Markdown table of the objects to grasp, with the extents of their collision geometry."""
    import numpy as np
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.systems.framework import DiagramBuilder

    from geort_drake.resources import object_names
    from geort_drake.simulation.object_shape import ObjectShape
    from geort_drake.simulation.plan.contacts import grip_of
    from geort_drake.simulation.world import add_object

    rows = ["| object | grip | size, mm | mass, kg | friction |", "|---|---|---|---|---|"]
    for name in object_names():
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
        body, inspector = add_object(plant, name), scene_graph.model_inspector()
        solid = inspector.GetProximityProperties(plant.GetCollisionGeometriesForBody(body)[0])
        friction = solid.GetProperty("material", "coulomb_friction").static_friction()
        shape, extents = ObjectShape(plant, inspector, body), []
        for axis in np.eye(3):
            ups = (RotationMatrix.MakeFromOneVector(up, 2) for up in (axis, -axis))
            extents.append(-sum(shape.lowest_point(RigidTransform(R.inverse())) for R in ups))
        size = " × ".join(f"{1e3 * extent:.3g}" for extent in extents)
        rows.append(f"| `{name}` | {grip_of(name)} | {size} | {body.default_mass():g} | {friction:g} |")
    return "\n".join(rows)


def hands_table() -> str:
    """A Markdown table of the hands whose models come with the package."""
    from geort_drake.hands.hand import Hand

    rows = ["| name | joints | mass | tip radius | stiffness | torque limit |", "|---|---|---|---|---|---|"]
    for name, description in _hands():
        if description.source.get:
            continue
        hand = Hand(description)
        motor = hand.plant.get_joint_actuator(hand.plant.GetJointActuatorIndices()[0])
        mass = hand.plant.CalcTotalMass(hand.plant.CreateDefaultContext())
        rows.append(
            f"| `{name}` | {len(hand.joint_names)} | {mass:.3f} kg | {1e3 * hand.tip_radius:.3g} mm "
            f"| {motor.get_controller_gains().p:g} N·m/rad | {motor.effort_limit():g} N·m |"
        )
    return "\n".join(rows)


def named_hands_table() -> str:
    """A Markdown table of the hands by name and of their models."""
    columns = ("name", "hand", "fingers, joints of q", "model", "licence", "command that gets it")
    rows = [f"| {' | '.join(columns)} |", "|---|---|---|---|---|---|"]
    for name, hand in _hands():
        comments = (ROOT / "models" / "hands" / f"{name}.yaml").read_text("utf-8").splitlines()
        title = comments[0].lstrip("# ").split(" Fields:")[0].rstrip(".")
        source = hand.source
        published = (source.published, source.licence, f"`{source.get}`") if source.get else ("own", "", "")
        rows.append(
            f"| `{name}` | {title} | {len(hand.fingers)}, {len(hand.joint_names)} | {' | '.join(published)} |"
        )
    return "\n".join(rows)


def hand_figures_table() -> str:
    """A Markdown table of the figures of the shipped maps, of people in no training."""
    from geort_drake.retargeting.store import load_retargeter, shipped_maps

    columns = (
        "motion", "steps", "gain p95/p5", "closed", "too deep", "false", "collision", "cross-talk",
        "posture", "p90",
    )  # fmt: skip
    rows = [f"| name | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for name in shipped_maps():
        info = load_retargeter(name).info
        if "unseen_people" not in info:
            continue
        texts = []
        for column in columns:
            value = info["unseen_people"][column]
            if column in ("closed", "too deep", "false", "collision"):
                texts.append(f"{100 * value:.1f} %")
            elif column in ("posture", "p90"):
                texts.append(f"{value:.0f}°")
            else:
                texts.append(f"{value:.1f}" if column.startswith("gain") else f"{value:.3f}")
        rows.append(f"| `{name}` | {' | '.join(texts)} |")
    return "\n".join(rows)


def hands_by_name_table() -> str:
    """A Markdown table of the hands with a shipped map: joints, and figures of people in no training."""
    from geort_drake.retargeting.store import load_retargeter, shipped_maps

    rows = ["| name | joints of q | motion kept | pinches closed | self-collision |", "|---|---|---|---|---|"]
    retargeters = {name: load_retargeter(name) for name in shipped_maps()}
    right = {name: each for name, each in retargeters.items() if "unseen_people" in each.info}
    for name, each in sorted(right.items(), key=lambda item: -item[1].info["unseen_people"]["motion"]):
        figures, left = each.info["unseen_people"], name.replace("right", "left")
        names = f"`{name}`, `{left}`" if left in retargeters else f"`{name}`"
        closed, collision = (f"{100 * figures[column]:.1f} %" for column in ("closed", "collision"))
        motion = f"{figures['motion']:.2f}"
        rows.append(f"| {names} | {len(each.joint_names)} | {motion} | {closed} | {collision} |")
    return "\n".join(rows)


TASKS = ("grasp", "pick_place", "peg", "keys", "cap")


def tasks_overview_table() -> str:
    """A Markdown table of successes of trials by method and task, from docs/results/tasks.csv."""
    counts = _trial_counts("task")
    rows = [f"| method | {' | '.join(TASKS)} | all |", f"|---|{'---|' * len(TASKS)}---|"]
    totals = {
        method: [sum(column) for column in zip(*by_task.values(), strict=True)]
        for method, by_task in counts.items()
    }
    for method in sorted(totals, key=lambda method: -totals[method][0] / totals[method][1]):
        done, number = totals[method]
        cells = [f"{k} of {n}" for k, n in (counts[method][task] for task in TASKS)]
        cells.append(f"{done} of {number}, {100 * done / number:.0f} %")
        rows.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(rows)


def task_table(task: str) -> str:
    """A Markdown table of a task: successes and mean score by method and kind of person."""
    kinds = ("adaptive", "mimicry", "servo")
    rows = [f"| method | {' | '.join(kinds)} |", f"|---|{'---|' * len(kinds)}"]
    for method in dict.fromkeys(row["method"] for row in _trial_rows()):
        cells = []
        for kind in kinds:
            trials = [
                row
                for row in _trial_rows()
                if (row["task"], row["kind"], row["method"]) == (task, kind, method)
            ]
            done = sum(row["success"] == "1" for row in trials)
            score = sum(float(row["score"]) for row in trials) / len(trials)
            cells.append(f"{done} of {len(trials)}, {score:.2f}")
        rows.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(rows)


def small_objects_table() -> str:
    """A Markdown table of small objects that people grasp, by method, from docs/results/small_objects.csv."""
    import pandas as pd

    trials = pd.read_csv(ROOT / "docs" / "results" / "small_objects.csv")
    methods = list(dict.fromkeys(trials["method"]))
    rows = [f"| object | {' | '.join(f'`{name}`' for name in methods)} |", f"|---|{'---|' * len(methods)}"]
    groups = [(f"`{name}`", group) for name, group in trials.groupby("case", sort=False)]
    for name, group in [*groups, ("all", trials)]:
        cells = []
        for method in methods:
            of_method = group[group["method"] == method]
            tips = of_method["tip_success"].sum()
            cells.append(f"{of_method['success'].sum()} of {len(of_method)}, {tips} by fingertips alone")
        rows.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(rows)


def cases_table(name: str, *columns: str) -> str:
    """A Markdown table of successes by these columns and task, from a CSV file of docs/results.

    A file that has a column `person` also gets the successes of each person.
    """
    with open(ROOT / "docs" / "results" / f"{name}.csv", encoding="utf-8", newline="") as file:
        trials = list(csv.DictReader(file))
    people = sorted({row["person"] for row in trials if "person" in row})
    header = [*(column.replace("_", " ") for column in columns), *TASKS, "all", *["by person"][: len(people)]]
    rows = [header, ["---"] * len(header)]
    for values in dict.fromkeys(tuple(row[column] for column in columns) for row in trials):
        own = [row for row in trials if tuple(row[column] for column in columns) == values]
        groups = [[row for row in own if row["task"] == task] for task in TASKS]
        cells = [f"{_successes(group)} of {len(group)}" if group else "–" for group in [*groups, own]]
        if people:
            by_person = [[row for row in own if row["person"] == person] for person in people]
            cells.append(", ".join(str(_successes(group)) if group else "–" for group in by_person))
        names = [f"`{v}`" if column == "method" else v for column, v in zip(columns, values, strict=True)]
        rows.append([*names, *cells])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _successes(trials: list[dict[str, str]]) -> int:
    return sum(row["success"] == "1" for row in trials)


def criteria_table() -> str:
    """A Markdown table of what spoiled criteria cost, from docs/results/criteria.csv."""
    sys.path.insert(0, str(ROOT / "studies"))
    from criteria import report

    return report(_rows_of("criteria"))


def gates_table() -> str:
    """A Markdown table of the faults of maps that each task reveals, from docs/results/gates.csv."""
    sys.path.insert(0, str(ROOT / "studies"))
    from gates import tests_of, verdicts

    from geort_drake.benchmark.analysis import frame_of

    return verdicts(tests_of(frame_of(_rows_of("gates"))))


def scripted_table() -> str:
    """A Markdown table of the trials of scripted robots and of a still hand, from docs/results/gates.csv."""
    rows = _rows_of("gates")
    lines = [f"| | {' | '.join(TASKS)} |", f"|---|{'---|' * len(TASKS)}"]
    for name, method in (("scripted robot", "scripted"), ("hand that holds still", "hold")):
        groups = [[row for row in rows if (row["method"], row["task"]) == (method, task)] for task in TASKS]
        cells = [f"{sum(row['success'] for row in group)} of {len(group)}" for group in groups]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _rows_of(study: str) -> list[dict]:
    """The rows of a study's trials, from its CSV file in docs/results."""
    import pandas as pd

    trials = pd.read_csv(ROOT / "docs" / "results" / f"{study}.csv", dtype={"condition": str})
    return trials.fillna({"condition": ""}).to_dict("records")


def _trial_counts(column: str) -> dict[str, dict[str, tuple[int, int]]]:
    """Returns the numbers of successes and of trials by method and by a column."""
    counts: dict[str, dict[str, tuple[int, int]]] = {}
    for row in _trial_rows():
        done, number = counts.setdefault(row["method"], {}).get(row[column], (0, 0))
        counts[row["method"]][row[column]] = done + (row["success"] == "1"), number + 1
    return counts


def _trial_rows() -> list[dict[str, str]]:
    with open(ROOT / "docs" / "results" / "tasks.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _hands() -> list:
    """The hands by name, each with its description."""
    from geort_drake.hands.description import load_hand
    from geort_drake.resources import hand_names

    return [(name, load_hand(name)) for name in hand_names()]


def phases_table(module: str, phases: str, first: str = "", last: str = "") -> str:
    """A Markdown table of the simulated person's phases in a module of `simulation.person`, first to last."""
    import importlib

    rows = ["| phase | wrist | fingers | ends when |", "|---|---|---|---|"]
    table = getattr(importlib.import_module(f"geort_drake.simulation.person.{module}"), phases)
    names = [phase.name for phase in table]
    begin, end = names.index(first) if first else 0, names.index(last) + 1 if last else len(names)
    for phase in table[begin:end]:
        cells = [phase.wrist.__doc__, phase.fingertips.__doc__, phase.ends.__doc__]
        rows.append(f"| {phase.name} | {' | '.join(cells)} |")
    return "\n".join(rows)


def kinds_table() -> str:
    """A Markdown table of the kinds of people."""
    from geort_drake.simulation.person.config import OperatorConfig
    from geort_drake.simulation.person.engine import KINDS

    moves = {
        "none": "only to correct what they see",
        "as own": "as the robot should move",
        "learned": "as they have learned that the robot needs",
    }
    looks = {"all": "all fingers", "one": "the finger they look at, and the thumb"}
    rows = ["| kind | moves a finger | corrects | rate of correction |", "|---|---|---|---|"]
    for name, kind in KINDS.items():
        rate = getattr(OperatorConfig(), kind.rate)
        rows.append(f"| `{name}` | {moves[kind.feedforward]} | {looks[kind.looks_at]} | {rate} /s |")
    return "\n".join(rows)

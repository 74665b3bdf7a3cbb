"""Subpackages import only lower ones, modules import in no cycle, and light modules stay light."""

import ast
import functools
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "geort_drake"
# Each may import those before it, and every single module of geort_drake/ such as files.py.
SUBPACKAGES = [
    "people", "hands", "retargeting", "systems", "rerun", "simulation",
    "metrics", "benchmark", "export", "live", "cli",
]  # fmt: skip


@functools.cache
def imports(path: Path) -> list[str]:
    """What a file imports, also within functions."""
    todo: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    found = []
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [f"{node.module}.{alias.name}" for alias in node.names]
        todo.extend(ast.iter_child_nodes(node))
    return found


@pytest.mark.parametrize("subpackage", SUBPACKAGES)
def test_a_subpackage_imports_only_lower_ones(subpackage):
    upper = {*SUBPACKAGES[SUBPACKAGES.index(subpackage) + 1 :]}
    for path in (PACKAGE / subpackage).rglob("*.py"):
        used = {name.split(".")[1] for name in imports(path) if name.startswith("geort_drake.")}
        assert not used & upper, path


def test_no_modules_import_each_other_in_a_cycle():
    """Imports within functions and for types alone count too, except those of the lazy `geort_drake`."""
    known, graph = {}, {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        known[".".join(parts).removesuffix(".__init__")] = path
    for name, path in known.items():
        used = {part for part in imports(path) if part.startswith("geort_drake.")}
        graph[name] = {part if part in known else part.rpartition(".")[0] for part in used} - {name}
    del graph["geort_drake"]
    tasks = "geort_drake.simulation.tasks"  # find_task imports the tasks by name
    graph[tasks] |= {name for name in known if name.startswith(f"{tasks}.")}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError with the cycle


@pytest.mark.parametrize(
    ("package", "subpackage"), [("pydrake", "people"), ("pydrake", "retargeting"), ("rerun", "")]
)
def test_a_package_is_kept_out_of_subpackages(package, subpackage):
    """People and retargeting run without Drake; only the bridge imports Rerun."""
    for path in (PACKAGE / subpackage).rglob("*.py"):
        if package != "rerun" or path.parent.name != "rerun":
            used = {name.split(".")[0] for name in imports(path)}
            assert package not in used, path


@pytest.mark.parametrize(
    ("module", "packages"),
    [
        ("geort_drake", set()),
        ("geort_drake.live.driver", {"numpy", "msgspec", "zmq"}),
        ("geort_drake.retargeting.store", {"numpy", "safetensors"}),
        ("geort_drake.retargeting.online", {"numpy", "safetensors"}),
    ],
)
def test_a_light_module_loads_only_what_it_needs(module, packages):
    """The package loads nothing until it is used; on the robot a retargeter and a driver need NumPy."""
    code = f"import sys; before = {{*sys.modules}}; import {module}; print(*({{*sys.modules}} - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0].lstrip("_") for name in done.stdout.split()}
    loaded -= {name.lstrip("_") for name in sys.stdlib_module_names} | {"typing_extensions"}  # pyzmq's
    assert {name for name in loaded if not name.startswith("cython")} == {"geort_drake"} | packages

"""The layers import only downward."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "geort_drake"


def _imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


@pytest.mark.parametrize("room", ["retargeting", "people"])
def test_numeric_rooms_import_neither_drake_nor_rerun(room):
    """Training and glove code must run where Drake is not installed."""
    for path in (PACKAGE / room).rglob("*.py"):
        for name in _imports(path):
            assert name.split(".")[0] not in {"pydrake", "rerun"}, f"{path.name} imports {name}"
            upper = {
                f"geort_drake.{r}"
                for r in ("hands", "systems", "simulation", "rerun", "comparison", "benchmark", "live")
            }
            assert not any(name.startswith(u) for u in upper), f"{path.name} imports {name}"


def test_live_use_stands_on_the_simulation_and_nothing_stands_on_it():
    """Who does not drive a robot loads nothing of it; pyzmq, an extra, is imported where it is used."""
    for path in PACKAGE.rglob("*.py"):
        names = _imports(path)
        live = path.is_relative_to(PACKAGE / "live")
        forbidden = "geort_drake.benchmark" if live else "geort_drake.live"
        assert not any(name.startswith(forbidden) for name in names), f"{path} imports {forbidden}"
        assert "zmq" not in names, path


def test_only_the_bridge_imports_rerun():
    """Rerun's names change with its versions, so they stay in one place."""
    for path in set(PACKAGE.rglob("*.py")) - set((PACKAGE / "rerun").glob("*.py")):
        assert not any(name.split(".")[0] == "rerun" for name in _imports(path)), path


@pytest.mark.parametrize(
    "module",
    ["geort_drake", "geort_drake.retargeting.retargeter", "geort_drake.retargeting.methods.online"],
)
def test_what_runs_on_the_robot_loads_no_heavy_package(module):
    """A retargeter in production needs NumPy and nothing of training or simulation."""
    code = (
        f"import sys, {module}; "
        "print([n for n in ('torch', 'pydrake', 'rerun', 'matplotlib') if n in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_schema_modules_do_not_postpone_annotations():
    """Drake's YAML loader reads the types, which a future import would turn into strings."""
    for name in (
        "simulation/scenario.py",
        "simulation/operators/config.py",
        "systems/action_correction.py",
        "simulation/tasks/grasp/monitor.py",
        "systems/wrist_to_arm.py",
        "hands/description.py",
    ):
        assert "__future__" not in _imports(PACKAGE / name), name


def test_every_public_name_imports_and_a_wrong_one_does_not():
    """The package's lazy names stand for what their modules define."""
    import geort_drake

    for name in geort_drake.__all__:
        assert getattr(geort_drake, name).__name__ == name
    assert set(geort_drake.__all__) <= set(dir(geort_drake))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        geort_drake.nothing  # noqa: B018

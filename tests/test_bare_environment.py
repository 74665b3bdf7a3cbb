"""A robot's computer: shipped maps run with NumPy and safetensors alone."""

import importlib.util
import subprocess
import venv
from pathlib import Path

import numpy as np
import pytest

from geort_drake.console import exit_code_of
from geort_drake.resources import models_dir

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = """
import sys
import numpy as np
from geort_drake import load_retargeter

p_HK = np.load("hand.npy")
retarget = load_retargeter(sys.argv[1]).for_person(p_HK)
assert retarget.robot_hands == (sys.argv[1],)
q = retarget(p_HK[0])
assert q.shape == (len(retarget.joint_names),) and np.isfinite(q).all()
assert sorted(retarget.motor_columns) == list(range(len(q)))
assert (retarget.lower <= q).all() and (q <= retarget.upper).all()
assert np.isfinite(retarget.jacobian(p_HK[0])).all()
assert not {"pydrake", "torch", "scipy", "rerun", "rich"} & set(sys.modules)
"""


@pytest.fixture(scope="module")
def bare_python(tmp_path_factory) -> Path:
    """The interpreter of an environment that contains only NumPy, safetensors and this package."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder, with_pip=False, symlinks=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    for name in ("numpy", "safetensors"):
        spec = importlib.util.find_spec(name)
        assert spec is not None and spec.origin is not None
        source = Path(spec.origin).parent
        (packages / name).symlink_to(source)
        libraries = source.with_name(f"{name}.libs")  # where wheels for Linux keep what they link
        if libraries.is_dir():
            (packages / libraries.name).symlink_to(libraries)
    (packages / "geort_drake").symlink_to(ROOT / "geort_drake")
    return folder / "bin" / "python"


@pytest.mark.parametrize("name", sorted(path.stem for path in (models_dir() / "maps").glob("*.safetensors")))
def test_a_shipped_map_runs_with_numpy_and_safetensors_alone(name, bare_python, play, tmp_path):
    np.save(tmp_path / "hand.npy", play.p_HK[:60])
    subprocess.run([bare_python, "-c", PROGRAM, name], cwd=tmp_path, check=True, env={})


@pytest.mark.parametrize("words", [["--help"], ["grasp"], ["recording", "check", "hand.npz"]])
def test_a_command_without_its_packages_says_what_to_install(words, bare_python):
    program = "import sys; from geort_drake.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [bare_python, "-c", program, *words]
    done = subprocess.run(command, check=False, env={}, capture_output=True, text=True)
    assert done.returncode == 2
    assert "is not installed" in done.stderr and "pip install geort-drake" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("package", "remedy"), [("torch", "geort-drake[train]"), ("zmq", "geort-drake[live]")]
)
def test_a_missing_package_is_named_with_the_extra_that_brings_it(package, remedy, capsys):
    def command():
        raise ModuleNotFoundError(f"No module named '{package}'", name=package)

    assert exit_code_of(command) == 2
    assert f"pip install '{remedy}'" in capsys.readouterr().err


def test_an_import_that_fails_for_another_reason_is_not_hidden():
    def command():
        raise ModuleNotFoundError("No module named 'geort_drake.nothing'", name="geort_drake.nothing")

    with pytest.raises(ModuleNotFoundError):
        exit_code_of(command)

"""Commands and other programs as modules, for tests that call them in their own process."""

import functools
import importlib.util
import re
from pathlib import Path
from types import ModuleType

from geort_drake.cli import load_command, run_command

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


def load_script(name: str) -> ModuleType:
    """The command behind scripts/`name` with a `main(argv)`; of another program its module, loaded anew."""
    path = SCRIPTS / name
    if path.is_file():
        (command,) = re.findall(r'main\(\["([\w-]+)"', path.read_text("utf-8")) or [None]
        if command is not None:
            module = load_command(command)
            module.main = functools.partial(run_command, command)
            return module
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

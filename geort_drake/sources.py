"""The source files of this package that given modules import."""

import ast
import inspect
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parent


def imported_sources(
    entries: Iterable[str | Path], rooms: Collection[str], left_out: Iterable[str | Path] = ()
) -> list[Path]:
    """The files `entries` and all that they import from these folders, also inside functions.

    Args:
        entries: files, absolute or relative to the package, such as "hands/model.py".
        rooms: folders of the package, such as "hands".
        left_out: files that are neither listed nor followed.
    """
    found = {PACKAGE / path for path in left_out}
    result: set[Path] = set()
    pending = [PACKAGE / entry for entry in entries]
    while pending:
        path = pending.pop()
        if path not in found:
            found.add(path)
            result.add(path)
            imported = _imports(ast.parse(path.read_bytes()).body)
            pending += [path for path in imported if path.relative_to(PACKAGE).parts[0] in rooms]
    return sorted(result)


def source_of(thing: Any) -> Path:
    """The file that defines a function or class."""
    return Path(inspect.getfile(thing)).resolve()


def _imports(nodes: Iterable[ast.AST]) -> Iterator[Path]:
    for node in nodes:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            # An imported name may be a module or be in one.
            names = [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            package, *inner = name.split(".")
            if package == PACKAGE.name and inner:
                module = PACKAGE.joinpath(*inner)
                files = (module.with_suffix(".py"), module / "__init__.py")
                yield from (path for path in files if path.is_file())
        # Expressions contain no imports.
        yield from _imports(child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.expr))

"""The source files of the package that given modules import; no tests."""

import ast
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import geort_drake

PACKAGE = Path(geort_drake.__file__).resolve().parent


def imported_sources(entries: Iterable[Path], rooms: Collection[str]) -> list[Path]:
    """The files `entries` and all that they import from these folders of the package, also in functions."""
    result: set[Path] = set()
    pending = [*entries]
    while pending:
        path = pending.pop()
        if path not in result:
            result.add(path)
            imported = _imports(ast.parse(path.read_bytes()).body)
            pending += [path for path in imported if path.relative_to(PACKAGE).parts[0] in rooms]
    return sorted(result)


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

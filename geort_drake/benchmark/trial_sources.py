"""The code that a trial runs through, and its digest."""

import ast
import functools
from collections.abc import Iterable, Iterator
from pathlib import Path

import geort_drake
from geort_drake.files import digest_of

_PACKAGE = Path(geort_drake.__file__).parent
# What a worker loads, and what makes the retargeters of a benchmark.
_ENTRIES = (
    "benchmark/trial.py",
    "people/human_hand.py",
    "hands/canonical.py",
    "retargeting/methods/registry.py",
    "retargeting/retargeter.py",
)
# Learned weights have a digest of their own, so training does not count; nor do reports and what is drawn.
_ROOMS = ("people", "hands", "retargeting", "simulation", "systems")


@functools.cache
def code_digest() -> str:
    """SHA-256 of the trials' code, as it was on the disk when this process first asked."""
    return digest_of(_PACKAGE, trial_sources())


def trial_sources() -> list[Path]:
    """The modules that a trial can run through: all that is imported, at once or later, from `_ENTRIES`."""
    found: set[Path] = set()
    left = [_PACKAGE / entry for entry in _ENTRIES]
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += _imported(ast.parse(path.read_bytes()).body)
    return sorted(path for path in found if path.relative_to(_PACKAGE).parts[0] in _ROOMS)


def _imported(nodes: Iterable[ast.AST]) -> Iterator[Path]:
    for node in nodes:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            # What is imported may be a module, or be in one.
            names = [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            package, *inner = name.split(".")
            path = _PACKAGE.joinpath(*inner).with_suffix(".py")
            if package == _PACKAGE.name and inner and path.is_file():
                yield path
        yield from _imported(ast.iter_child_nodes(node))

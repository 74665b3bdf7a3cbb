"""The ranges of the dependencies and the files of their two ends say the same."""

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
# They judge the sources or build the site.
TOOLS = {"build", "mypy", "ruff", "twine", "mkdocs", "mkdocs-material", "mkdocstrings", "latex2mathml"}


def ranges() -> dict[str, Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = [text for extra in project["optional-dependencies"].values() for text in extra]
    wanted = [Requirement(text) for text in project["dependencies"] + extras]
    return {canonicalize_name(item.name): item for item in wanted if item.name != project["name"]}


def pins(file: str) -> dict[str, Version]:
    lines = (ROOT / file).read_text("utf-8").splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): Version(version) for name, version in pairs}


def test_the_oldest_versions_are_the_lower_bounds():
    """Each dependency has one, and it is what `make test-lowest` installs."""
    bounds = {
        name: next(Version(part.version) for part in item.specifier if part.operator == ">=")
        for name, item in ranges().items()
        if name not in TOOLS
    }
    assert pins("constraints-lowest.txt") == bounds


@pytest.mark.parametrize("name", ranges())
def test_the_newest_version_is_within_the_range(name):
    """Each dependency has one, and it is what `make test` installs."""
    assert pins("constraints.txt")[name] in ranges()[name].specifier

"""Finds the model of a hand: in this package, in a folder of the user's, or in an installed package."""

import importlib.util
import os
import warnings
from collections.abc import Iterator
from pathlib import Path

from geort_drake.errors import HandError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.model_files import digest_of_contents, included_files
from geort_drake.resources import PACKAGE_NAME, cache_dir, resolve_uri

# Folders with models of other makers, separated as in PATH.
MODEL_FOLDERS = "GEORT_DRAKE_MODELS"
_SCHEME = "package://"


def find_model(description: HandDescription) -> Path:
    """Returns the file of a hand's model, which Drake or MuJoCo can read.

    `package://NAME/FILE` is the file NAME/FILE or FILE in a folder of the environment variable
    `MODEL_FOLDERS`, else FILE in the installed Python package NAME; for `mujoco_menagerie`, in its cache.
    Meshes that Drake cannot read are replaced by convex hulls in a copy, which the user's cache keeps.

    Raises:
        HandError: the model is missing; the message says how to get it.
    """
    path = _original(description)
    if not description.source.get:
        return path
    from geort_drake.hands.importers.conversion import convert_model, unreadable_meshes

    if not unreadable_meshes(path):
        return path
    folder = cache_dir() / "models" / f"{description.name}-{_digest(path):.12}"
    if not (folder / path.name).is_file():
        folder.parent.mkdir(parents=True, exist_ok=True)
        convert_model(path, folder)
    return folder / path.name


def has_published_model(description: HandDescription) -> bool:
    """Whether the model that is found is the published one, by its digest; warns if it is another.

    Raises:
        HandError: the model is missing.
    """
    expected = description.source.sha256
    if not expected:
        return False
    path = _original(description)
    digest = _digest(path)
    if digest != expected:
        warnings.warn(
            f"hand '{description.name}': {path} differs from {description.source.published}, for which the "
            f"description was written: its digest is {digest:.12}, not {expected:.12}",
            RuntimeWarning,
            stacklevel=3,
        )
    return digest == expected


def _original(description: HandDescription) -> Path:
    places = [description.model, *description.source.also]
    for path in (path for place in places for path in _candidates(place)):
        if os.path.isfile(path):  # unlike Path.is_file, False for a name that is too long
            return path
    name, source = description.name, description.source
    if not source.get:
        raise HandError(f"hand '{name}': the model file {resolve_uri(description.model)} is missing")
    raise HandError(
        f"hand '{name}': its model, {source.published}, is not on this computer; get it by `{source.get}`, "
        f"and if that installs nothing, name its folder in the environment variable {MODEL_FOLDERS}"
    )


def _digest(path: Path) -> str:
    """Computes the SHA-256 of a model's file and the files that it includes, without meshes."""
    return digest_of_contents([path, *included_files(path)])


def _candidates(place: str) -> Iterator[Path]:
    if not place.startswith(_SCHEME) or place.startswith(f"{_SCHEME}{PACKAGE_NAME}/"):
        yield resolve_uri(place)
        return
    package, _, file = place.removeprefix(_SCHEME).partition("/")
    for folder in filter(None, os.environ.get(MODEL_FOLDERS, "").split(os.pathsep)):
        for name in (package, package.replace("_", "-"), "."):
            yield Path(folder) / name / file
    spec = importlib.util.find_spec(package) if package.isidentifier() else None
    if spec is None:
        return
    for folder in spec.submodule_search_locations or ():
        yield Path(folder) / file
    if package == "mujoco_menagerie":
        yield from _in_menagerie(file)


def _in_menagerie(file: str) -> Iterator[Path]:
    """Yields a file of MuJoCo Menagerie, if its package has downloaded the robot."""
    import mujoco_menagerie

    robot, _, name = file.partition("/")
    entry, cache = mujoco_menagerie.get(robot), mujoco_menagerie.Cache()
    if cache.is_cached(entry):
        yield cache.model_path(entry) / name

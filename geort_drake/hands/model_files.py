"""Reads the files of a hand's model: its XML, meshes, includes and couplings; and checks its values."""

import hashlib
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydrake.geometry import Convex, Mesh, Shape

from geort_drake.errors import HandError
from geort_drake.files import sha256_of
from geort_drake.hands.description import CouplingDescription

_PRODUCTS_OF_INERTIA = ("ixy", "ixz", "iyz")
_INERTIA = ("mass", "ixx", "iyy", "izz", *_PRODUCTS_OF_INERTIA)


def read_model(path: Path) -> ET.Element:
    """Reads the XML of a URDF, SDF or MJCF file; that of MJCF is only for telling what it is.

    Raises:
        HandError: the file is missing or not XML, has macros, or is only a part of an MJCF model.
    """
    if not path.is_file():
        raise HandError(f"the model file {path} is missing")
    text = path.read_text(encoding="utf-8", errors="replace")
    if "<drake:" in text and "xmlns:drake" not in text:  # an undeclared prefix, which Drake accepts
        text = text.replace("<drake:mimic", "<mimic").replace("</drake:mimic", "</mimic")
        text = text.replace("<drake:", "<drake_").replace("</drake:", "</drake_")
    try:
        tree = ET.fromstring(text)
    except ET.ParseError as error:
        raise HandError(f"{path}: not XML: {error}; expected a URDF, SDF or MJCF file") from error
    if any("xacro" in element.tag for element in tree.iter()):
        raise HandError(f"{path} contains macros; expand them first: xacro {path.name} > hand.urdf")
    if tree.tag == "mujocoinclude":
        raise HandError(f"{path} is a part of an MJCF model; give the file that includes it")
    return tree


def mesh_elements(model: Path, tree: ET.Element) -> list[tuple[ET.Element, Path]]:
    """Returns the elements of a URDF or SDF model that name a mesh file, with these files."""
    named = [(mesh, mesh.get("filename")) for mesh in tree.iter("mesh")]
    named += [(uri, (uri.text or "").strip()) for uri in tree.iterfind(".//mesh/uri")]
    drakes = re.compile("(package|model)://drake(_models)?/")
    return [(e, resolve_reference(model, name)) for e, name in named if name and not drakes.match(name)]


def resolve_reference(model: Path, name: str) -> Path:
    """Returns the file that a model names, relative to it or in a package."""
    package = re.match(r"(?:package|model)://([^/]+)(?:/(.*))?$", name)
    if package is None:
        return (model.resolve().parent / name.removeprefix("file://")).resolve()
    return (find_package(model, package[1]) / (package[2] or "")).resolve()


def find_package(model: Path, name: str) -> Path:
    """Returns the folder of a package that a model names.

    As in ROS, it is a folder above the model whose `package.xml` has that name; else a folder above it, or
    beside one of these, that is called so.

    Raises:
        HandError: there is no such folder.
    """
    folders = [*model.resolve().parents]
    for folder in folders:
        if _package_name(folder / "package.xml") == name:
            return folder
    for folder in folders:
        if folder.name == name:
            return folder
        if (folder / name).is_dir():
            return folder / name
    raise HandError(
        f"model {model}: the package '{name}' is in no folder above the model; the package's folder needs a "
        f"package.xml with <name>{name}</name>, or this name itself"
    )


def _package_name(file: Path) -> str | None:
    """Returns the name in a ROS package's `package.xml`; None if there is no such file, or it is not XML."""
    try:
        name = ET.parse(file).getroot().findtext("name")
    except (OSError, ET.ParseError, ValueError):  # ValueError for an unknown encoding
        return None
    return (name or "").strip()


def model_files(model: Path, shapes: Iterable[Shape]) -> list[Path]:
    """Returns a hand's model file, the files that it includes, and the meshes of its collision geometry.

    Of an MJCF model, the meshes of its visual geometry as well.

    Args:
        model: SDF, URDF or MJCF file of the hand.
        shapes: shapes of the hand's collision geometry.
    """
    if read_model(model).tag == "mujoco":
        from geort_drake.hands.mjcf import compile_mjcf

        meshes = compile_mjcf(model)[1]
    else:
        sources = [shape.source() for shape in shapes if isinstance(shape, Convex | Mesh)]
        meshes = [Path(source.path()) for source in sources if source.is_path()]
    return list(dict.fromkeys([model, *included_files(model), *meshes]))


def digest_of_contents(files: Iterable[Path]) -> str:
    """Computes the hexadecimal SHA-256 of a file, or of several files' digests in order; ignores names."""
    digests = [sha256_of(file) for file in files]
    return digests[0] if len(digests) == 1 else hashlib.sha256("\n".join(digests).encode()).hexdigest()


def included_files(model: Path, main: Path | None = None) -> list[Path]:
    """Finds the files that an SDF or MJCF file includes, recursively, in order.

    Args:
        model: the file.
        main: the outermost file, whose inclusion led to `model`; None for `model` itself.
    """
    main = main or model
    text = model.read_text(encoding="utf-8", errors="replace")
    names = re.findall(r"<include\s[^>]*?file\s*=\s*[\"']([^\"']+)", text)
    names += re.findall(r"<include\b[^/]*?>.*?<uri>\s*(.*?)\s*</uri>", text, flags=re.DOTALL)
    files: list[Path] = []
    for name in names:
        # As in MuJoCo, a name is first relative to the outermost file.
        file = next((f for f in (resolve_reference(m, name) for m in (main, model)) if f.exists()), None)
        file = file / "model.sdf" if file is not None and file.is_dir() else file
        if file is not None and file.is_file():
            files += [file, *included_files(file, main)]
    return files


def check_values(tree: ET.Element) -> None:
    """Rejects what Drake would replace silently, or refuse without naming the place.

    Args:
        tree: the XML of a URDF or SDF file.

    Raises:
        HandError: two links or two joints have one name; limits are swapped; a joint follows another by a
            factor of 0; a velocity limit of URDF, a mass or a moment of inertia is negative, or one of the
            inertias not finite.
    """
    for model in [tree, *tree.iter("model")]:
        for kind in ("link", "joint"):
            names = Counter(element.get("name", "") for element in model.findall(kind))
            for name, count in names.items():
                if count > 1:
                    raise HandError(f"{count} {kind}s are called '{name}'; each needs its own name")
        for link in model.findall("link"):
            _check_inertia(link)
        for joint in model.findall("joint"):
            where = f"joint '{joint.get('name', '')}'"
            for limit in joint.iter("limit"):
                low, high = (_number(limit, end, 0.0, where) for end in ("lower", "upper"))
                if low > high:
                    raise HandError(
                        f"{where} has its limits swapped: lower {low:g} is above upper {high:g} rad"
                    )
                # In SDF, a negative limit means that there is none.
                if limit.get("velocity") and (speed := _number(limit, "velocity", 0.0, where)) < 0:
                    raise HandError(f"{where} has the negative velocity limit {speed:g} rad/s")
            for mimic in _mimics(joint):
                if _number(mimic, "multiplier", 1.0, where) == 0:
                    raise HandError(
                        f"{where} follows '{mimic.get('joint')}' by a multiplier of 0, so it never moves: "
                        "make it a fixed joint"
                    )


def _check_inertia(link: ET.Element) -> None:
    """Checks the inertia of a link; its numbers are attributes in URDF and texts in SDF."""
    where = f"link '{link.get('name', '')}'"
    for element in link.iterfind("inertial//*"):
        for name, text in {**element.attrib, element.tag: element.get("value") or element.text}.items():
            if name not in _INERTIA:
                continue
            expected = "finite" if name in _PRODUCTS_OF_INERTIA else "finite and not negative"
            try:
                value = float(text or "nan")
            except ValueError:
                value = np.nan
            if not np.isfinite(value) or (value < 0 and name not in _PRODUCTS_OF_INERTIA):
                raise HandError(f"{where}: {name} must be {expected}; given: {text}")


def read_couplings(path: Path) -> tuple[list[CouplingDescription], list[str]]:
    """Reads a model's linear couplings; returns them, and notes on guesses and omissions.

    Drake applies URDF's `mimic` and SDF's `drake:mimic` without giving access to them. For MJCF, see
    `read_mjcf_couplings`.

    Raises:
        HandError: the file is not XML, a number is malformed, or a coupling is not linear.
    """
    tree = read_model(path)
    if tree.tag == "mujoco":
        from geort_drake.hands.mjcf import read_mjcf_couplings

        return read_mjcf_couplings(path)
    couplings = []
    for joint in tree.iter("joint"):
        for mimic in _mimics(joint):
            where = f"{path}: joint '{joint.get('name', '')}'"
            ratio = _number(mimic, "multiplier", 1.0, where)
            offset = _number(mimic, "offset", 0.0, where) - ratio * _number(mimic, "reference", 0.0, where)
            leader = mimic.get("joint", "")
            couplings.append(CouplingDescription(joint.get("name", ""), leader, ratio, offset))
    return couplings, []


def _mimics(joint: ET.Element) -> list[ET.Element]:
    return [element for element in joint.iter() if re.fullmatch(r"(\{.*\})?mimic", element.tag)]


def _number(element: ET.Element, name: str, default: float, where: str) -> float:
    """Returns a number from an attribute (URDF) or an inner element (SDF)."""
    text = element.get(name) or element.findtext(name) or str(default)
    try:
        return float(text)
    except ValueError as error:
        raise HandError(f"{where}: {name} must be a number; given: {text}") from error

"""Reads the files of a hand's model, finds its meshes and includes, and checks their values."""

import hashlib
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

from pydrake.geometry import Convex, Mesh, SceneGraphInspector
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.errors import HandError
from geort_drake.files import sha256_of
from geort_drake.hands.mjcf import rewrite_for_drake

_PRODUCTS_OF_INERTIA = ("ixy", "ixz", "iyz")
_INERTIA = ("mass", "ixx", "iyy", "izz", *_PRODUCTS_OF_INERTIA)
# A vertex line of an OBJ file that does not begin with three finite numbers.
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE](?:-\d+|\+?0*\d{1,2}))?"
_BAD_VERTEX = re.compile(
    rb"^[ \t]*v[ \t](?![ \t]*" + rb"[ \t]+".join([_NUMBER] * 3) + rb"(?:\s|#|$)).*", re.M
)


def read_model(path: Path) -> ET.Element:
    """Reads the XML of a URDF, SDF or MJCF file.

    MJCF is returned with its includes, absolute mesh paths and the changes of `rewrite_for_drake`.

    Raises:
        HandError: the file or an included one is missing or not XML; or it has macros, or
            is only a part of an MJCF model.
    """
    tree = _parsed(path, path)
    if tree.tag == "mujocoinclude":
        raise HandError(f"{path} is a part of an MJCF model; give the file that includes it")
    if tree.tag == "mujoco":
        tree.set("model", tree.get("model") or path.stem)  # Drake requires a name
        for element, mesh in mesh_elements(path, tree):
            set_mesh(element, mesh)
        rewrite_for_drake(tree)
    return tree


def _parsed(path: Path, main: Path) -> ET.Element:
    """Parses the XML of a file, and of those that MJCF includes; `main` is the outermost file."""
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
    if tree.tag.startswith("mujoco"):
        for parent in list(tree.iter()):
            for include in parent.findall("include"):
                place = list(parent).index(include)
                file = _included(include.get("file", ""), path, main)
                if not file.is_file():
                    raise HandError(f"{path} includes {file}, which is missing")
                parent[place : place + 1] = list(_parsed(file, main))
    return tree


def _included(name: str, path: Path, main: Path) -> Path:
    """Returns a file that `path` includes; as in MuJoCo, its name is first relative to the outermost file."""
    file = resolve_reference(main, name)
    return file if file.exists() else resolve_reference(path, name)


def mesh_elements(model: Path, tree: ET.Element) -> list[tuple[ET.Element, Path]]:
    """Returns the elements of a model that name a mesh file, with these files."""
    if tree.tag == "mujoco":
        folder = model.resolve().parent
        folders = [compiler.get("meshdir") or compiler.get("assetdir") for compiler in tree.iter("compiler")]
        folder /= next(filter(None, reversed(folders)), "")  # the last one counts
        meshes = [(mesh, mesh.get("file")) for mesh in tree.iterfind(".//asset/mesh")]
        return [(mesh, (folder / name).resolve()) for mesh, name in meshes if name]
    named = [(mesh, mesh.get("filename")) for mesh in tree.iter("mesh")]
    named += [(uri, (uri.text or "").strip()) for uri in tree.iterfind(".//mesh/uri")]
    return [(element, resolve_reference(model, name)) for element, name in named if name]


def set_mesh(element: ET.Element, mesh: Path) -> None:
    """Sets the mesh file that an element of a model names, absolute or relative to the model."""
    name = f"file://{mesh}" if mesh.is_absolute() else str(mesh)
    if element.tag == "uri":
        element.text = name
    elif "filename" in element.attrib:
        element.set("filename", name)
    else:
        # In MJCF, the default name of a mesh is the stem of its file.
        element.set("name", element.get("name") or Path(element.get("file", "")).stem)
        element.set("file", str(mesh))


def resolve_reference(model: Path, name: str) -> Path:
    """Returns the file that a model names, relative to it or in a package in one of the folders above."""
    folder = model.resolve().parent
    package = re.match(r"(?:package|model)://([^/]+)(?:/(.*))?$", name)
    if package:
        for parent in (folder, *folder.parents):
            root = parent if parent.name == package[1] else parent / package[1]
            if root.is_dir():
                return (root / (package[2] or "")).resolve()
        name = "/".join(part for part in package.groups() if part)  # where users may put it
    return (folder / name.removeprefix("file://")).resolve()


def model_files(
    plant: MultibodyPlant, inspector: SceneGraphInspector | None, hand: ModelInstanceIndex, model: Path
) -> list[Path]:
    """Returns a hand's model file, the files that it includes, and the meshes of its collision geometry.

    Args:
        plant: plant with the hand.
        inspector: inspector of the plant's scene graph; None for a plant without one, which gives no meshes.
        hand: model instance of the hand.
        model: SDF, URDF or MJCF file of the hand.
    """
    shapes = []
    if inspector is not None:
        bodies = [plant.get_body(index) for index in plant.GetBodyIndices(hand)]
        geometries = [id for body in bodies for id in plant.GetCollisionGeometriesForBody(body)]
        shapes = [inspector.GetShape(id) for id in geometries]
    sources = [shape.source() for shape in shapes if isinstance(shape, Convex | Mesh)]
    meshes = [Path(source.path()) for source in sources if source.is_path()]
    return list(dict.fromkeys([model, *_included_files(model, model), *meshes]))


def digest_of_contents(files: Iterable[Path]) -> str:
    """Computes the hexadecimal SHA-256 of a file, or of several files' digests in order; ignores names."""
    digests = [sha256_of(file) for file in files]
    return digests[0] if len(digests) == 1 else hashlib.sha256("\n".join(digests).encode()).hexdigest()


def _included_files(model: Path, main: Path) -> list[Path]:
    """Finds the files that an SDF or MJCF file includes, recursively, in order; `main` is the outermost."""
    text = model.read_text(encoding="utf-8", errors="replace")
    names = re.findall(r"<include\s[^>]*?file\s*=\s*[\"']([^\"']+)", text)
    names += re.findall(r"<include\b[^/]*?>.*?<uri>\s*(.*?)\s*</uri>", text, flags=re.DOTALL)
    found: list[Path] = []
    for name in names:
        file = _included(name, model, main)
        file = file / "model.sdf" if file.is_dir() else file
        if file.is_file():
            found += [file, *_included_files(file, main)]
    return found


def check_model_values(files: Iterable[Path], source: str) -> None:
    """Rejects values that Drake would replace silently or with a warning.

    Args:
        files: files from `model_files`; only URDF, SDF and OBJ files are checked.
        source: beginning of error messages.

    Raises:
        HandError: a mass or moment of inertia is negative or not finite, or a product of inertia or a vertex
            is not finite.
    """
    for file in files:
        if file.suffix.lower() in (".sdf", ".urdf"):
            for link in read_model(file).iter("link"):
                _check_inertia(link, f"of link '{link.get('name', '')}' in {file.name}", source)
        elif file.suffix.lower() == ".obj" and (found := _BAD_VERTEX.search(file.read_bytes())):
            line = found[0].decode(errors="replace").strip()
            raise HandError(
                f"{source}: {file}: every vertex must be three finite numbers; given: {line[:60]}"
            )


def _check_inertia(link: ET.Element, where: str, source: str) -> None:
    """Checks the inertia of a link; its numbers are attributes in URDF and texts in SDF."""
    for element in link.iterfind("inertial//*"):
        for name, text in {**element.attrib, element.tag: element.get("value") or element.text}.items():
            if name not in _INERTIA:
                continue
            expected = "finite" if name in _PRODUCTS_OF_INERTIA else "finite and not negative"
            try:
                value = float(text or "nan")
            except ValueError:
                value = math.nan
            if not math.isfinite(value) or (value < 0 and name not in _PRODUCTS_OF_INERTIA):
                raise HandError(f"{source}: {name} {where} must be {expected}; given: {text}")

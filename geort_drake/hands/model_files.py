"""The files that decide how a hand moves and what it touches."""

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

from pydrake.geometry import Convex, Mesh, SceneGraphInspector
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.files import sha256_of
from geort_drake.hands.meshes import resolved


def model_files(
    plant: MultibodyPlant, inspector: SceneGraphInspector | None, hand: ModelInstanceIndex, model: Path
) -> list[Path]:
    """A hand's model file, what that includes, and the meshes of its collision geometry as Drake found them.

    Args:
        inspector: of the plant's scene graph; None without one, and then without the meshes.
        hand: the model instance of the hand in `plant`.
        model: its SDF, URDF or MJCF file.
    """
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(hand)]
    geometries = [id for body in bodies for id in plant.GetCollisionGeometriesForBody(body)]
    shapes = [inspector.GetShape(id) for id in geometries] if inspector is not None else []
    sources = [shape.source() for shape in shapes if isinstance(shape, Convex | Mesh)]
    meshes = [Path(source.path()) for source in sources if source.is_path()]
    return list(dict.fromkeys([model, *_included(model), *meshes]))


def digest_of_contents(files: Iterable[Path]) -> str:
    """Hexadecimal SHA-256 of a file, or of the digests of several in their order; names do not count."""
    digests = [sha256_of(file) for file in files]
    return digests[0] if len(digests) == 1 else hashlib.sha256("\n".join(digests).encode()).hexdigest()


def _included(model: Path) -> list[Path]:
    """What SDF and MJCF files include, and what that does, in order; a folder's model.sdf for the folder."""
    text = model.read_text(encoding="utf-8", errors="replace")
    names = re.findall(r"<include\s[^>]*?file\s*=\s*[\"']([^\"']+)", text)
    names += re.findall(r"<include\b[^/]*?>.*?<uri>\s*(.*?)\s*</uri>", text, flags=re.DOTALL)
    found: list[Path] = []
    for name in names:
        file = resolved(model, name)
        file = file / "model.sdf" if file.is_dir() else file
        if file.is_file():
            found += [file, *_included(file)]
    return found

"""OBJ files with the colours of their material libraries, which Drake's own reader leaves out."""

import io
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image, UnidentifiedImageError


@dataclass(frozen=True)
class Painted:
    """Triangles of a file, in its own coordinates, and how they look.

    Attributes:
        triangles: (n, 3, 3) corners.
        colors: (n, 4) red, green, blue, opacity, 0–255.
        picture: (h, w, 3), which the colours are multiplied with; None where there is none.
        places: (n, 3, 2) where in the picture the corners are, from its top left, in shares of it.
    """

    triangles: np.ndarray
    colors: np.ndarray
    picture: np.ndarray | None = None
    places: np.ndarray | None = None


@dataclass
class _Material:
    color: list[float]
    opacity: float = 1.0
    file: str | None = None


def read_painted(contents: bytes, read: Callable[[str], bytes], color: list[int]) -> Painted | None:
    """Reads an OBJ file; None where it has no material library.

    A picture (`map_Kd`) is kept where it is the only one; of several, each gives its mean colour.

    Args:
        read: contents of a file beside it, by name.
        color: red, green, blue, opacity, 0–255, of what has no material.

    Raises:
        OSError, ValueError: a file that it names is missing, or is malformed.
    """
    lines = [line.split() for line in contents.decode(errors="replace").replace("\\\n", " ").splitlines()]
    libraries = [word for words in lines if words[:1] == ["mtllib"] for word in words[1:]]
    if not libraries:
        return None
    materials: dict[str, _Material] = {}
    for library in libraries:
        materials |= _materials(read(library).decode(errors="replace"))
    points, places, corners, used = [], [], [], []
    name = ""
    try:
        for words in lines:
            match words[:1]:
                case ["v"]:
                    points.append([float(word) for word in words[1:4]])
                case ["vt"]:
                    places.append([float(word) for word in words[1:3]])
                case ["usemtl"]:
                    name = " ".join(words[1:])
                case ["f"]:
                    ring = [_corner(word, len(points), len(places)) for word in words[1:]]
                    corners += [[ring[0], a, b] for a, b in itertools.pairwise(ring[1:])]
                    used += [name] * (len(ring) - 2)
        numbers = np.array(corners, dtype=int).reshape(-1, 3, 2)
        triangles = np.array(points)[numbers[..., 0]]
    except (ValueError, IndexError) as error:
        raise ValueError(f"malformed: {error}") from error
    pictures = {one: _picture(read, m.file) for one, m in materials.items() if m.file and one in used}
    colors = {"": color} | {one: _color(material, pictures.get(one)) for one, material in materials.items()}
    # One picture suits all triangles only if each of them has its places in it.
    if len(set(used)) == 1 and pictures and (numbers[..., 1] >= 0).all():
        ((one, picture),) = pictures.items()
        white = np.full((len(used), 4), 255)
        white[:, 3] = colors[one][3]
        return Painted(triangles, white, picture, np.array(places)[numbers[..., 1]] * [1, -1] + [0, 1])
    return Painted(triangles, np.array([colors.get(one, color) for one in used]))


def _corner(word: str, points: int, places: int) -> list[int]:
    """Numbers of point and place, from 0; -1 for no place. In the file negative ones count from the end."""
    point, place, *_ = [*word.split("/"), "0"]
    return [_from_zero(int(point), points), _from_zero(int(place or 0), places)]


def _from_zero(number: int, count: int) -> int:
    return number - 1 if number >= 0 else count + number


def _materials(text: str) -> dict[str, _Material]:
    found: dict[str, _Material] = {}
    material = _Material([])
    for words in map(str.split, text.splitlines()):
        match words[:1]:
            case ["newmtl"]:
                material = found[" ".join(words[1:])] = _Material([0.8, 0.8, 0.8])
            case ["Kd"]:
                material.color = [float(word) for word in words[1:4]]
            case ["d"]:
                material.opacity = float(words[-1])
            case ["Tr"]:
                material.opacity = 1.0 - float(words[-1])
            case ["map_Kd"]:
                material.file = words[-1]
    return found


def _picture(read: Callable[[str], bytes], file: str) -> np.ndarray:
    try:
        with Image.open(io.BytesIO(read(file))) as picture:
            return np.asarray(picture.convert("RGB"))
    except UnidentifiedImageError as error:
        raise ValueError(f"{file} is no picture") from error


def _color(material: _Material, picture: np.ndarray | None) -> list[int]:
    rgb = 255 * np.array(material.color) if picture is None else picture.reshape(-1, 3).mean(axis=0)
    return [*np.clip(np.rint(rgb), 0, 255).astype(int).tolist(), round(255 * material.opacity)]

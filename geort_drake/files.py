"""Files that are either whole or absent, and digests that say which contents were used."""

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from geort_drake.errors import OutputError


@contextlib.contextmanager
def atomic_path(target: str | os.PathLike) -> Iterator[Path]:
    """Yields a path beside `target`; what was written there becomes `target` on success.

    On an exception nothing is left behind and an earlier `target` stays as it was.
    """
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    # The target's suffix is kept because writers such as np.savez append their own otherwise.
    handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    os.close(handle)
    draft = Path(name)
    try:
        yield draft
        draft.chmod(0o666 & ~_umask())
        os.replace(draft, target)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def atomic_directory(target: str | os.PathLike) -> Iterator[Path]:
    """Yields a new directory beside `target` that takes its place on success."""
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        yield draft
        draft.chmod(0o777 & ~_umask())
        if target.exists():
            # rename() cannot replace a directory that holds files, so the old one steps aside.
            old = Path(tempfile.mkdtemp(prefix=f".{target.name}-old-", dir=target.parent))
            os.replace(target, old / target.name)
            os.replace(draft, target)
            shutil.rmtree(old)
        else:
            os.replace(draft, target)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def require_writable(target: str | os.PathLike, directory: bool = False) -> None:
    """Checks, before long work, that `target` can be written later; creates nothing.

    Args:
        target: a file, or with `directory` a folder that may exist already.

    Raises:
        OutputError: the nearest existing folder is none, or may not be written to.
    """
    target = Path(target)
    candidates = (target, *target.parents) if directory else target.parents
    nearest = next(path for path in candidates if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise OutputError(f"{target}: {nearest} is not a directory that can be written to")
    if not directory and target.is_dir():
        raise OutputError(f"{target}: is a directory; a file was wanted")


def write_text(target: str | os.PathLike, text: str) -> None:
    """Writes `text` to `target` atomically, as UTF-8."""
    with atomic_path(target) as draft:
        draft.write_text(text, encoding="utf-8")


def sha256_of(path: str | os.PathLike) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_of(root: Path, paths: Iterable[Path]) -> str:
    """Hexadecimal SHA-256 over the names below `root` and the contents of files, and of all files in folders.

    What Python compiles does not count.
    """
    files: set[Path] = set()
    for path in paths:
        files.update([path] if path.is_file() else (p for p in path.rglob("*") if p.is_file()))
    lines = [f"{file.relative_to(root)} {sha256_of(file)}" for file in sorted(files) if file.suffix != ".pyc"]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask

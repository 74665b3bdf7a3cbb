"""Atomic writing of files and folders, and digests of their contents."""

import contextlib
import errno
import fcntl
import hashlib
import math
import os
import shutil
import stat
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from geort_drake.errors import OutputError

# Errors of a full disk or a read-only location.
_UNWRITABLE = {
    errno.EACCES, errno.EDQUOT, errno.EFBIG, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOSPC, errno.ENOTDIR,
    errno.EPERM, errno.EROFS,
}  # fmt: skip


@contextlib.contextmanager
def writing(target: str | os.PathLike) -> Iterator[None]:
    """Turns errors of a full disk or a read-only location into an OutputError that names the target."""
    try:
        yield
    except OSError as error:
        if error.errno not in _UNWRITABLE:  # as that of an OutputError, which has no number
            raise
        raise OutputError(f"{target}: cannot be written: {error.strerror}") from error


@contextlib.contextmanager
def atomic_path(target: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary path in the same folder, which replaces `target` on success.

    On an exception nothing is left behind and an earlier `target` stays. If the process is killed or the
    machine fails, `target` is complete, either old or new; a hidden temporary file may remain. A symbolic
    link stays, and the file to which it points is replaced; the new file has the permissions of the old one.

    Raises:
        OutputError: the disk is full, the location is not writable, or `target` is no file or is
            write-protected.
    """
    original = Path(target)
    with writing(original):
        _require_file(original)
        target = Path(os.path.realpath(original))
        if target.is_symlink():
            raise OutputError(f"{original}: is a link to itself")
        target.parent.mkdir(parents=True, exist_ok=True)
        # With the target's suffix, because writers such as np.savez append theirs otherwise.
        draft = _draft(target, target.suffix)
        try:
            draft.touch()
        except FileNotFoundError as error:  # a folder that takes no files, such as /proc
            raise OutputError(f"{original}: cannot create a file there") from error
        try:
            yield draft
            if target.exists():
                shutil.copymode(target, draft)
            _to_disk(draft)
            os.replace(draft, target)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise


@contextlib.contextmanager
def atomic_directory(target: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary directory, which replaces `target` on success; on an exception, `target` stays.

    A symbolic link stays, and the directory to which it points is replaced; the new directory has the
    permissions of the old one.

    Raises:
        OutputError: the disk is full, the location is not writable, or `target` is no directory.
    """
    target = Path(os.path.realpath(target))
    if target.exists() and not target.is_dir():
        raise OutputError(f"{target}: is a file, not a directory")
    with writing(target):
        draft = _draft(target)
        draft.mkdir(parents=True)
        backup = draft.with_name(f"{draft.name}-old")
        try:
            yield draft
            for path in draft.rglob("*"):
                if path.is_file():
                    _to_disk(path)
            # rename() cannot replace a directory that contains files, so the old one is moved first.
            if target.exists():
                shutil.copymode(target, draft)
                os.replace(target, backup)
            try:
                os.replace(draft, target)
            except BaseException:
                if backup.exists():
                    os.replace(backup, target)
                raise
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise
        if backup.exists():
            shutil.rmtree(backup)


def _draft(target: Path, suffix: str = "") -> Path:
    """Returns a hidden path beside `target` that does not exist."""
    return target.with_name(f".{target.stem}-{uuid.uuid4().hex[:8]}{suffix}")


@contextlib.contextmanager
def locked(folder: str | os.PathLike, wait: bool = False) -> Iterator[None]:
    """Creates a folder if needed, and locks it against other processes for the duration of a block.

    Args:
        wait: whether to wait while another process has locked the folder.

    Raises:
        OutputError: another process has locked the folder, or it cannot be created.
    """
    with writing(folder):
        Path(folder).mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        lock(handle, folder, wait)
        yield
    finally:
        os.close(handle)


def lock(handle: int, path: str | os.PathLike, wait: bool = False) -> None:
    """Locks an open file or folder against other processes until it is closed.

    Raises:
        OutputError: another process has locked it, unless `wait`.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise OutputError(f"{path}: another process is writing to it") from error
    except OSError:
        pass  # some network disks have no locks


def _to_disk(path: Path) -> None:
    """Flushes a file to the disk, so that it is not empty after a power cut."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


def require_writable(target: str | os.PathLike, directory: bool = False) -> None:
    """Checks before long work that `target` can be written; creates nothing.

    Args:
        target: a file, or with `directory` a folder that may exist already.

    Raises:
        OutputError: the nearest existing parent is not a folder or not writable, or `target` is no file or
            is write-protected.
    """
    original = Path(target)  # messages name the path as it was given
    target = Path(os.path.realpath(original)) if original.is_symlink() else original
    if not directory:
        _require_file(original)
    candidates = (target, *target.parents) if directory else target.parents
    nearest = next(path for path in candidates if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        where = "" if nearest == original else f"{nearest} "
        raise OutputError(f"{original}: {where}is not a directory that can be written to")


def _require_file(path: Path) -> None:
    """Refuses what exists and is no file, and a write-protected file, which its folder lets be replaced."""
    if path.is_dir():
        raise OutputError(f"{path}: is a directory, not a file")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: is no regular file, which could be replaced")
    if path.is_file() and not stat.S_IMODE(path.stat().st_mode) & 0o222:
        raise OutputError(f"{path}: is write-protected")


def require_replaceable(target: str | os.PathLike, mark: str) -> None:
    """Checks that `atomic_directory` may write `target`: new, empty, or with the file `mark` of its like.

    Raises:
        OutputError: it is something else, or the current folder, given as ".", or a mount point, which cannot
            be replaced.
    """
    path = Path(target)
    if not path.exists():
        return
    is_movable = path.is_dir() and path.name not in ("", "..") and not path.is_mount()
    if not (is_movable and ((path / mark).is_file() or not any(path.iterdir()))):
        raise OutputError(f"{target} exists and is not an earlier export; choose another name")


def write_text(target: str | os.PathLike, text: str) -> None:
    """Writes `text` to `target` atomically, as UTF-8."""
    with atomic_path(target) as draft:
        draft.write_text(text, encoding="utf-8")


def sha256_of(path: str | os.PathLike) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_of(root: Path, paths: Iterable[Path]) -> str:
    """Hexadecimal SHA-256 of the contents, and names below `root`, of files and of all files in folders.

    Folders named `__pycache__`, in which Python and numba keep compiled code, are skipped.
    """
    files: set[Path] = set()
    for path in paths:
        files.update([path] if path.is_file() else (p for p in path.rglob("*") if p.is_file()))
    lines = [
        f"{file.relative_to(root)} {sha256_of(file)}"
        for file in sorted(files)
        if "__pycache__" not in file.parts
    ]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def source_digest(*subpackages: str) -> str:
    """Hexadecimal SHA-256 of the code of subpackages of geort_drake."""
    package = Path(__file__).resolve().parent
    return digest_of(package, [package / name for name in subpackages])


def finite_json(content: Any) -> Any:
    """Returns a copy with None for numbers that are not finite, which JSON cannot represent."""
    if isinstance(content, dict):
        return {key: finite_json(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite_json(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content

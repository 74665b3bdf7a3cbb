"""Atomic writing of files and folders, and digests of their contents."""

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import math
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from geort_drake.errors import GeortError, OutputError

# Errors of a full disk or a read-only location.
_UNWRITABLE = {
    errno.EACCES, errno.EDQUOT, errno.EFBIG, errno.ENOSPC, errno.ENOTDIR, errno.EPERM, errno.EROFS,
}  # fmt: skip

_LFS_HEADER = b"version https://git-lfs."


def is_lfs_pointer(path: str | os.PathLike) -> bool:
    """Whether a file is the small text that Git LFS leaves in place of contents not yet fetched."""
    with open(path, "rb") as file:
        return file.read(len(_LFS_HEADER)) == _LFS_HEADER


def require_fetched(path: str | os.PathLike, error: type[GeortError]) -> None:
    """Raises `error` if `path` is a Git LFS pointer instead of the file itself."""
    if is_lfs_pointer(path):
        raise error(f"{path}: is a Git LFS pointer, not the file itself; fetch it with `git lfs pull`")


@contextlib.contextmanager
def writing(target: str | os.PathLike) -> Iterator[None]:
    """Turns errors of a full disk or a read-only location into an OutputError that names the target."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        if error.errno not in _UNWRITABLE:
            raise
        raise OutputError(f"{target}: cannot be written: {error.strerror}") from error


@contextlib.contextmanager
def atomic_path(target: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary path in the same folder, which replaces `target` on success.

    On an exception nothing is left behind and an earlier `target` stays. If the process is killed or the
    machine fails, `target` is complete, either old or new; a hidden temporary file may remain.

    Raises:
        OutputError: the disk is full or the location is not writable.
    """
    target = Path(target)
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        # With the target's suffix, because writers such as np.savez append theirs otherwise.
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
        os.close(handle)
        draft = Path(name)
        try:
            yield draft
            draft.chmod(0o666 & ~_umask())
            _to_disk(draft)
            os.replace(draft, target)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise


@contextlib.contextmanager
def atomic_directory(target: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary directory, which replaces `target` on success; see `atomic_path`."""
    target = Path(target)
    if target.is_symlink():
        target = target.resolve()  # the link stays
    if target.exists() and not target.is_dir():
        raise OutputError(f"{target}: is a file, not a directory")
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        try:
            yield draft
            draft.chmod(0o777 & ~_umask())
            for path in draft.rglob("*"):
                if path.is_file():
                    _to_disk(path)
            if target.exists() and _exchange(draft, target):
                shutil.rmtree(draft)
            elif target.exists():
                # rename() cannot replace a directory that contains files, so the old one is moved first.
                old = draft.with_name(f"{draft.name}-old")
                os.replace(target, old)
                try:
                    os.replace(draft, target)
                except BaseException:
                    os.replace(old, target)
                    raise
                shutil.rmtree(old)
            else:
                os.replace(draft, target)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise


@contextlib.contextmanager
def reserved(target: str | os.PathLike, size: int) -> Iterator[None]:
    """Reserves disk space for `target` during a block, so that the results of long work can be written.

    Args:
        size: number of bytes.

    Raises:
        OutputError: the disk has less space, or the location is not writable.
    """
    folder = next(path for path in Path(target).absolute().parents if path.exists())
    with writing(target), tempfile.TemporaryFile(dir=folder) as file:
        os.posix_fallocate(file.fileno(), 0, size)
        yield


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


def _exchange(one: Path, other: Path) -> bool:
    """Exchanges two paths atomically; returns False where that is unsupported (Linux supports it mostly)."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:
        return False
    at_fdcwd, rename_exchange = -100, 2
    return renameat2(at_fdcwd, os.fsencode(one), at_fdcwd, os.fsencode(other), rename_exchange) == 0


def require_writable(target: str | os.PathLike, directory: bool = False) -> None:
    """Checks before long work that `target` can be written; creates nothing.

    Args:
        target: a file, or with `directory` a folder that may exist already.

    Raises:
        OutputError: the nearest existing parent is not a folder or not writable.
    """
    target = Path(target)
    if not directory and target.is_dir():
        raise OutputError(f"{target}: is a directory, not a file")
    candidates = (target, *target.parents) if directory else target.parents
    nearest = next(path for path in candidates if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise OutputError(f"{target}: {nearest} is not a directory that can be written to")


def is_replaceable(target: str | os.PathLike, mark: str) -> bool:
    """Whether `atomic_directory` may write `target`: a new or empty folder, or one with the file `mark`.

    The current folder, given as ".", and mount points cannot be replaced.
    """
    path = Path(target)
    if not path.exists():
        return True
    named = path.name not in ("", "..") and not path.is_mount()
    return named and path.is_dir() and ((path / mark).is_file() or not any(path.iterdir()))


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


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def finite_json(content: Any) -> Any:
    """Returns a copy with None for numbers that are not finite, which JSON cannot represent."""
    if isinstance(content, dict):
        return {key: finite_json(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite_json(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content

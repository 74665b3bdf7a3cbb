"""Files are written whole; links stay, and pipes and devices are refused."""

import os
import stat
from pathlib import Path

import pytest

from geort_drake import Recording, synthesize_play
from geort_drake.errors import OutputError
from geort_drake.files import atomic_directory, atomic_path, require_replaceable, require_writable, write_text


def test_a_link_stays_and_its_target_gets_the_contents(tmp_path):
    """Also a link whose target does not exist yet, and the file of a recording."""
    (tmp_path / "store.npz").write_text("old")
    for name, target in (("current.npz", "store.npz"), ("later.npz", "folder/new.npz")):
        link = tmp_path / name
        link.symlink_to(target)
        synthesize_play(0, duration_s=1.0).save(link)
        assert link.is_symlink()
        assert len(Recording.load(tmp_path / target)) == 120
    loop = tmp_path / "loop"
    loop.symlink_to("loop")
    with pytest.raises(OutputError, match="loop"):
        write_text(loop, "x")
    assert loop.is_symlink()


@pytest.mark.parametrize("write", [lambda p: write_text(p, "x"), require_writable])
def test_what_is_no_file_is_not_replaced(tmp_path, write):
    """Neither a pipe nor a device."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/null")):
        with pytest.raises(OutputError, match=f"{path.name}: is no regular file"):
            write(path)
    assert stat.S_ISFIFO(os.lstat(pipe).st_mode) and os.listdir(tmp_path) == ["pipe"]


def test_permissions_stay(tmp_path):
    """A recording that only its owner may read stays so when it is written again, and a folder, too."""
    file, folder = tmp_path / "private.npz", tmp_path / "private"
    file.touch(mode=0o600)
    folder.mkdir(mode=0o700)
    synthesize_play(0, duration_s=1.0).save(file)
    with atomic_directory(folder) as draft:
        (draft / "new").touch()
    assert [stat.S_IMODE(path.stat().st_mode) for path in (file, folder)] == [0o600, 0o700]
    assert (folder / "new").exists()


@pytest.mark.parametrize("write", [lambda p: write_text(p, "x"), require_writable])
def test_a_write_protected_file_is_not_replaced(tmp_path, write):
    """Not even by root, whom the system does not stop, nor through a link."""
    path, link = tmp_path / "kept.txt", tmp_path / "link.txt"
    path.write_text("kept")
    path.chmod(0o444)
    link.symlink_to(path)
    for target in (path, link):
        with pytest.raises(OutputError, match=f"{target.name}: is write-protected"):
            write(target)
    assert path.read_text() == "kept"


@pytest.mark.parametrize("write", [lambda p: write_text(p, "x"), require_writable])
def test_a_folder_is_not_a_file(tmp_path, write):
    with pytest.raises(OutputError, match="is a directory, not a file"):
        write(tmp_path)


def test_a_place_that_takes_no_files_is_named(tmp_path):
    for target in (Path("/proc/new.txt"), tmp_path / f"{'a' * 300}.txt"):
        with pytest.raises(OutputError, match=target.name):
            write_text(target, "")
    for target in ("/dev/null", __file__):
        with pytest.raises(OutputError, match="is not a directory"):
            require_writable(target, directory=True)


def test_an_error_leaves_the_earlier_file(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(KeyError), atomic_path(path) as draft:
        draft.write_text("new")
        raise KeyError
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.txt"]


def test_a_directory_is_replaced_as_a_whole(tmp_path):
    """A link to it stays; an error leaves the earlier one."""
    target = tmp_path / "link"
    target.symlink_to("run")
    for number in range(2):
        with atomic_directory(target) as draft:
            (draft / "number.txt").write_text(str(number))
    with pytest.raises(KeyError), atomic_directory(target):
        raise KeyError
    assert (target / "number.txt").read_text() == "1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "run"] and target.is_symlink()


def test_a_directory_replaces_neither_a_file_nor_the_current_folder(tmp_path, monkeypatch):
    """A folder in use cannot be renamed, which must be known before the work begins."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match="choose another name"):
        require_replaceable(".", "mark")
    for target in (tmp_path, "new"):
        require_replaceable(target, "mark")
    file = tmp_path / "notes.txt"
    write_text(file, "before")
    with pytest.raises(OutputError, match="is a file, not a directory"), atomic_directory(file):
        pytest.fail("the file is in the way")
    assert file.read_text() == "before"
    assert list(tmp_path.iterdir()) == [file]

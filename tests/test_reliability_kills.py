"""Programs that are killed or cannot write: results are complete, none is lost, and the next run resumes."""

import functools

import numpy as np
import pytest
from faults import disks, kills

from geort_drake import files
from geort_drake.errors import OutputError
from geort_drake.files import atomic_directory, write_text


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """What each program does without a fault, found out at its first use."""
    return functools.cache(lambda work: kills.reference(work, tmp_path_factory.mktemp("work")))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "by_clock", "new_interpreter"),
    [
        ("data generation", False, True),
        ("training", False, True),
        ("recording", False, True),
        ("benchmark", False, False),
        ("teleoperation", True, False),
    ],
)
def test_a_killed_program_resumes(known, work, by_clock, new_interpreter, tmp_path):
    """Its results equal those of an undisturbed run bit for bit, also with other hashes and more threads.

    docs/results/reliability.md counts many more kills.
    """
    rng = np.random.default_rng(len(work))
    assert kills.kill(known(work), tmp_path / "kill", rng, by_clock, new_interpreter) == []


@pytest.mark.parametrize("reason", disks.DISKS)
def test_every_writer_names_the_file_that_it_cannot_write(reason, tmp_path):
    """And why: files may not grow, or the disk is full or read-only. Nothing incomplete is left."""
    if disks.DISKS[reason] and not disks.can_mount(tmp_path):
        pytest.skip("mounting a disk needs the superuser")
    assert disks.spoilt(tmp_path / "disk", reason) == []


def test_a_directory_is_replaced_in_one_step(tmp_path, monkeypatch):
    """Old and new are exchanged; where the system cannot, the old one is renamed first."""
    target = tmp_path / "run"
    for exchange in (files._exchange, lambda *_: False):
        monkeypatch.setattr(files, "_exchange", exchange)
        for number in range(2):
            with atomic_directory(target) as draft:
                (draft / "number.txt").write_text(str(number))
        assert (target / "number.txt").read_text() == "1"
        assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_directory_does_not_replace_a_file(tmp_path):
    file = tmp_path / "notes.txt"
    write_text(file, "before")
    with pytest.raises(OutputError, match="is a file, not a directory"), atomic_directory(file):
        pytest.fail("the file is in the way")
    assert file.read_text() == "before"
    assert list(tmp_path.iterdir()) == [file]

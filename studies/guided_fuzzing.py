"""Mutates inputs at random; keeps and mutates further those that reach new lines of a reader.

Needs atheris, which no test needs: pip install atheris
"""

import json
import multiprocessing
import os
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

from geort_drake.errors import GeortError

INSTRUMENTED = ["geort_drake", "yaml", "json", "csv", "zipfile"]
MAX_INPUT_TIME = 60  # s; an input that takes longer counts as hanging, even on a busy machine
MEMORY_MB = 4096
MAX_INPUT_BYTES = 1 << 19


def require_atheris() -> None:
    """Raises GeortError if atheris is not installed."""
    if find_spec("atheris") is None:
        raise GeortError("guided fuzzing needs atheris: pip install atheris")


def fuzz_guided(count: int, seed: int, folder: Path) -> dict:
    """Gives `count` inputs to the readers; a failure ends it and leaves the input in `folder`.

    Returns:
        Number of inputs, number tried of each kind, and failures.
    """
    folder.mkdir(parents=True)
    process = multiprocessing.get_context("spawn").Process(target=_fuzz, args=(count, seed, folder.resolve()))
    process.start()
    process.join()
    tried = json.loads((folder / "tried.json").read_text())
    failures = (folder / "written.txt").read_text().splitlines()
    if process.exitcode != 0:
        said = (folder / "said.txt").read_text(errors="replace")
        failures.append(f"ended with {process.exitcode}: {said[-3000:]}")
    return {"inputs": sum(tried.values()), "tried": tried, "failures": failures}


def _fuzz(count: int, seed: int, folder: Path) -> None:
    import atheris

    # Modules imported from here on report which of their lines are reached.
    with atheris.instrument_imports(include=INSTRUMENTED):
        import numpy as np
        from faults.mutations import mutate
        from faults.readers import sound_inputs

    work_folder, corpus = folder / "room", folder / "corpus"
    work_folder.mkdir()
    corpus.mkdir()
    readers = sound_inputs(work_folder)
    sound = [reader.path.read_bytes() for reader in readers]
    existing = set(work_folder.rglob("*"))
    # The first byte of an input selects its reader.
    for number, content in enumerate(sound):
        (corpus / str(number)).write_bytes(bytes([number]) + content)
    tried: Counter[str] = Counter({reader.name: 0 for reader in readers})
    log = os.open(folder / "said.txt", os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(log, stream)
    tally = os.open(folder / "tried.json", os.O_WRONLY | os.O_CREAT)
    written = os.open(folder / "written.txt", os.O_WRONLY | os.O_CREAT)
    os.chdir(work_folder)

    def read(data: bytes) -> None:
        number = data[0] % len(readers) if data else 0
        reader = readers[number]
        reader.path.write_bytes(data[1:])
        try:
            reader.read(reader.path)
        except GeortError:
            pass
        finally:
            reader.path.write_bytes(sound[number])
            tried[reader.name] += 1
            # The library ends the process itself. The text only grows, so it can be overwritten in place.
            os.pwrite(tally, json.dumps(tried).encode(), 0)
        if new := set(work_folder.rglob("*")) - existing:
            existing.update(new)
            os.write(written, f"{reader.name}: wrote {sorted(map(str, new))}\n".encode())

    def change(data: bytes, longest: int, number: int) -> bytes:
        """Returns another input of the same reader; half of them are mutations of a sound one."""
        rng = np.random.default_rng(number)
        if not data or rng.random() < 0.5:
            return data[:1] + atheris.Mutate(data[1:], longest - 1)
        which = data[0] % len(readers)
        path = readers[which].path
        mutate(path, rng)
        try:
            return (data[:1] + path.read_bytes())[:longest]
        finally:
            path.write_bytes(sound[which])

    options = {
        "atheris_runs": count, "timeout": MAX_INPUT_TIME, "rss_limit_mb": MEMORY_MB, "seed": seed + 1,
        "max_len": MAX_INPUT_BYTES, "len_control": 0, "artifact_prefix": f"{folder}/",
    }  # fmt: skip
    words = [sys.argv[0], *(f"-{name}={value}" for name, value in options.items()), str(corpus)]
    atheris.Setup(words, read, custom_mutator=change)
    atheris.Fuzz()

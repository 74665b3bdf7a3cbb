"""Command lines and folders of results that make no sense, beside those in test_command_refusals.py."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path

from faults.refusals import Case
from geort_drake.benchmark.records import read_records

USAGE = "SystemExit"


def words(*command: object) -> Callable[[Path], tuple]:
    return lambda folder: command


def results(content: str | bytes) -> Callable[[Path], tuple]:
    """Reads a benchmark's results of that content."""

    def make(folder: Path) -> tuple:
        path = folder / "trials.jsonl"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_records, path

    return make


def configuration(content: str) -> Callable[[Path], tuple]:
    """Asks for the report of a benchmark with that configuration."""

    def make(folder: Path) -> tuple:
        (folder / "runs").mkdir()
        (folder / "runs" / "config.json").write_text(content)
        (folder / "runs" / "trials.jsonl").write_text("")
        return "benchmark", "--output", "runs", "--report"

    return make


_MAKERS: dict[str, tuple[Callable[[Path], tuple], str, str]] = {
    "a recording of a million years": (
        words("synthesize", "out.npz", "--duration", "3e13"),
        "UsageError",
        "may be at most 5,000,000 frames",
    ),
    "a rate that is infinite": (
        words("synthesize", "out.npz", "--rate", "inf"),
        USAGE,
        "finite",
    ),
    "an output under a file": (
        words("synthesize", "/dev/null/out.npz"),
        "OutputError",
        "/dev/null",
    ),
    "an option that there is none of": (words("grasp", "--quick"), USAGE, "--quick"),
    "a setting that runs code": (
        words("train", "--output", "out", "--set", "steps=__import__('os').system('touch harm')"),
        "GeortError",
        "must be int",
    ),
    "a setting that is not finite": (
        words("train", "--output", "out", "--set", "pinch_weight=nan"),
        "TrainingError|UnknownNameError",
        "pinch_weight",
    ),
    "a trial elsewhere": (
        words("benchmark", "--output", "runs", "--rrd", "../../x", "cube", "0"),
        "BenchmarkError",
        "no such file",
    ),
    "a method elsewhere": (
        words("benchmark", "--output", "runs", "--methods", "../../../etc"),
        "UnknownNameError",
        "method or checkpoint",
    ),
    "a sensitivity without numbers": (
        words("benchmark", "--output", "runs", "--sensitivity", "delay=soon"),
        "GeortError|UnknownNameError|BenchmarkError",
        "delay",
    ),
    "results that are a pickle": (
        results(pickle.dumps(["a"]) + b"\n"),
        "BenchmarkError",
        "line 1: not a trial",
    ),
    "results 100,000 deep": (results("[" * 100_000 + "\n"), "BenchmarkError", "line 1: not a trial"),
    "a configuration of nothing": (
        configuration(json.dumps(dict.fromkeys(("settings", "objects", "methods", "trials", "notes")))),
        "BenchmarkError",
        "config.json: not a benchmark's configuration: Expected `object`",
    ),
    "a configuration 100,000 deep": (configuration("[" * 100_000), "BenchmarkError", "config.json"),
}

CASES = [Case("command", name, make, error, says) for name, (make, error, says) in _MAKERS.items()]

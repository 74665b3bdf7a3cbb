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
        return "benchmark_grasping.py", "--output", "runs", "--report"

    return make


def policy(name: str, content: bytes) -> Callable[[Path], tuple]:
    def make(folder: Path) -> tuple:
        # Here, because it needs Drake.
        from geort_drake.systems.policy_correction import load_policy

        (folder / name).write_bytes(content)
        return load_policy, folder / name, 16

    return make


def line(**changes: object) -> str:
    return json.dumps({"method": "hold", "object": "cube", "seed": 0, "error": "no", **changes}) + "\n"


_MAKERS: dict[str, tuple[Callable[[Path], tuple], str, str]] = {
    "a recording of a million years": (
        words("synthesize_recording.py", "out.npz", "--duration", "3e13"),
        "UsageError",
        "may be at most 5,000,000 frames",
    ),
    "a duration that is a word": (
        words("synthesize_recording.py", "out.npz", "--duration", "long"),
        USAGE,
        "long",
    ),
    "a rate that is infinite": (
        words("synthesize_recording.py", "out.npz", "--rate", "inf"),
        USAGE,
        "finite",
    ),
    "an output without a name": (
        words("synthesize_recording.py", ""),
        "UsageError",
        "must end with .npz",
    ),
    "an output under a file": (
        words("synthesize_recording.py", "/dev/null/out.npz"),
        "OutputError",
        "/dev/null",
    ),
    "an output of a thousand letters": (
        words("synthesize_recording.py", "a" * 1000 + ".npz", "--duration", "60"),
        "OSError|OutputError",
        "name too long",
    ),
    "an option that there is none of": (words("simulate_grasp.py", "--quick"), USAGE, "--quick"),
    "an option cut short": (words("benchmark_grasping.py", "--trials"), USAGE, "--trials"),
    "a device that there is none of": (words("train_retargeter.py", "--device", "tpu"), USAGE, "--device"),
    "a seed that is a fraction": (words("train_retargeter.py", "--seed", "1.5"), USAGE, "--seed"),
    "a setting that runs code": (
        words(
            "train_retargeter.py", "--output", "out", "--set", "steps=__import__('os').system('touch harm')"
        ),
        "GeortError",
        "must be int",
    ),
    "a setting that is not finite": (
        words("train_retargeter.py", "--output", "out", "--set", "pinch_weight=nan"),
        "TrainingError|UnknownNameError",
        "pinch_weight",
    ),
    "a trial elsewhere": (
        words("benchmark_grasping.py", "--output", "runs", "--rrd", "../../x", "cube", "0"),
        "BenchmarkError",
        "no such file",
    ),
    "a method elsewhere": (
        words("benchmark_grasping.py", "--output", "runs", "--methods", "../../../etc"),
        "UnknownNameError",
        "method or checkpoint",
    ),
    "a sensitivity without numbers": (
        words("benchmark_grasping.py", "--output", "runs", "--sensitivity", "delay=soon"),
        "GeortError|UnknownNameError|BenchmarkError",
        "delay",
    ),
    "sessions that are not there": (
        words("evaluate_replay.py", "none.npz", "--retargeter", "none", "--output", "runs"),
        "RecordingError|CheckpointError",
        "none",
    ),
    "results that are a pickle": (
        results(pickle.dumps(["a"]) + b"\n"),
        "BenchmarkError",
        "line 1: not a trial",
    ),
    "results 100,000 deep": (results("[" * 100_000 + "\n"), "BenchmarkError", "line 1: not a trial"),
    "results whose seed is a list": (results(line(seed=[0])), "BenchmarkError", "line 1: not a trial"),
    "a configuration that is a list": (configuration("[]"), "BenchmarkError", "config.json"),
    "a configuration of nothing": (
        configuration(json.dumps(dict.fromkeys(("settings", "objects", "methods", "trials", "notes")))),
        "BenchmarkError",
        "config.json: not a benchmark's configuration: Expected `object`",
    ),
    "a configuration 100,000 deep": (configuration("[" * 100_000), "BenchmarkError", "config.json"),
    "a policy that is a pickle": (policy("a.pt", pickle.dumps([1])), "PolicyError", "a.pt"),
    "a policy that is no ONNX": (policy("a.onnx", b"\x08\x07garbage"), "PolicyError", "a.onnx"),
    "a policy of another kind": (policy("a.exe", b"MZ"), "PolicyError", "a.exe"),
}

CASES = [Case("command", name, make, error, says) for name, (make, error, says) in _MAKERS.items()]

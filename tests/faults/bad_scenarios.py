"""Scenarios that cannot be simulated, beside those in test_scenario.py."""

from collections.abc import Callable
from pathlib import Path

from faults.refusals import Case


def laughs(levels: int) -> str:
    """A list of ten times a list of ten times ..., by aliases."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    for level in range(1, levels):
        lines.append(f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]")
    return "\n".join([*lines, f"Grasp: {{arm_posture: *a{levels - 1}}}"])


def file(text: str | bytes, name: str = "Grasp") -> Callable[[Path], tuple]:
    def make(folder: Path) -> tuple:
        path = folder / "bad.scenarios.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return "grasp", "--scenario_file", path, "--scenario_name", name, "--output", "out"

    return make


def text(words: str) -> Callable[[Path], tuple]:
    return lambda folder: ("grasp", "--scenario_text", words, "--output", "out")


SCENARIO, NAME = "ScenarioError", "UnknownNameError"

_MAKERS: dict[str, tuple[Callable[[Path], tuple], str, str]] = {
    "a tag that runs code": (
        file("Grasp: !!python/object/apply:os.system ['touch harm']"),
        SCENARIO,
        "Grasp|tag",
    ),
    "a tag that makes an object": (file("Grasp: {hand: !!python/name:os.system ''}"), SCENARIO, "Grasp"),
    "aliases of aliases, 10⁹ in all": (file(laughs(9)), SCENARIO, "arm_posture|Grasp|alias"),
    "an alias of itself": (file("Grasp: &a {arm_posture: *a}"), SCENARIO, "Grasp|alias"),
    "two documents": (file("Grasp: {}\n---\nGrasp: {}\n"), SCENARIO, "bad.scenarios.yaml"),
    "a null byte": (file(b"Grasp: {hand: a\0b}"), SCENARIO, "bad.scenarios.yaml"),
    "a step of an hour": (text("{plant_config: {time_step: 3600}}"), SCENARIO, "multiple of plant_config"),
    "a hand elsewhere": (text("{hand: ../../../../etc/passwd}"), "HandError", "passwd"),
    "an object elsewhere": (text("{object: {name: ../../../etc/passwd}}"), NAME, "unknown object"),
    "a model elsewhere": (
        text("{directives: [{add_model: {name: arm, file: 'package://geort_drake/../../../etc/passwd'}}]}"),
        SCENARIO,
        "directives",
    ),
    "a model by the network": (
        text("{directives: [{add_model: {name: arm, file: 'https://example.org/arm.sdf'}}]}"),
        SCENARIO,
        "directives",
    ),
    "a package that there is none of": (
        text("{directives: [{add_model: {name: arm, file: 'package://nothing/arm.sdf'}}]}"),
        SCENARIO,
        "directives",
    ),
    "a scenario that is nothing": (file("Grasp:\n"), SCENARIO, "Grasp"),
}

CASES = [Case("scenario", name, make, error, says) for name, (make, error, says) in _MAKERS.items()]

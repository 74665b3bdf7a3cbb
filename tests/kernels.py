"""Runs the tests that train under each of torch's kernels that this processor has, with three seeds.

Prints by which factor each figure is better than its limit, and fails if one is below two.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import torch
from rich.console import Console
from rich.table import Table

SEEDS, MARGIN = (0, 1, 2), 2.0
SUPPORTED = {
    "default": True,
    "avx2": torch.cpu._is_avx2_supported(),
    "avx512": torch.cpu._is_avx512_supported(),
}
FILES = [
    path for path in sorted(Path(__file__).parent.glob("test_*.py")) if "mark.training" in path.read_text()
]
KERNELS = [name for name, supported in SUPPORTED.items() if supported]


def margins(kernel: str, seed: int) -> tuple[int, dict[str, float]]:
    """Returns the exit code of the tests, and each figure's limit over its value."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [
            sys.executable, "-m", "pytest", "-q", "-m", "training", *map(str, FILES),
            f"--training-seed={seed}", f"--training-margin={MARGIN}", f"--junitxml={report}",
            "-o", "junit_family=xunit1",
        ]  # fmt: skip
        environment = os.environ | {"ATEN_CPU_CAPABILITY": kernel, "OMP_NUM_THREADS": "1"}
        code = subprocess.run(command, env=environment, check=False).returncode
        return code, {
            f"{case.get('name')}: {figure.get('name')}": float(figure.get("value", "nan"))
            for case in ElementTree.parse(report).iter("testcase")
            for figure in case.iter("property")
        }


def main() -> int:
    runs = {(kernel, seed): margins(kernel, seed) for kernel in KERNELS for seed in SEEDS}
    table = Table("figure", *(f"{kernel} {seed}" for kernel, seed in runs), title="limit over value")
    for name in dict.fromkeys(name for _, figures in runs.values() for name in figures):
        table.add_row(name, *(f"{figures.get(name, float('nan')):.1f}" for _, figures in runs.values()))
    Console(width=200).print(table)
    return max(code for code, _ in runs.values())


if __name__ == "__main__":
    sys.exit(main())

"""Times the Jacobian of a retargeter against its call, and compares it with finite differences.

python benchmarks/bench_jacobian.py --json jacobian.json
"""

from collections.abc import Sequence

import numpy as np
from side_by_side import measure, parse, parser, report
from untrained import FORMS, untrained

from geort_drake.console import console, run_main
from geort_drake.retargeting.retargeter import Retargeter

STEP = 1e-5  # m


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.add_argument("--method", choices=FORMS, default=FORMS[0], help="(default: %(default)s)")
    arguments = parse(options, argv)
    retarget = untrained(arguments.method)
    hands = np.random.default_rng(1).normal(0.0, 0.03, (100, 4, 3))
    errors = [np.abs(retarget.jacobian(p_HF) - differences(retarget, p_HF)).max() for p_HF in hands]
    largest = max(np.abs(retarget.jacobian(p_HF)).max() for p_HF in hands)
    p_HF = hands[0]
    results = measure(
        {
            "call": lambda: retarget(p_HF),
            "value_and_jacobian": lambda: retarget.value_and_jacobian(p_HF),
            "central differences": lambda: differences(retarget, p_HF),
        },
        arguments.seconds,
    )
    difference = {"max_abs_rad_per_m": float(max(errors)), "largest_entry_rad_per_m": float(largest)}
    report(f"Jacobian of {arguments.method}", results, "call", arguments.json, difference=difference)
    console.print(
        f"differs from central differences by {max(errors):.1e} rad/m; largest entry {largest:.0f} rad/m"
    )
    return 0


def differences(retarget: Retargeter, p_HF: np.ndarray) -> np.ndarray:
    """Returns ∂q/∂p_HF (n, F, 3), rad/m, by central differences with Richardson extrapolation."""
    steps = np.eye(p_HF.size).reshape(-1, *p_HF.shape)

    def central(step: float) -> np.ndarray:
        q = retarget(np.concatenate([p_HF + step * steps, p_HF - step * steps]))
        return (q[: p_HF.size] - q[p_HF.size :]).T / (2 * step)

    return ((4 * central(STEP) - central(2 * STEP)) / 3).reshape(-1, *p_HF.shape)


if __name__ == "__main__":
    run_main(main)

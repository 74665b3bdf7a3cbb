"""Calibrates the simulated person on maps of three families, and checks the result on other maps.

python studies/calibrate_operator.py --output calibration
python studies/calibrate_operator.py --output check --check firmer=2.25 closing_speed=0.03

`ASSUMED` names the numbers of the person that no source gives. In 32 variants of the person, each is half
as large again or by a third smaller, in a fractional factorial design of two levels (2^(16−11), resolution
IV). Every variant does each task once as each kind of person, through maps of three families that are turned
or shrunk. The effect of a number on the score is estimated by least squares, beside the other numbers, the
maps, tasks and kinds; p-values are corrected by Holm's method. A number with a significant effect moves to
its better value. The second command checks such a change: people with and without it do every task through
other maps, with other objects and seeds, in pairs. The same commands resume interrupted runs.
"""

import argparse
import dataclasses as dc
import itertools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from criteria import least_squares
from scipy.linalg import hadamard
from scipy.stats import ttest_1samp
from worsened import Trials, add_options, case_of, condition_of, run_trials

from geort_drake.benchmark.analysis import frame_of, holm
from geort_drake.benchmark.log import Row, TrialKey
from geort_drake.benchmark.workers import simulate
from geort_drake.console import run_main
from geort_drake.settings import parse_settings
from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.person.engine import KINDS
from geort_drake.simulation.trial import Trial

LEVEL = 0.05
FACTOR = 1.5
# Numbers without a source, by the fields of `OperatorConfig` that change together.
ASSUMED = [
    ("correction_rate",),
    ("mimicry_rate",),
    ("closing_speed",),
    ("squeeze_speed",),
    ("grip_force", "grip_per_weight"),
    ("firmer",),
    ("opening_speed",),
    ("lowering_speed",),
    ("patience",),
    ("shape_tolerance",),
    ("overshoot",),
    ("squeeze",),
    ("jacobian_drift",),
    ("neighbourhood",),
    ("push_speed", "most_push"),
    ("lift",),
]
FAMILIES = ("affine_ik", "geort", "universal")
# Copies of each family's map, and cases of the tasks that have several, for the calibration and its check.
FAULTS = ({"turned": 20.0}, {"shrunk": 0.4})
OTHER_FAULTS = ({"uneven": 2.0}, {"mixed": 0.25, "gapped": 10.0})
CASES = {"grasp": "pen", "pick_place": "block_20"}
OTHER_CASES = {"grasp": "rod", "pick_place": "block_25"}
TASKS = ("grasp", "pick_place", "peg", "keys", "cap")
FIRST_TASKS = ("grasp", "pick_place", "keys", "peg", "cap")  # from short to long
# Benchmarks use small seeds.
FIRST_SEED, FIRST_OTHER_SEED = 100, 200
SEEDS = 4


def design() -> np.ndarray:
    """Returns levels (32, 16), −1 or 1, of the numbers in each variant, each followed by its opposite.

    Rows of a Hadamard matrix and their opposites: no main effect is confounded with an interaction of two.
    """
    return np.stack([hadamard(16), -hadamard(16)], axis=1).reshape(32, 16)


def maps_of(faults: Sequence[Mapping[str, float]]) -> list[tuple[str, str]]:
    """Returns (method, condition) of each family's copies."""
    return [(family, condition_of(each)) for each in faults for family in FAMILIES]


def keys_of() -> list[TrialKey]:
    """Returns the trials of the calibration, task by task; `person` is the number of the variant.

    Opposite variants have the same maps and seeds, and each task has all variants, so the trials of a few
    tasks are balanced, too.
    """
    maps = maps_of(FAULTS)
    keys = []
    for variant in range(len(design())):
        pair = variant // 2
        for cell, (task, kind) in enumerate(itertools.product(TASKS, KINDS)):
            method, condition = maps[(pair + cell) % len(maps)]
            seed = FIRST_SEED + pair % SEEDS
            keys.append(TrialKey(method, 0, task, kind, condition, case_of(task, CASES), variant, seed))
    return sorted(keys, key=lambda key: FIRST_TASKS.index(key.task))


def check_keys(seeds: int) -> list[TrialKey]:
    """Returns the trials of the check, in pairs; `person` is 1 with the change and 0 without."""
    return [
        TrialKey(method, 0, task, kind, condition, case_of(task, OTHER_CASES), changed, seed)
        for seed in range(FIRST_OTHER_SEED, FIRST_OTHER_SEED + seeds)
        for (method, condition), task, kind in itertools.product(maps_of(OTHER_FAULTS), TASKS, KINDS)
        for changed in (0, 1)
    ]


class Variants(Trials):
    """Makes the trials of persons whose numbers differ; `person` of a key chooses among `changes`."""

    def __init__(self, hand_name: str, changes: Sequence[Mapping[str, float]]):
        super().__init__(hand_name)
        self._changes = changes

    def trial(self, key: TrialKey) -> Trial:
        trial = super().trial(key)
        trial.scenario.operator = dc.replace(trial.scenario.operator, **self._changes[key.person])
        trial.scenario.operator.validate()
        return trial


def changes() -> list[dict[str, float]]:
    """Returns the changed numbers of each variant."""
    present = OperatorConfig()
    return [
        {
            name: getattr(present, name) * FACTOR**level
            for names, level in zip(ASSUMED, levels, strict=True)
            for name in names
        }
        for levels in design().astype(float)
    ]


def effects(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns a row per assumed number: effect on the score of its larger against its smaller value.

    Columns: name, low, high (values), effect, its 95 % interval from `from` to `to`, p, and p_holm.
    """
    levels = design()[frame["person"].to_numpy(int)] / 2
    cells = pd.get_dummies(frame["task"] + frame["kind"]).to_numpy(float)
    maps = pd.get_dummies(frame["method"] + frame["condition"]).to_numpy(float)
    A = np.hstack([levels, cells, maps])
    x, half_widths, p = least_squares(A, frame["score"].to_numpy(float), len(ASSUMED))
    present = OperatorConfig()
    values = [getattr(present, names[0]) for names in ASSUMED]
    return pd.DataFrame(
        {
            "name": [" and ".join(names) for names in ASSUMED],
            "low": [value / FACTOR for value in values],
            "high": [value * FACTOR for value in values],
            "effect": x,
            "from": x - half_widths,
            "to": x + half_widths,
            "p": p,
            "p_holm": holm(p.tolist()),
        }
    )


def report(rows: Iterable[Row]) -> str:
    """Returns the effects of the numbers in Markdown, in points of 100 of the score."""
    frame = frame_of(rows)
    frame = frame[frame["error"].isna()]
    lines = ["| number | smaller | larger | effect | p (Holm) |", "|---|---|---|---|---|"]
    for row in effects(frame).to_dict("records"):
        effect, low, high = (round(100 * row[name]) for name in ("effect", "from", "to"))
        effect = f"{effect:+d} [{low:+d}, {high:+d}]"
        effect = f"**{effect}**" if row["p_holm"] < LEVEL else effect
        name = " and ".join(f"`{each}`" for each in row["name"].split(" and "))
        lines.append(f"| {name} | {row['low']:.3g} | {row['high']:.3g} | {effect} | {row['p_holm']:.2g} |")
    lines += ["", f"{len(frame)} trials, mean score {100 * frame['score'].mean():.0f}."]
    return "\n".join(lines)


def check_report(rows: Iterable[Row]) -> str:
    """Returns what a change of the person brings, by family and in all, in Markdown."""
    frame = frame_of(rows)
    frame = frame[frame["error"].isna()]
    index = ["method", "condition", "task", "kind", "seed"]
    pairs = frame.pivot(index=index, columns="person", values="score").dropna()
    lines = ["| family | pairs | without | with | p |", "|---|---|---|---|---|"]
    for name, group in [*pairs.groupby("method"), ("all", pairs)]:
        p = ttest_1samp(group[1] - group[0], 0.0).pvalue
        without, changed = 100 * group[0].mean(), 100 * group[1].mean()
        lines.append(f"| {name} | {len(group)} | {without:.0f} | {changed:.0f} | {p:.2g} |")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", nargs="+", metavar="FIELD=VALUE", help="change of the person to check")
    parser.add_argument("--seeds", type=int, default=1, help="seeds of the check")
    add_options(parser)
    arguments = parser.parse_args(argv)
    if arguments.check:
        change = parse_settings(arguments.check, OperatorConfig(), "the person")
        trials = Variants(arguments.hand, [{}, change])
        run_trials(simulate, check_keys(arguments.seeds), check_report, arguments, trials)
    else:
        trials = Variants(arguments.hand, changes())
        run_trials(simulate, keys_of(), report, arguments, trials)
    return 0


if __name__ == "__main__":
    run_main(main)

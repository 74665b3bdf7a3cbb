"""Computes a grasp benchmark's sensitivity to its assumptions: success and ranking in every condition."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.stats import kendalltau

from geort_drake.benchmark.conditions import ASSUMPTIONS, group_by_value
from geort_drake.benchmark.records import Record
from geort_drake.benchmark.statistics import proportion
from geort_drake.simulation.scenario import Scenario


def summarize_sensitivity(
    records: Iterable[Record], methods: Sequence[str], scenario: Scenario
) -> dict[str, dict]:
    """Returns every method's first-attempt success in every condition, and the correlation of rankings.

    Nominal trials count if their method, object and seed have a trial in a condition of the parameter, too.

    Args:
        records: records with and without a condition.
        methods: methods in the order of the report; those without a condition are left out.
        scenario: the nominal scenario.

    Returns:
        Parameter → `label` and `conditions`, sorted by `value`, each with `nominal`: whether it is the
        scenario's own value; `methods`: name → `proportion`; `tau`: Kendall's τ_b between the success rates
        here and in the nominal scenario, None if either has only ties.
    """
    judged = [record for record in records if "error" not in record]
    result = {}
    for name, parameter in ASSUMPTIONS.items():
        groups = group_by_value(judged, name)
        if not groups:
            continue
        changed = [record for group in groups.values() for record in group]
        tried = {(r["method"], r["object"], r["seed"]) for r in changed}
        nominal = parameter.nominal(scenario)
        groups[nominal] = [
            r for r in judged if not r.get("condition") and (r["method"], r["object"], r["seed"]) in tried
        ]
        names = [method for method in methods if any(r["method"] == method for r in changed)]
        rates = {value: _success(group, names) for value, group in groups.items()}
        result[name] = {
            "label": parameter.label,
            "conditions": [
                {
                    "value": value,
                    "nominal": value == nominal,
                    "methods": rates[value],
                    "tau": _tau(rates[nominal], rates[value]),
                }
                for value in sorted(rates)
            ],
        }
    return result


def _success(records: Sequence[Record], methods: Sequence[str]) -> dict[str, dict]:
    success = {name: [bool(r["first_attempt"]) for r in records if r["method"] == name] for name in methods}
    return {name: proportion(sum(values), len(values)) for name, values in success.items()}


def _tau(nominal: Mapping[str, dict], changed: Mapping[str, dict]) -> float | None:
    both = [name for name in nominal if None not in (nominal[name]["rate"], changed[name]["rate"])]
    if len(both) < 2:
        return None
    tau = kendalltau(*([rates[name]["rate"] for name in both] for rates in (nominal, changed))).statistic
    return None if np.isnan(tau) else float(tau)

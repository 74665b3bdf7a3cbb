"""Writes reports of a benchmark's folder: `summary.json`, plots, `report.md`."""

import functools
import json
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from geort_drake.benchmark.config import CONFIG, SCENARIO, TRIALS, read_config
from geort_drake.benchmark.folder import rerun_path
from geort_drake.benchmark.plots import completion_plot, success_panels
from geort_drake.benchmark.records import Record, by_training, key_of, read_records, training_of
from geort_drake.benchmark.sensitivity import summarize_sensitivity
from geort_drake.benchmark.statistics import ending, summarize
from geort_drake.errors import BenchmarkError
from geort_drake.files import write_text
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks.grasp.contacts import grip_of
from geort_drake.simulation.tasks.grasp.monitor import GraspPhase

SUMMARY, MARKDOWN = "summary.json", "report.md"
# Plot → file to which the report refers.
FIGURES = {"completion": "completion.svg", "sensitivity": "sensitivity.svg"}
_PHASES = [phase.name.lower() for phase in GraspPhase if phase not in (GraspPhase.DONE, GraspPhase.THROWN)]


def write_grasp_report(folder: Path) -> dict:
    """Writes the report of the finished trials in the folder of a grasp benchmark.

    Args:
        folder: folder of the benchmark.

    Returns:
        The summary: the entries of `summarize`; `errors`, the number of trials with an error; `sensitivity`,
        see `summarize_sensitivity`; `refused`: object that the hand cannot grasp → why; `config`, the
        benchmark's configuration.

    Raises:
        BenchmarkError: the folder contains no benchmark, or a damaged one.
        UnknownNameError: an object has no known grip.
    """
    config = read_config(folder)
    order = list(dict.fromkeys(training_of(name)[0] for name in config["methods"]))
    everything = read_records(folder / TRIALS)
    conditions = ["", *config.get("conditions", {})]
    for key in map(key_of, everything):
        known = (
            key.method in config["methods"]
            and key.object in config["objects"]
            and key.condition in conditions
        )
        if not known:
            raise BenchmarkError(f"{folder / TRIALS}: the trial {key} is not in {CONFIG}")
    records = [record for record in everything if not record.get("condition")]
    names = list(config["methods"])
    records.sort(key=lambda r: (names.index(r["method"]), r["object"], r["seed"]))
    by_method = list(map(by_training, records))
    grips = {name: grip_of(name) for name in config["objects"]}
    summary = summarize(by_method, order, config["settings"]["scenario"]["timeout"], grips)
    sensitivity = summarize_sensitivity(
        map(by_training, everything), order, load_scenario(folder / SCENARIO, "Resolved")
    )
    errors = [{**record, "trial": str(key_of(record))} for record in everything if "error" in record]
    summary = {**summary, "errors": len(errors), "sensitivity": sensitivity, "config": config}
    summary["refused"] = refused = config.get("refused", {})
    plots = {"completion": completion_plot(by_method, order, summary["timeout_s"])}
    if sensitivity:
        plots["sensitivity"] = success_panels(sensitivity)
    content = {
        "config": config,
        "overall": _group(summary, "overall"),
        "classes": {grip: _group(summary, "classes", grip) for grip in summary["classes"]},
        "objects": {name: _group(summary, "objects", name) for name in summary["objects"]},
        "grips": grips,
        "phases": _PHASES,
        "plots": plots,
        "records": [_shown(folder, record) for record in records],
        "errors": errors,
        "expected": len(config["methods"]) * (len(config["objects"]) - len(refused)) * config["trials"],
        "command": f"geort-drake benchmark --output {shlex.quote(str(folder))} --rrd",
    }
    _write(folder, "grasp", summary, plots, content)
    return summary


def _write(
    folder: Path,
    kind: str,
    summary: dict,
    plots: Mapping[str, str],
    content: Mapping[str, object],
) -> None:
    """Writes the summary, the plots (name → SVG), and the report from the template of `kind`."""
    write_text(folder / SUMMARY, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    for name, plot in plots.items():
        write_text(folder / FIGURES[name], plot)
    template = _environment().get_template(f"{kind}_{MARKDOWN}.j2")
    write_text(folder / MARKDOWN, template.render(summary=summary, figures=FIGURES, **content))


def _group(summary: dict, *path: str) -> dict:
    """Returns figures and differences of all methods at a path of keys such as ("objects", "cube")."""

    def each(entries: dict[str, dict]) -> dict[str, dict]:
        return {name: functools.reduce(dict.__getitem__, path, entry) for name, entry in entries.items()}

    return {"methods": each(summary["methods"]), "differences": each(summary["differences"])}


def _shown(folder: Path, record: Record) -> dict:
    """Returns a record with its Rerun recording, if there is one, and its ending."""
    path = rerun_path(folder, key_of(record))
    recording = path.relative_to(folder).as_posix() if path.is_file() else None
    return {**record, "rrd": recording, "ending": None if "error" in record else ending(record)}


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("geort_drake.benchmark"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "proportion": _proportion,
        "seconds": _with_interval("{:.1f}"),
        "points": _with_interval("{:+.0f}", scale=100),
        "signed": _with_interval("{:+.1f}"),
        "plain": "{:g}".format,
        "number": _number,
        "probability": lambda p: "< 0.001" if p < 0.001 else f"{p:.3f}",
        "counted": lambda counts: ", ".join(f"{n} × {name}" for name, n in counts.items()) or "none",
    }
    return environment


def _number(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _proportion(value: dict) -> str:
    if value["rate"] is None:
        return "–"
    return "{:.0f} % [{:.0f}, {:.0f}]".format(*(100 * value[name] for name in ("rate", "low", "high")))


def _with_interval(form: str, scale: float = 1) -> Callable[[dict], str]:
    def text(value: dict) -> str:
        mean, low, high = (
            None if value[key] is None else form.format(scale * value[key]) for key in ("mean", "low", "high")
        )
        if mean is None:
            return "–"
        return mean if low is None else f"{mean} [{low}, {high}]"

    return text

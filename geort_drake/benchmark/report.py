"""The report of a grasp benchmark: `summary.json`, `report.md`, and `report.html`, a page with all in it."""

import functools
import json
import shlex
from collections.abc import Callable, Iterable
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from geort_drake.benchmark.config import CONFIG, SCENARIO, TRIALS, read_config
from geort_drake.benchmark.plots import grasp_plots, success_panels
from geort_drake.benchmark.sensitivity import summarize_sensitivity
from geort_drake.benchmark.statistics import Record, ending, summarize
from geort_drake.benchmark.trial_log import TrialKey, key_of, read_records
from geort_drake.errors import BenchmarkError
from geort_drake.files import write_text
from geort_drake.simulation.scenario import load_scenario
from geort_drake.simulation.tasks.grasp.contacts import grip_of
from geort_drake.simulation.tasks.grasp.monitor import GraspPhase

SUMMARY, HTML, MARKDOWN, RERUN = "summary.json", "report.html", "report.md", "rrd"
# Beside the Markdown, which cannot contain them.
FIGURES = {"completion": "completion.svg", "sensitivity": "sensitivity.svg"}
_PHASES = [phase.name.lower() for phase in GraspPhase if phase not in (GraspPhase.DONE, GraspPhase.THROWN)]


def write_report(folder: Path) -> dict:
    """Writes the report of whatever trials a folder holds so far.

    Returns:
        The summary: `summarize`'s, with the number of `errors`, `summarize_sensitivity`'s under
        `sensitivity` and the benchmark's configuration under `config`.

    Raises:
        BenchmarkError: the folder holds no benchmark, or a corrupt one.
        UnknownNameError: it is not known what grip an object is made for.
    """
    config = read_config(folder)
    order = list(config["methods"])
    everything = read_records(folder / TRIALS)
    _require_known(everything, config, folder)
    records = [record for record in everything if not record.get("condition")]
    records.sort(key=lambda r: (order.index(r["method"]), r["object"], r["seed"]))
    grips = {name: grip_of(name) for name in config["objects"]}
    summary = summarize(records, order, config["settings"]["scenario"]["timeout"], grips)
    sensitivity = summarize_sensitivity(everything, order, load_scenario(folder / SCENARIO, "Resolved"))
    errors = [{**record, "trial": str(key_of(record))} for record in everything if "error" in record]
    summary = {**summary, "errors": len(errors), "sensitivity": sensitivity, "config": config}
    write_text(folder / SUMMARY, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    plots = grasp_plots(records, summary)
    if sensitivity:
        plots["sensitivity"] = success_panels(sensitivity)
    for name in FIGURES.keys() & plots.keys():
        write_text(folder / FIGURES[name], plots[name])
    content = {
        "summary": summary,
        "config": config,
        "overall": _group(summary, "overall"),
        "classes": {grip: _group(summary, "classes", grip) for grip in summary["classes"]},
        "objects": {name: _group(summary, "objects", name) for name in summary["objects"]},
        "grips": grips,
        "phases": _PHASES,
        "plots": plots,
        "figures": FIGURES,
        "records": [_shown(folder, record) for record in records],
        "errors": errors,
        "expected": len(config["methods"]) * len(config["objects"]) * config["trials"],
        "command": f"geort-drake benchmark --output {shlex.quote(str(folder))} --rrd",
    }
    environment = _environment()
    for name in (MARKDOWN, HTML):
        template = environment.get_template(f"grasp_{name}.j2")
        write_text(folder / name, template.render(content))
    return summary


def rerun_path(key: TrialKey) -> Path:
    """Where in the folder a trial's recording for the viewer is put when one asks for it."""
    return Path(RERUN) / f"{key.file_stem}.rrd"


def _require_known(records: Iterable[Record], config: dict, folder: Path) -> None:
    conditions = ["", *config.get("conditions", {})]
    for key in map(key_of, records):
        if (
            key.method not in config["methods"]
            or key.object not in config["objects"]
            or key.condition not in conditions
        ):
            raise BenchmarkError(
                f"{folder / TRIALS}: there is a trial of {key}, which {CONFIG} does not know of"
            )


def _group(summary: dict, *path: str) -> dict:
    """The figures and differences of all methods for what a path in their entries leads to."""

    def each(entries: dict[str, dict]) -> dict[str, dict]:
        return {name: functools.reduce(dict.__getitem__, path, entry) for name, entry in entries.items()}

    return {"methods": each(summary["methods"]), "differences": each(summary["differences"])}


def _shown(folder: Path, record: Record) -> dict:
    """A line with what the page says of it besides."""
    path = rerun_path(key_of(record))
    recorded = path.as_posix() if (folder / path).is_file() else None
    return {**record, "rrd": recorded, "ending": None if "error" in record else ending(record)}


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("geort_drake.benchmark"),
        autoescape=select_autoescape(["html.j2"], default=False),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "percent": _percent,
        "proportion": _proportion,
        "seconds": _with_interval("{:.1f}"),
        "points": lambda value: _with_interval("{:+.0f}")(
            {key: None if value[key] is None else 100 * value[key] for key in ("mean", "low", "high")}
        ),
        "signed": _with_interval("{:+.1f}"),
        "plain": "{:g}".format,
        "number": lambda value, digits=1: "–" if value is None else f"{value:.{digits}f}",
        "probability": lambda p: "< 0.001" if p < 0.001 else f"{p:.3f}",
        "counted": lambda counts: ", ".join(f"{n} × {name}" for name, n in counts.items()) or "none",
    }
    return environment


def _percent(rate: float | None) -> str:
    return "–" if rate is None else f"{100 * rate:.0f} %"


def _proportion(value: dict) -> str:
    if value["rate"] is None:
        return "–"
    return f"{_percent(value['rate'])} [{100 * value['low']:.0f}, {100 * value['high']:.0f}]"


def _with_interval(form: str) -> Callable[[dict], str]:
    def text(value: dict) -> str:
        if value["mean"] is None:
            return "–"
        mean = form.format(value["mean"])
        if value["low"] is None:
            return mean
        return f"{mean} [{form.format(value['low'])}, {form.format(value['high'])}]"

    return text

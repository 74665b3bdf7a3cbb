"""The report of a grasp benchmark: `summary.json`, `report.md`, and `report.html`, a page with all in it."""

import json
import shlex
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from geort_drake.errors import BenchmarkError
from geort_drake.evaluation.grasp_benchmark import CONFIG, SCENARIO, TRIALS, read_config
from geort_drake.evaluation.grasp_plots import grasp_plots, success_panels
from geort_drake.evaluation.grasp_statistics import summarize
from geort_drake.evaluation.sensitivity import summarize_sensitivity
from geort_drake.evaluation.trial_log import TrialKey, key_of, read_records
from geort_drake.files import write_text
from geort_drake.simulation.scenario import load_scenario

SUMMARY, HTML, MARKDOWN, RERUN = "summary.json", "report.html", "report.md", "rrd"
SENSITIVITY = "sensitivity.svg"


def write_report(folder: Path) -> dict:
    """Writes the report of whatever trials a folder holds so far.

    Returns:
        The summary: `summarize`'s, with the number of `errors`, `summarize_sensitivity`'s under
        `sensitivity` and the benchmark's configuration under `config`.

    Raises:
        BenchmarkError: the folder holds no benchmark, or a corrupt one.
    """
    config = read_config(folder)
    order = list(config["methods"])
    everything = read_records(folder / TRIALS)
    for record in everything:
        if record["method"] not in order or record["object"] not in config["objects"]:
            raise BenchmarkError(
                f"{folder / TRIALS}: there is a trial of {record['method']} with {record['object']}, which "
                f"{CONFIG} does not know of"
            )
    records = [record for record in everything if not record.get("condition")]
    records.sort(key=lambda r: (order.index(r["method"]), r["object"], r["seed"]))
    summary = summarize(records, order, config["settings"]["scenario"]["timeout"])
    sensitivity = summarize_sensitivity(everything, order, load_scenario(folder / SCENARIO, "Resolved"))
    errors = [{**record, "trial": str(key_of(record))} for record in everything if "error" in record]
    summary = {**summary, "errors": len(errors), "sensitivity": sensitivity, "config": config}
    write_text(folder / SUMMARY, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    environment = Environment(
        loader=PackageLoader("geort_drake.evaluation"),
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
    }
    content = {
        "summary": summary,
        "config": config,
        "records": [{**record, "rrd": _recorded(folder, key_of(record))} for record in records],
        "errors": errors,
        "figure": SENSITIVITY,
        "expected": len(config["methods"]) * len(config["objects"]) * config["trials"],
        "command": f"python scripts/benchmark_grasping.py --output {shlex.quote(str(folder))} --rrd",
    }
    write_text(folder / MARKDOWN, environment.get_template("grasp_report.md.j2").render(content))
    plots = grasp_plots(records, summary)
    if sensitivity:
        plots["sensitivity"] = success_panels(sensitivity)
        write_text(folder / SENSITIVITY, plots["sensitivity"])
    write_text(folder / HTML, environment.get_template("grasp_report.html.j2").render(content, plots=plots))
    return summary


def rerun_path(key: TrialKey) -> Path:
    """Where in the folder a trial's recording for the viewer is put when one asks for it."""
    return Path(RERUN) / f"{key.method}-{key.object}-{key.seed}.rrd"


def _recorded(folder: Path, key: TrialKey) -> str | None:
    path = rerun_path(key)
    return path.as_posix() if (folder / path).is_file() else None


def _percent(rate: float | None) -> str:
    return "–" if rate is None else f"{100 * rate:.0f} %"


def _proportion(value: dict) -> str:
    if value["rate"] is None:
        return "–"
    return f"{_percent(value['rate'])} [{100 * value['low']:.0f}, {100 * value['high']:.0f}]"


def _with_interval(form: str):
    def text(value: dict) -> str:
        if value["mean"] is None:
            return "–"
        mean = form.format(value["mean"])
        if value["low"] is None:
            return mean
        return f"{mean} [{form.format(value['low'])}, {form.format(value['high'])}]"

    return text

"""Reports the results of a comparison as tables for the terminal and as a dictionary for JSON."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich import box
from rich.console import Group
from rich.padding import Padding
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from geort_drake.comparison.comparison import Comparison, Outcome
from geort_drake.comparison.metric_table import METRICS, TABLES, Metric, mean
from geort_drake.people.recording import Recording
from geort_drake.versions import versions

# Name of each method → name of each protocol → outcomes.
Results = Mapping[str, Mapping[str, Sequence[Outcome]]]

FORMAT = 3  # incremented when keys change


def report(comparison: Comparison, results: Results, recording: Recording, name: str) -> dict:
    """Returns all results as JSON types; docs/reference/comparison-file.md describes them.

    Args:
        comparison: the comparison that produced them.
        results: results of all methods, or of those finished so far.
        recording: the training recording.
        name: name of the recording's file.
    """
    hand = comparison.hand
    return {
        "format": FORMAT,
        "hand": hand.description.name,
        "hand_sha256": hand.digest,
        "recording": name,
        "recording_sha256": recording.digest,
        "seeds": list(comparison.seeds),
        "frame_limit": comparison.frame_limit,
        "versions": versions(),
        "metrics": {metric.path: {"better": metric.better} for metric in METRICS},
        "protocols": {
            protocol.name: {
                "meaning": protocol.meaning,
                "parts": [
                    {
                        "name": case.part,
                        "trained_on_sha256": case.trained_on.digest,
                        "scored_on_sha256": case.scored_on.digest,
                    }
                    for case in protocol.cases
                ],
            }
            for protocol in comparison.protocols
        },
        "methods": {
            method: {
                protocol: {**comparison.summary(outcomes), "outcomes": [_outcome(o) for o in outcomes]}
                for protocol, outcomes in of_method.items()
            }
            for method, of_method in results.items()
        },
    }


def _outcome(outcome: Outcome) -> dict:
    identity, evaluation = {"part": outcome.case.part, "seed": outcome.seed}, outcome.evaluation
    if evaluation is None:
        return {**identity, "error": outcome.error}
    figures = {"frames": len(evaluation.p_HF), "remembers": evaluation.remembers}
    return {**identity, **figures, "metrics": evaluation.metrics}


def tables(comparison: Comparison, results: Results) -> Iterator[Group]:
    """Yields for each protocol its meaning and a few tables with methods as rows.

    The first row of a method is its mean; the worst part and the worst seed follow, if there are several. If
    cases failed, the row states how many succeeded. Empty columns are left out.
    """
    for protocol in comparison.protocols:
        rows = [
            row
            for method, of_method in results.items()
            for row in _rows(comparison, Path(method).name, of_method[protocol.name])
        ]
        heading = Rule(f"{comparison.hand.description.name}: {protocol.title}", align="left")
        drawn = [_table(title, columns, rows) for title, columns in TABLES.items()]
        yield Group(heading, Padding(Text(protocol.meaning), (0, 0, 1, 0)), *filter(None, drawn))


def _table(title: str, columns: Sequence[Metric], rows: Sequence[tuple[str, dict]]) -> Table | None:
    shown = [metric for metric in columns if any(metric.of(figures) is not None for _, figures in rows)]
    if not shown:
        return None
    table = Table(title=title, title_justify="left", box=box.SIMPLE, padding=(0, 1, 0, 0))
    table.add_column("method")
    for metric in shown:
        table.add_column(metric.heading, justify="right", no_wrap=True)
    for label, figures in rows:
        table.add_row(label, *(metric.text(figures) for metric in shown))
    return table


def _rows(comparison: Comparison, label: str, outcomes: Sequence[Outcome]) -> Iterator[tuple[str, dict]]:
    done = sum(outcome.evaluation is not None for outcome in outcomes)
    if done < len(outcomes):
        label += f" ({done} of {len(outcomes)})"
    if not done:
        yield label, mean([])
    for name, figures in comparison.summary(outcomes).items():
        if figures is not None:
            yield (label if name == "mean" else f"  {name.replace('_', ' ')}"), figures


def failures(results: Results) -> Iterator[str]:
    """Yields a line for each failed case: method, part, seed and error."""
    for method, of_method in results.items():
        for outcomes in of_method.values():
            for outcome in outcomes:
                if outcome.evaluation is None:
                    yield f"{Path(method).name}, {outcome.case.part}, seed {outcome.seed}: {outcome.error}"

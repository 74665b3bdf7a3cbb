"""Names and print formats of all metrics, and their mean and worst values."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Metric:
    """A metric.

    Attributes:
        path: keys to its value in the dictionary of metrics, joined by dots.
        heading: heading of its column; empty if it is in no table.
        form: format of its value.
        better: whether higher or lower values are better; None if neither, so there is no worst value.
    """

    path: str
    heading: str = ""
    form: str = "{}"
    better: Literal["higher", "lower"] | None = None

    def of(self, metrics: Mapping) -> float | None:
        """Returns the value in a dictionary of metrics; None if the value or a parent is None."""
        value: Any = metrics
        for key in self.path.split("."):
            if value is None:
                return None
            value = value[key]
        return value

    def text(self, metrics: Mapping) -> str:
        """Formats the value as the cell of a table."""
        value = self.of(metrics)
        return "–" if value is None else self.form.format(value)

    def worst(self, values: Iterable[float | None]) -> float | None:
        """Returns the worst of several values; None if there is none."""
        known = [value for value in values if value is not None]
        if self.better is None or not known:
            return None
        return min(known) if self.better == "higher" else max(known)


# Title of each table → its columns. Every table fits a terminal of 80 characters.
TABLES: dict[str, tuple[Metric, ...]] = {
    "motion": (
        Metric("motion_preservation", "MP", "{:.3f}", "higher"),
        Metric("motion_preservation_track", "track", "{:.3f}", "higher"),
        Metric("cross_talk", "cross\ntalk", "{:.2f}", "lower"),
        Metric("flatness", "flat-\nness", "{:.3f}", "lower"),
        Metric("gain_p95_p5", "gain", "{:.3g}", "lower"),
        Metric("smoothness.mean", "step\nrad", "{:.3f}", "lower"),
        Metric("smoothness.p95", "95 %\nrad", "{:.3f}", "lower"),
        Metric("smoothness.jerk", "jerk\nrad/s³", "{:.0f}", "lower"),
    ),
    "C-space and collision": (
        Metric("coverage.5mm", "cover\n5 mm", "{:.2f}", "higher"),
        Metric("coverage.10mm", "\n10 mm", "{:.2f}", "higher"),
        Metric("coverage.15mm", "\n15 mm", "{:.2f}", "higher"),
        Metric("coverage_context_averaged.10mm", "averaged\n10 mm", "{:.2f}", "higher"),
        Metric("self_collision", "self-\ncollision", "{:.1%}", "lower"),
        Metric("self_collision_raw", "\nraw", "{:.1%}", "lower"),
    ),
    "pinch and latency": (
        Metric("pinch.closed", "pinches\nclosed", "{:.1%}", "higher"),
        Metric("pinch.too_deep", "too\ndeep", "{:.1%}", "lower"),
        Metric("pinch.mean_mm", "mean\nmm", "{:.1f}"),
        Metric("pinch.p95_mm", "95 %\nmm", "{:.1f}", "lower"),
        Metric("pinch.false", "false", "{:.2%}", "lower"),
        Metric("pinch.all_pairs.closed", "all pairs\nclosed", "{:.1%}", "higher"),
        Metric("latency_us.median", "call\nµs", "{:.0f}", "lower"),
        Metric("latency_us.p99", "99 %\nµs", "{:.0f}", "lower"),
    ),
}
METRICS: tuple[Metric, ...] = (
    *(metric for columns in TABLES.values() for metric in columns),
    *(Metric(f"coverage_context_averaged.{r}mm", better="higher") for r in (5, 15)),
    Metric("pinch.frames"),
    Metric("pinch.all_pairs.too_deep", better="lower"),
    Metric("pinch.all_pairs.mean_mm"),
    Metric("pinch.all_pairs.p95_mm", better="lower"),
    Metric("pinch.all_pairs.frames"),
    Metric("smoothness.max", better="lower"),
)


def mean(metrics: Sequence[Mapping]) -> dict:
    """Returns the mean of each metric over the dictionaries that have it, nested like them."""
    values: dict[str, float | None] = {}
    for metric in METRICS:
        known = [value for value in map(metric.of, metrics) if value is not None]
        values[metric.path] = sum(known) / len(known) if known else None
    return _nested(values)


def worst(metrics: Sequence[Mapping]) -> dict:
    """Returns the worst value of each metric, nested like the dictionaries."""
    return _nested({metric.path: metric.worst(map(metric.of, metrics)) for metric in METRICS})


def _nested(values: Mapping[str, float | None]) -> dict:
    result: dict = {}
    for path, value in values.items():
        *folders, name = path.split(".")
        node = result
        for folder in folders:
            node = node.setdefault(folder, {})
        node[name] = value
    return result

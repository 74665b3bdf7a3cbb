"""The progress of a training on the terminal."""

import contextlib
from collections.abc import Callable, Iterator

from torch import nn

from geort_drake.cli.console import progress_bar
from geort_drake.retargeting.training.descent import Report


class TrainingBars:
    """The bars of one training, as a context manager; nothing at all when they are not wanted."""

    def __init__(self, wanted: bool):
        self._progress = progress_bar() if wanted else None

    def __enter__(self) -> "TrainingBars":
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def counter(self, name: str) -> Callable[[int, int], None]:
        """A callback (done, total)."""
        return self._updater(name, lambda _values: "")

    def losses(self, name: str, also: Report | None) -> Report:
        """A callback that shows losses, and tells `also`."""
        shown = ("direction", "matching", "coverage", "pinch", "collision")
        update = self._updater(name, lambda v: "  ".join(f"{key} {v[key]:.3f}" for key in shown if key in v))

        def report(step: int, steps: int, losses: dict[str, float], network: nn.Module) -> None:
            update(step, steps, losses)
            if also is not None:
                also(step, steps, losses, network)

        return report

    @contextlib.contextmanager
    def spinner(self, name: str) -> Iterator[None]:
        """A bar of one step, which the block is."""
        update = self.counter(name)
        update(0, 1)
        yield
        update(1, 1)

    def _updater(self, name: str, note: Callable[[dict], str]) -> Callable:
        task = None

        def update(done: int, total: int, values: dict | None = None) -> None:
            nonlocal task
            if self._progress is None:
                return
            if task is None:
                task = self._progress.add_task(name, total=total, note="")
            self._progress.update(task, completed=done, total=total, note=note(values) if values else "")

        return update

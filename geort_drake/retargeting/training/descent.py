"""Gradient descent shared by all trained methods, with schedule, history and detection of divergence."""

import contextlib
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from geort_drake.errors import TrainingError, UnknownNameError
from geort_drake.retargeting.training.soap import Soap

# Called as report(steps done, total steps, row of losses, current network) at each row of `Descent.history`.
Report = Callable[[int, int, dict[str, float], nn.Module], None]
AVERAGE_EVERY = 5  # steps, within which weights hardly move


@dataclass(frozen=True)
class Descent:
    """Figures of a descent."""

    # Rows of step, total, each loss and seconds: about a hundred at equal intervals, and after 1, 2, 4, ...
    # steps at first.
    history: list[dict[str, float]]
    seconds: float  # wall time, s
    stopped_at: int | None  # the step at which the loss or the weights stopped being finite


def descend(
    network: nn.Module,
    losses: Callable[[int], tuple[torch.Tensor, dict[str, torch.Tensor]]],
    steps: int,
    learning_rate: float,
    report: Report | None = None,
    optimiser: torch.optim.Optimizer | Soap | None = None,
    warm_up: int = 0,
    averaging: float = 0.0,
    is_fixed: bool = True,
) -> Descent:
    """Minimises a loss; the learning rate falls to zero along half a cosine.

    If the loss stops being finite, the descent ends with a RuntimeWarning and restores weights from at most a
    hundredth of the descent earlier. A fixed loss that does not fall causes a RuntimeWarning too.

    Args:
        network: the network, trained in place.
        losses: called with the number of the step; returns the loss and its terms.
        steps: number of gradient steps.
        learning_rate: learning rate of the first step after the warm-up.
        report: see `Report`.
        optimiser: optimiser of the network's parameters; by default Adam.
        warm_up: number of steps in which the learning rate rises from zero.
        averaging: decay per step of a moving average of the weights over the second half, which the network
            gets at the end. With 0 it keeps the last weights.
        is_fixed: whether the loss is the same function at all steps, without adaptive multipliers.

    Raises:
        TrainingError: the loss is not finite at the first step.
    """
    optimiser = optimiser or torch.optim.Adam(network.parameters(), lr=learning_rate)
    average = None
    if averaging:
        average = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(averaging**AVERAGE_EVERY))
    history: list[dict[str, float]] = []
    interval = max(steps // 100, 1)
    good: dict | None = None
    stopped_at = None
    started = time.perf_counter()
    for step in range(steps):
        rate = learning_rate * 0.5 * (1.0 + math.cos(math.pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = rate * min((step + 1) / (warm_up + 1), 1.0)
        total, row = losses(step)
        if not torch.isfinite(total):
            stopped_at = step
            break
        if step % interval == 0:
            good = {name: value.clone() for name, value in network.state_dict().items()}
        network.zero_grad()
        total.backward()
        optimiser.step()
        if average is not None and 2 * step >= steps and (steps - 1 - step) % AVERAGE_EVERY == 0:
            average.update_parameters(network)
        doubled = step < interval and (step + 1) & step == 0
        if step % interval == 0 or doubled or step == steps - 1:
            values = {name: float(value.detach()) for name, value in row.items()}
            values = {"step": step, "total": float(total.detach()), **values}
            values["seconds"] = round(time.perf_counter() - started, 3)
            history.append(values)
            if report is not None:
                report(step + 1, steps, values, network)
    # No loss was computed with the weights of the last step.
    if stopped_at is None and not all(torch.isfinite(p).all() for p in network.parameters()):
        stopped_at = steps
    if stopped_at is not None:
        if good is None:
            raise TrainingError("the loss is not finite at the first step; check the weights and the data")
        network.load_state_dict(good)
        warnings.warn(
            f"the loss stopped being finite at step {stopped_at} of {steps}; the last good weights are "
            "kept. A lower learning rate may help.",
            RuntimeWarning,
            stacklevel=3,
        )
        return Descent(history, time.perf_counter() - started, stopped_at)
    if is_fixed and len(history) >= 100:
        # A saturated map has a finite loss, but no longer learns.
        last = sum(row["total"] for row in history[-10:]) / 10
        if last >= history[0]["total"]:
            warnings.warn(
                f"the loss did not fall: {history[0]['total']:.3g} at the start, {last:.3g} at the end. "
                "A lower learning rate may help.",
                RuntimeWarning,
                stacklevel=3,
            )
    if average is not None and steps > 1:
        network.load_state_dict(average.module.state_dict())
    return Descent(history, time.perf_counter() - started, stopped_at)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limits torch to one CPU thread; the matrices are too small to gain from more."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def device_of(name: str) -> torch.device:
    """Returns the torch device "cpu" or "cuda".

    Raises:
        UnknownNameError: the name is another.
        TrainingError: torch sees no CUDA device.
    """
    if name not in ("cpu", "cuda"):
        raise UnknownNameError("device", name, ("cpu", "cuda"))
    if name == "cuda" and not torch.cuda.is_available():
        raise TrainingError("device 'cuda': this machine's torch finds no CUDA device")
    return torch.device(name)

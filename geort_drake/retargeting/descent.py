"""Gradient descent, shared by the methods that train a map of one person."""

import contextlib
from collections.abc import Callable, Iterator

import torch

from geort_drake.errors import TrainingError, UnknownNameError

Losses = dict[str, tuple[float, torch.Tensor]]  # name → weight and value
Report = Callable[[int, int, dict[str, float]], None]  # (steps done, total steps, row of losses)


def minimise(
    model: torch.nn.Module,
    losses: Callable[[], Losses],
    steps: int,
    rate: float,
    report: Report | None = None,
) -> list[dict[str, float]]:
    """Minimises the sum of weighted losses by Adam, whose learning rate falls to zero along half a cosine.

    Returns:
        About a hundred rows of step, total and each loss without its weight.

    Raises:
        TrainingError: the total is not finite at some step.
    """
    optimiser = torch.optim.Adam(model.parameters(), lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    history = []
    for step in range(steps):
        terms = losses()
        total = torch.stack([weight * loss for weight, loss in terms.values()]).sum()
        if not torch.isfinite(total):
            raise TrainingError(f"the loss is not finite at step {step} of {steps}; lower the learning rate")
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        schedule.step()
        if step % max(steps // 100, 1) == 0 or step == steps - 1:
            row = {name: float(loss.detach()) for name, (_, loss) in terms.items()}
            history.append({"step": step, "total": float(total.detach()), **row})
            if report is not None:
                report(step + 1, steps, history[-1])
    return history


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

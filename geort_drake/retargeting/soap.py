"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

For matrices of a small network it needs about a third of Adam's steps. The layers of all fingers are stacked
along a first axis, and each finger's matrix keeps bases of its own.
"""

from collections.abc import Iterable
from typing import Any

import torch


class Soap(torch.optim.Optimizer):
    """Minimises over parameters (..., a, b); every leading index is a matrix by itself."""

    def __init__(
        self,
        parameters: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.99),
        basis_beta: float = 0.95,
        eps: float = 1e-8,
        weight_decay: float = 0.01,
        refresh: int = 10,
    ):
        """`betas` are Adam's, `basis_beta` averages what the bases are of, renewed every `refresh` steps."""
        defaults = {"lr": lr, "betas": betas, "basis_beta": basis_beta, "eps": eps}
        super().__init__(parameters, defaults | {"weight_decay": weight_decay, "refresh": refresh})

    @torch.no_grad()
    def step(self, closure: object = None) -> None:  # type: ignore[override]
        """One step along the gradients; `closure` is not supported."""
        if closure is not None:
            raise ValueError("Soap takes no closure")
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._move(parameter, parameter.grad, group)

    def _move(self, parameter: torch.Tensor, gradient: torch.Tensor, group: dict) -> None:
        state = self.state[parameter]
        # A row, such as a layer's biases, has one basis that is worth as little as its axes: plain Adam.
        matrix = min(gradient.shape[-2:]) > 1
        squares = (gradient @ gradient.mT, gradient.mT @ gradient) if matrix else ()
        if not state:
            state["step"] = 0
            state["squares"] = list(squares)
            state["bases"] = [torch.linalg.eigh(square).eigenvectors for square in squares]
            state["mean"], state["variance"] = torch.zeros_like(gradient), torch.zeros_like(gradient)
        state["step"] += 1
        first, second = group["betas"]
        mean = state["mean"].lerp_(gradient, 1.0 - first)
        if matrix:
            left, right = state["bases"]
            gradient, mean = left.mT @ gradient @ right, left.mT @ mean @ right
        state["variance"].mul_(second).addcmul_(gradient, gradient, value=1.0 - second)
        deviation = (state["variance"] / (1.0 - second ** state["step"])).sqrt_().add_(group["eps"])
        move = mean / deviation / (1.0 - first ** state["step"])
        if matrix:
            move = left @ move @ right.mT
        parameter.mul_(1.0 - group["lr"] * group["weight_decay"])
        parameter.sub_(move, alpha=group["lr"])
        for average, square in zip(state["squares"], squares, strict=True):
            average.lerp_(square, 1.0 - group["basis_beta"])
        if state["step"] % group["refresh"] == 0:
            # A step of power iteration keeps the basis near the eigenvectors, far cheaper than finding them.
            pairs = zip(state["squares"], state["bases"], strict=True)
            state["bases"] = [torch.linalg.qr(square @ basis).Q for square, basis in pairs]

"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

Small networks need fewer steps than with Adam. The layers of all fingers are stacked along a first axis;
each finger's matrix has its own bases.
"""

import math
from collections.abc import Iterable
from typing import Any

import torch

BASIS_BETA = 0.95  # decay of the averages whose eigenvectors are the bases
REFRESH = 10  # steps between updates of the bases


class Soap(torch.optim.Optimizer):
    """Optimises parameters (..., a, b); leading indices number independent matrices G.

    Each matrix has a basis for each side: the eigenvectors of the averaged G Gᵀ and Gᵀ G of its gradients.
    Vectors, such as biases, have none.
    """

    def __init__(
        self,
        params: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.99),
        eps: float = 1e-8,
        weight_decay: float = 0.01,
        clip: float = math.inf,
    ):
        """Takes parameters, or groups of them with settings that differ from the arguments.

        Args:
            lr: learning rate.
            betas: decay rates of Adam's averages.
            eps: keeps Adam from dividing by zero.
            weight_decay: weight decay, decoupled from the gradients.
            clip: largest norm of all gradients together.
        """
        super().__init__(params, {"lr": lr, "betas": betas, "eps": eps, "weight_decay": weight_decay})
        self._clip = clip

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]
        """Takes one step along the gradients, which every parameter must have."""
        gradients = [[p.grad.reshape(-1) for p in group["params"]] for group in self.param_groups]
        norm = torch.stack([torch.cat(each).norm() for each in gradients]).norm()
        factor = (self._clip / (norm + 1e-6)).clamp(max=1.0)
        for group in self.param_groups:
            for parameter in group["params"]:
                self._move(parameter, parameter.grad * factor, **group)

    def _move(
        self,
        parameter: torch.Tensor,
        gradient: torch.Tensor,
        lr: float,
        betas: tuple[float, float],
        eps: float,
        weight_decay: float,
        **_: Any,
    ) -> None:
        G, state = gradient.reshape(-1, *gradient.shape[-2:]), self.state[parameter]
        if not state:
            state |= {"steps": 0, "mean": torch.zeros_like(G), "variance": torch.zeros_like(G)}
            state["squares"] = [G @ G.mT, G.mT @ G] if min(G.shape[-2:]) > 1 else []
            state["bases"] = [torch.linalg.eigh(square).eigenvectors for square in state["squares"]]
        squares, bases = state["squares"], state["bases"]

        def into_bases(x: torch.Tensor) -> torch.Tensor:
            return bases[0].mT @ x @ bases[1] if bases else x

        state["steps"] += 1
        first, second = betas
        state["mean"].lerp_(G, 1.0 - first)
        rotated = into_bases(G)
        state["variance"].mul_(second).addcmul_(rotated, rotated, value=1.0 - second)
        deviation = (state["variance"] / (1.0 - second ** state["steps"])).sqrt_().add_(eps)
        move = into_bases(state["mean"]) / deviation
        if bases:
            move = bases[0] @ move @ bases[1].mT
        parameter.mul_(1.0 - lr * weight_decay)
        parameter.sub_(move.view_as(parameter), alpha=lr / (1.0 - first ** state["steps"]))
        for square, a in zip(squares, (G, G.mT), strict=False):
            square.baddbmm_(a, a.mT, beta=BASIS_BETA, alpha=1.0 - BASIS_BETA)
        if state["steps"] % REFRESH == 0:
            # A step of power iteration is far cheaper than an eigendecomposition.
            state["bases"] = [torch.linalg.qr(s @ basis).Q for s, basis in zip(squares, bases, strict=True)]

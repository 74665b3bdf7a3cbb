"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

Small networks need fewer steps than with Adam. The layers of all fingers are stacked along a first axis;
each finger's matrix has its own bases.
"""

from typing import Any

import torch

BASIS_BETA = 0.95  # decay of the averages whose eigenvectors are the bases
EPS = 1e-8  # keeps Adam from dividing by zero
REFRESH = 10  # steps between updates of the bases


class Soap(torch.optim.Optimizer):
    """Optimises parameters (..., a, b); leading indices number independent matrices G.

    Each matrix has a basis for each side: the eigenvectors of the averaged G Gᵀ and Gᵀ G of its gradients.
    Vectors, such as biases, have none.
    """

    def __init__(self, groups: list[dict[str, Any]], lr: float, betas: tuple[float, float], clip: float):
        """Takes groups of parameters, each with its `weight_decay`, which is decoupled from the gradients.

        Args:
            lr: learning rate.
            betas: decay rates of Adam's averages.
            clip: largest norm of all gradients together.
        """
        super().__init__(groups, {"lr": lr})
        self._betas, self._clip = betas, clip

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]
        """Takes one step along the gradients, which every parameter must have."""
        gradients = [[p.grad.reshape(-1) for p in group["params"]] for group in self.param_groups]
        norm = torch.stack([torch.cat(each).norm() for each in gradients]).norm()
        factor = (self._clip / (norm + 1e-6)).clamp(max=1.0)
        for group in self.param_groups:
            for parameter in group["params"]:
                self._move(parameter, parameter.grad * factor, group["lr"], group["weight_decay"])

    def _move(self, parameter: torch.Tensor, gradient: torch.Tensor, lr: float, weight_decay: float) -> None:
        G, state = gradient.reshape(-1, *gradient.shape[-2:]), self.state[parameter]
        if not state:
            state |= {"steps": 0, "mean": torch.zeros_like(G), "variance": torch.zeros_like(G)}
            state["squares"] = [G @ G.mT, G.mT @ G] if min(G.shape[-2:]) > 1 else []
            state["bases"] = [torch.linalg.eigh(square).eigenvectors for square in state["squares"]]
        squares, bases = state["squares"], state["bases"]

        def into_bases(x: torch.Tensor) -> torch.Tensor:
            return bases[0].mT @ x @ bases[1] if bases else x

        state["steps"] += 1
        first, second = self._betas
        state["mean"].lerp_(G, 1.0 - first)
        rotated = into_bases(G)
        state["variance"].mul_(second).addcmul_(rotated, rotated, value=1.0 - second)
        deviation = (state["variance"] / (1.0 - second ** state["steps"])).sqrt_().add_(EPS)
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

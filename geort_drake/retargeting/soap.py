"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

Small networks need fewer steps than with Adam. The layers of all fingers are stacked along a first axis;
each finger's matrix has its own bases.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import torch

BASIS_BETA = 0.95  # decay of the averages whose eigenvectors are the bases
REFRESH = 10  # steps between updates of the bases


class Soap:
    """Optimises parameters (..., a, b); leading indices number independent matrices.

    It is used like torch's optimisers, but not derived from their base class, whose import takes a second.

    Attributes:
        param_groups: dicts of "params" and their settings, which may change between steps.
    """

    def __init__(
        self,
        parameters: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.99),
        eps: float = 1e-8,
        weight_decay: float = 0.01,
        clip: float = math.inf,
    ):
        """Takes parameters, or dicts of "params" and settings that differ from the arguments.

        Args:
            lr: learning rate.
            betas: decay rates of Adam's averages.
            eps: keeps Adam from dividing by zero.
            weight_decay: weight decay, decoupled from the gradients.
            clip: largest norm of all gradients together.
        """
        defaults: dict[str, Any] = {"lr": lr, "betas": betas, "eps": eps, "weight_decay": weight_decay}
        entries: list[Any] = list(parameters)
        groups = entries if isinstance(entries[0], dict) else [{"params": entries}]
        self.param_groups = [{**defaults, **group, "params": list(group["params"])} for group in groups]
        self._clip = clip
        self._states = [_State(group["params"]) for group in self.param_groups]

    @torch.no_grad()
    def step(self) -> None:
        """Takes one step along the gradients.

        Raises:
            ValueError: a parameter has no gradient.
        """
        gradients = [_flat([_gradient(parameter) for parameter in g["params"]]) for g in self.param_groups]
        if math.isfinite(self._clip):
            norm = torch.stack([gradient.norm() for gradient in gradients]).norm()
            factor = (self._clip / (norm + 1e-6)).clamp(max=1.0)
            for gradient in gradients:
                gradient.mul_(factor)
        for group, state, gradient in zip(self.param_groups, self._states, gradients, strict=True):
            state.move(gradient, **group)

    def state_dict(self) -> list[dict[str, Any]]:
        """Returns the averages, bases and numbers of steps of all groups, for files."""
        return [state.state_dict() for state in self._states]

    def load_state_dict(self, states: Sequence[dict[str, Any]]) -> None:
        """Restores the result of `state_dict` of an optimiser of equal parameters."""
        for state, saved in zip(self._states, states, strict=True):
            state.load_state_dict(saved)


class _State:
    """The state of a group of parameters.

    Elementwise operations treat all parameters at once, because the number of calls determines the time.
    """

    def __init__(self, parameters: Sequence[torch.Tensor]):
        self._shapes = [(-1, *parameter.shape[-2:]) for parameter in parameters]
        self._sizes = [parameter.numel() for parameter in parameters]
        self._steps = 0
        self._mean, self._variance = torch.zeros_like(_flat(parameters)), torch.zeros_like(_flat(parameters))
        self._means = self._parts(self._mean)
        self._bases: list[_Bases] = []

    def state_dict(self) -> dict[str, Any]:
        bases = [basis.tensors for basis in self._bases]
        return {"steps": self._steps, "mean": self._mean, "variance": self._variance, "bases": bases}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        self._steps = saved["steps"]
        self._mean.copy_(saved["mean"])
        self._variance.copy_(saved["variance"])
        self._bases = [_Bases.of(tensors) for tensors in saved["bases"]]

    def _parts(self, flat: torch.Tensor) -> list[torch.Tensor]:
        """Returns views (M, a, b) of the parts of each parameter."""
        return [part.view(shape) for part, shape in zip(flat.split(self._sizes), self._shapes, strict=True)]

    def move(
        self,
        flat: torch.Tensor,
        params: Sequence[torch.Tensor],
        lr: float,
        betas: tuple[float, float],
        eps: float,
        weight_decay: float,
    ) -> None:
        """Moves the parameters, given all of their gradients as one vector."""
        gradients = self._parts(flat)
        if not self._bases:
            self._bases = [_Bases(gradient) for gradient in gradients]
        bases = self._bases
        self._steps += 1
        first, second = betas
        self._mean.lerp_(flat, 1.0 - first)
        rotated = _flat([basis.into(gradient) for basis, gradient in zip(bases, gradients, strict=True)])
        mean = _flat([basis.into(part) for basis, part in zip(bases, self._means, strict=True)])
        self._variance.mul_(second).addcmul_(rotated, rotated, value=1.0 - second)
        deviation = (self._variance / (1.0 - second**self._steps)).sqrt_().add_(eps)
        moves = self._parts(mean.div_(deviation))
        rate = lr / (1.0 - first**self._steps)
        for parameter, gradient, basis, move in zip(params, gradients, bases, moves, strict=True):
            parameter.mul_(1.0 - lr * weight_decay)
            parameter.sub_(basis.out(move).view_as(parameter), alpha=rate)
            basis.average(gradient, 1.0 - BASIS_BETA)
            if self._steps % REFRESH == 0:
                basis.refresh()


class _Bases:
    """Eigenvectors of the averaged G Gᵀ and Gᵀ G of gradients G (M, a, b): a basis for each side.

    Vectors, such as biases, have no bases.
    """

    def __init__(self, gradient: torch.Tensor):
        self._matrix = min(gradient.shape[-2:]) > 1
        if self._matrix:
            self._squares = [torch.bmm(gradient, gradient.mT), torch.bmm(gradient.mT, gradient)]
            self._left, self._right = (torch.linalg.eigh(square).eigenvectors for square in self._squares)

    @property
    def tensors(self) -> list[torch.Tensor]:
        """The averages and the bases; empty for a vector."""
        return [*self._squares, self._left, self._right] if self._matrix else []

    @classmethod
    def of(cls, tensors: Sequence[torch.Tensor]) -> "_Bases":
        """Makes the bases from `tensors`."""
        bases = cls.__new__(cls)
        bases._matrix = bool(tensors)
        if tensors:
            first, second, bases._left, bases._right = tensors
            bases._squares = [first, second]
        return bases

    def into(self, x: torch.Tensor) -> torch.Tensor:
        """Transforms x (M, a, b) into the bases."""
        return torch.bmm(torch.bmm(self._left.mT, x), self._right) if self._matrix else x

    def out(self, x: torch.Tensor) -> torch.Tensor:
        """Transforms x (M, a, b) from the bases back to the original axes."""
        return torch.bmm(torch.bmm(self._left, x), self._right.mT) if self._matrix else x

    def average(self, gradient: torch.Tensor, weight: float) -> None:
        """Adds a gradient to the averages."""
        if self._matrix:
            for square, (a, b) in zip(
                self._squares, ((gradient, gradient.mT), (gradient.mT, gradient)), strict=True
            ):
                square.baddbmm_(a, b, beta=1.0 - weight, alpha=weight)

    def refresh(self) -> None:
        """Updates the bases by a step of power iteration, far cheaper than an eigendecomposition."""
        if self._matrix:
            bases = zip(self._squares, (self._left, self._right), strict=True)
            self._left, self._right = (torch.linalg.qr(torch.bmm(*pair)).Q for pair in bases)


def _gradient(parameter: torch.Tensor) -> torch.Tensor:
    if parameter.grad is None:
        raise ValueError("Soap needs the gradient of every parameter")
    return parameter.grad


def _flat(tensors: Sequence[torch.Tensor]) -> torch.Tensor:
    return torch.cat([tensor.reshape(-1) for tensor in tensors])

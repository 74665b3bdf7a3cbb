"""Trains networks on robot data alone: neural forward kinematics and the collision classifier."""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.networks import CollisionClassifier, NeuralKinematics

HELD_OUT = 0.1  # fraction of the robot samples that is excluded from training
_HIDDEN = 128  # width of hidden layers


def fit_neural_kinematics(
    kinematics: HandKinematics,
    q: np.ndarray,
    generator: torch.Generator,
    device: torch.device,
    steps: int,
) -> tuple[NeuralKinematics, dict[str, float]]:
    """Fits the map from joint angles q (N, n), rad, to fingertips by least squares.

    Returns:
        The frozen network, and its errors on held-out samples: mean_mm, p95_mm, max_mm.
    """
    q_exact = torch.tensor(q, dtype=torch.float64)
    p = kinematics.fingertips(q_exact).float()
    held_out = int(len(q) * HELD_OUT)
    model = NeuralKinematics(kinematics, p, _HIDDEN, generator).to(device)
    x, p = q_exact.float().to(device), p.to(device)
    unit = model.scale.mean()

    def loss(rows: torch.Tensor) -> torch.Tensor:
        return ((model.fingertips(x[rows]) - p[rows]) / unit).square().sum(-1).mean()

    _descend(model, loss, held_out, len(q), generator, device, steps, 512, 5e-3)
    with torch.no_grad():
        error = torch.linalg.vector_norm(model.fingertips(x[:held_out]) - p[:held_out], dim=-1)
    millimetres = 1000.0 * error.cpu().double().numpy().ravel()
    return model, {
        "mean_mm": float(millimetres.mean()),
        "p95_mm": float(np.percentile(millimetres, 95)),
        "max_mm": float(millimetres.max()),
    }


def fit_classifier(
    kinematics: HandKinematics,
    samples: np.ndarray,
    labels: np.ndarray,
    generator: torch.Generator,
    device: torch.device,
    steps: int,
) -> tuple[CollisionClassifier, dict[str, float]]:
    """Fits the probability of a collision at samples (N, n), rad, to their labels (N,) by cross-entropy.

    Returns:
        The frozen network, and figures on held-out samples: accuracy, precision, recall, positive_share.
    """
    q = torch.tensor(samples, dtype=torch.float32, device=device)
    label = torch.tensor(np.asarray(labels), dtype=torch.float32, device=device)
    held_out = int(len(q) * HELD_OUT)
    model = CollisionClassifier(kinematics, _HIDDEN, generator).to(device)

    def loss(rows: torch.Tensor) -> torch.Tensor:
        return binary_cross_entropy_with_logits(model(q[rows]), label[rows])

    _descend(model, loss, held_out, len(q), generator, device, steps, 1024, 5e-3)
    with torch.no_grad():
        positive, truth = model(q[:held_out]) > 0, label[:held_out] > 0.5
    hits = int((positive & truth).sum())
    return model, {
        "accuracy": float((positive == truth).float().mean()),
        "precision": hits / max(int(positive.sum()), 1),
        "recall": hits / max(int(truth.sum()), 1),
        "positive_share": float(truth.float().mean()),
    }


def refit_classifier(
    model: CollisionClassifier,
    uniform: tuple[torch.Tensor, torch.Tensor],
    own: tuple[torch.Tensor, torch.Tensor],
    generator: torch.Generator,
    steps: int,
) -> None:
    """Continues the fit in place, half on `uniform` and half on `own` samples, each a pair (q, label)."""
    device = own[0].device

    def loss(_rows: torch.Tensor) -> torch.Tensor:
        parts = []
        for q, label in (uniform, own):
            rows = torch.randint(len(q), (512,), generator=generator).to(device)
            parts.append(binary_cross_entropy_with_logits(model(q[rows]), label[rows]))
        return 0.5 * (parts[0] + parts[1])

    _descend(model, loss, 0, 1, generator, device, steps, 1, 2e-3)


def _descend(
    model: torch.nn.Module,
    loss: Callable[[torch.Tensor], torch.Tensor],
    first: int,
    last: int,
    generator: torch.Generator,
    device: torch.device,
    steps: int,
    batch: int,
    rate: float,
) -> None:
    """Runs Adam with a cosine schedule over random rows in [first, last), then freezes the model."""
    model.requires_grad_(True)
    optimiser = torch.optim.Adam(model.parameters(), lr=rate)
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = rate * 0.5 * (1.0 + math.cos(math.pi * step / steps))
        rows = torch.randint(first, last, (batch,), generator=generator).to(device)
        value = loss(rows)
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        optimiser.step()
    model.requires_grad_(False)

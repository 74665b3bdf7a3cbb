"""SOAP on problems whose answer is known."""

import torch

from geort_drake.retargeting.training.soap import Soap


def descended(optimiser_of, start, loss, steps):
    parameter = torch.nn.Parameter(start.clone())
    optimiser = optimiser_of([parameter])
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = 0.05 * (1.0 - step / steps)
        parameter.grad = None
        loss(parameter).backward()
        optimiser.step()
    return parameter.detach()


def skewed(generator, rows=6, columns=5):
    """|A W B − C|², whose curvatures lie a thousandfold apart along directions that are no coordinates."""
    A, B = (torch.randn(n, n, generator=generator, dtype=torch.float64) for n in (rows, columns))
    u, _, v = torch.linalg.svd(A)
    A = u @ torch.diag(torch.logspace(0, -1.5, rows, dtype=torch.float64)) @ v
    answer = torch.randn(rows, columns, generator=generator, dtype=torch.float64)
    C = A @ answer @ B
    return lambda W: (A @ W @ B - C).square().mean()


def test_it_descends_where_adam_crawls():
    """Far from coordinate axes the eigenbasis pays: less than half of the loss that Adam leaves."""
    generator = torch.Generator().manual_seed(0)
    loss = skewed(generator)
    start = torch.zeros(6, 5, dtype=torch.float64)
    soap = descended(lambda p: Soap(p, lr=0.05, weight_decay=0.0), start, loss, 300)
    adam = descended(lambda p: torch.optim.Adam(p, lr=0.05, betas=(0.9, 0.99)), start, loss, 300)
    assert loss(soap) < 0.5 * loss(adam) < 0.5 * loss(start)


def test_stacked_matrices_do_not_see_each_other():
    """Two matrices in one parameter end where each ends by itself."""
    generator = torch.Generator().manual_seed(1)
    first, second = skewed(generator), skewed(generator)
    start = torch.randn(2, 6, 5, generator=generator, dtype=torch.float64)

    def soap(parameters):
        return Soap(parameters, lr=0.05)

    together = descended(soap, start, lambda W: first(W[0]) + second(W[1]), 60)
    for k, loss in enumerate((first, second)):
        torch.testing.assert_close(together[k], descended(soap, start[k], loss, 60), atol=1e-4, rtol=0)


def test_gradients_are_clipped_together():
    """A gradient a thousand times too long moves as one of the greatest length does, in all groups."""

    def ends(factor):
        parameters = [torch.nn.Parameter(torch.ones(2, 3, 4)), torch.nn.Parameter(torch.ones(1, 4))]
        soap = Soap([{"params": [p], "weight_decay": 0.0} for p in parameters], lr=0.1, eps=1.0, clip=0.5)
        generator = torch.Generator().manual_seed(0)
        for _ in range(3):
            gradients = [torch.randn(p.shape, generator=generator) for p in parameters]
            length = torch.cat([g.flatten() for g in gradients]).norm()
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = factor * 0.5 / length * gradient
            soap.step()
        return [p.detach() for p in parameters]

    for clipped, longest, shorter in zip(ends(1000.0), ends(1.0), ends(0.5), strict=True):
        torch.testing.assert_close(clipped, longest, atol=1e-5, rtol=0)
        assert (shorter - longest).abs().max() > 1e-3

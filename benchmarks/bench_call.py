"""Times one retargeting call against its bare arithmetic and other retargeters, in turns.

python benchmarks/bench_call.py --json call.json

Every function gets the frames of the same motion in order, and returns joint angles, in NumPy. Rows:
  call                 this package's call on the fingertips, all checks on; the reference of the ratios
  call, whole hand     the same on 21 keypoints
  bare arithmetic      only the products of the call's weights with vectors, by BLAS
  published, PyTorch   one network per finger with batch normalisation, as the paper's authors run it
  the same without gradients   in PyTorch's no_grad, which the authors do not use
  dex-retargeting ...  that package's optimisers, if it is installed (pip install dex-retargeting six)
--scaling times hands with more fingers and larger batches instead.
"""

import argparse
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from dex_package import TYPES, make_dex_retargeter
from side_by_side import measure, parse, parser, report
from untrained import FINGERS, add_form_option, untrained

from geort_drake.console import console, run_main
from geort_drake.hands.description import load_hand
from geort_drake.hands.hand import Hand
from geort_drake.people.readers import read_recording
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.mlp import MlpRetargeter

HAND = "allegro_right"


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    add_form_option(options)
    options.add_argument("--recording", type=Path, help="recording of a right hand (default: synthetic play)")
    options.add_argument("--scaling", action="store_true", help="time larger hands and batches")
    arguments = parse(options, argv)
    torch.set_num_threads(1)
    recording = (
        read_recording(arguments.recording, "right")
        if arguments.recording
        else synthesize_play(seed=0, duration_s=120.0, rate_hz=30.0)
    )
    hands = recording.p_HK[recording.valid].astype(float)
    if arguments.scaling:
        grow(arguments, hands)
        return 0
    retarget = untrained(arguments.method)
    description = load_hand(HAND)
    tips = hands[:, description.human_keypoints]
    published = Published(tips)
    functions = {
        "call": over(retarget, tips),
        "call, whole hand": over(retarget, hands),
        "bare arithmetic": over(bare_arithmetic(retarget), tips.reshape(-1, 12)),
        "published, PyTorch": over(published, tips),
        "the same without gradients": over(torch.no_grad()(published), tips),
        **dex_retargeting(description, hands),
    }
    results = measure(functions, arguments.seconds)
    report(f"one call of {arguments.method}", results, "call", arguments.json)
    return 0


def over(function: Callable[[np.ndarray], object], frames: np.ndarray) -> Callable[[], object]:
    """Returns a function without arguments that takes the next frame at each call."""
    ever = itertools.cycle(list(frames))
    return lambda: function(next(ever))


def bare_arithmetic(retarget: MlpRetargeter) -> Callable[[np.ndarray], np.ndarray]:
    """Returns a function that multiplies a vector (12,) by the weights, in the fewest calls of BLAS."""
    first, own, residual, last = (
        np.ascontiguousarray(getattr(retarget, f"_{name}"))
        for name in ("weight0", "weight1", "residual1", "weight2")
    )
    h, u, y = np.empty(len(last)), np.empty(len(last)), np.empty(16)
    count, width = own.shape[:2]
    start, apart = count * width, (count, 1, width)
    h_own, u_own = h[:start].reshape(apart), u[:start].reshape(apart)
    h_shared, u_shared = h[start:], u[start:]

    def products(x: np.ndarray) -> np.ndarray:
        np.dot(x, first, h)
        np.matmul(h_own, own, u_own)
        if residual.size:
            np.dot(h_shared, residual, u_shared)
        return np.dot(u, last, y)

    return products


class Published:
    """The retargeter of the paper: NumPy in and out, PyTorch between.

    The paper specifies independent networks for each finger with a final tanh. The authors' released code
    adds the sizes 3 → 128 → 128 → n, batch normalisation after both hidden layers, and evaluation while
    PyTorch records gradients.
    """

    def __init__(self, tips: np.ndarray):
        """`tips` (T, 4, 3), m, are frames that set the statistics of the normalisation."""
        nn = torch.nn
        with torch.random.fork_rng(devices=[]):  # layers take their weights from no other generator
            torch.manual_seed(0)
            self.networks = nn.ModuleList(
                nn.Sequential(
                    nn.Linear(3, 128), nn.LeakyReLU(), nn.BatchNorm1d(128),
                    nn.Linear(128, 128), nn.LeakyReLU(), nn.BatchNorm1d(128),
                    nn.Linear(128, 4), nn.Tanh(),
                )
                for _ in range(4)
            )  # fmt: skip
        with torch.no_grad():
            for i, network in enumerate(self.networks):
                network(torch.tensor(tips[:, i]).float())
        self.networks.eval()
        self.lower, self.upper = -np.ones(16), np.ones(16)

    def __call__(self, p_HF: np.ndarray) -> np.ndarray:
        """Returns joint angles (16,), rad, for fingertips (4, 3), m."""
        x = torch.from_numpy(p_HF[None]).float()
        y = torch.cat([network(x[:, i]) for i, network in enumerate(self.networks)], dim=-1)
        return self.lower + 0.5 * (y[0].detach().numpy() + 1.0) * (self.upper - self.lower)


def dex_retargeting(description, hands: np.ndarray) -> dict[str, Callable[[], object]]:
    """Returns the package's optimisers on hands (T, 21, 3); none if it is not installed."""
    hand, functions = Hand(description), {}
    for name, kind in TYPES.items():
        ours = METHODS[name].fit(hand)
        try:
            theirs = make_dex_retargeter(name, hand, ours.huber_delta)
        except ImportError as error:
            console.print(f"without dex-retargeting: {error}")
            return {}
        origin, tip = theirs.optimizer.target_link_human_indices
        functions[f"dex-retargeting {kind}"] = over(theirs.retarget, hands[:, tip] - hands[:, origin])
    return functions


def grow(arguments: argparse.Namespace, hands: np.ndarray) -> None:
    """Times hands of two to five fingers, and batches; ratios are to a single hand of the Allegro's size."""
    names = list(FINGERS)
    functions = {
        f"{count} fingers": over(
            untrained(arguments.method, count),
            hands[:, list(FINGERS.values())[:count]],
        )
        for count in (4, 2, 3, len(names))
    }
    retarget = untrained(arguments.method)
    for size in (10, 100, 1000, 5000):
        functions[f"batch of {size:,}"] = lambda batch=hands[:size]: retarget(batch)
    results = measure(functions, arguments.seconds)
    report(f"{arguments.method} as the work grows", results, "4 fingers", arguments.json)


if __name__ == "__main__":
    run_main(main)

"""Times whole trainings of the default method against the public recipe of the paper's authors.

python benchmarks/bench_training.py --recording human_alex.npy --json training.json

Rows, in wall time:
  geort_coupled   from the recording to the weights, including robot samples
  refit           from the universal map to one person's, with the default number of steps
  public recipe   50 epochs of 25 batches of 2,048, each finger's points drawn independently, the Chamfer term
                  over all distances between two clouds; written from the paper. A few batches are timed
                  before and after each training and extrapolated; its pretraining is left out, in its favour
"""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from bench_call import HAND, Published
from rich.table import Table
from side_by_side import parse, parser, write_json

from geort_drake.comparison.refit import refit_checkpoint
from geort_drake.comparison.train import train_checkpoint
from geort_drake.console import console, run_main
from geort_drake.hands.description import load_hand
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.methods.coupled import CoupledConfig

EPOCHS, BATCHES, POINTS = 50, 25, 2048
TIMED = 5  # number of batches timed before, and after, a training
OURS, REFIT, PUBLIC = "geort_coupled", "refit", "public recipe"


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.set_defaults(seconds=1.0)
    options.add_argument("--recording", type=Path, help="recording of a right hand (default: synthetic play)")
    options.add_argument(
        "--steps", type=int, default=CoupledConfig().steps, help="of geort_coupled (default: %(default)s)"
    )
    arguments = parse(options, argv)
    recording = (
        read_recording(arguments.recording, "right", training=True)
        if arguments.recording
        else synthesize_play(seed=0)
    )
    batch = public_batch(recording.fingertips(load_hand(HAND).human_keypoints))
    batch()
    times: dict[str, list[float]] = {name: [] for name in (OURS, REFIT, PUBLIC)}

    def train(path: Path) -> Path:
        settings = {"steps": arguments.steps}
        return train_checkpoint(HAND, recording, path, OURS, show_progress=False, settings=settings)

    def refit(path: Path) -> Path:
        return refit_checkpoint(recording, path, HAND, show_progress=False)

    end = time.perf_counter() + arguments.seconds
    while not times[OURS] or time.perf_counter() < end:
        batches = [timed(batch) for _ in range(TIMED)]
        times[OURS].append(fit_time(train))
        times[REFIT].append(fit_time(refit))
        batches += [timed(batch) for _ in range(TIMED)]
        times[PUBLIC].append(EPOCHS * BATCHES * float(np.median(batches)))
    table = Table(title=f"training for {HAND}, {os.cpu_count()} cores")
    for heading in ("", "wall, median", f"over {OURS}"):
        table.add_column(heading, justify="right" if heading else "left")
    rows = {}
    for name, walls in times.items():
        if walls:
            ratio = float(np.median(np.divide(walls, times[OURS])))
            rows[name] = {"median_s": float(np.median(walls)), "all_s": walls, "ratio": ratio}
            table.add_row(name, f"{rows[name]['median_s']:,.0f} s", f"{ratio:.2f}")
    console.print(table)
    if arguments.json:
        write_json(arguments.json, results=rows, steps=arguments.steps)
    return 0


def timed(function: Callable[[], object]) -> float:
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


def fit_time(train: Callable[[Path], Path]) -> float:
    """Returns the seconds from the recording to the weights, without the evaluation that follows."""
    with tempfile.TemporaryDirectory() as folder:
        return load_checkpoint(train(Path(folder) / "map")).provenance["timings"]["fit_s"]


def public_batch(tips: np.ndarray) -> Callable[[], None]:
    """Returns a step of the public recipe on fingertips (T, 4, 3), m: forward, backward, and Adam.

    The recipe's forward kinematics is a network, too; its output does not matter here, so it is untrained.
    """
    generator = torch.Generator().manual_seed(0)
    networks = Published(tips).networks.train()
    nn = torch.nn
    kinematics = nn.ModuleList(
        nn.Sequential(nn.Linear(4, 128), nn.LeakyReLU(), nn.BatchNorm1d(128), nn.Linear(128, 3))
        for _ in networks
    ).requires_grad_(False)
    clouds = [torch.tensor(tips[:, i]).float() for i in range(len(networks))]
    targets = [torch.randn(100_000, 3, generator=generator) * 0.05 for _ in networks]
    optimiser = torch.optim.Adam(networks.parameters(), lr=1e-4)

    def drawn(cloud: torch.Tensor) -> torch.Tensor:
        return cloud[torch.randint(len(cloud), (POINTS,), generator=generator)]

    def step() -> None:
        total = torch.zeros(())
        human, robot = [], []
        for cloud, target, network, fk in zip(clouds, targets, networks, kinematics, strict=True):
            x, d = drawn(cloud), 0.004 * torch.randn(POINTS, 3, generator=generator)
            here, ahead, behind = fk(network(x)), fk(network(x + d)), fk(network(x - d))
            moved = torch.nn.functional.cosine_similarity(ahead - here, d, dim=1)
            squares = (drawn(target)[:, None] - here[None]).square().sum(-1)
            covered = squares.min(0).values.mean() + squares.min(1).values.mean()
            flat = (ahead + behind - 2 * here).square().sum(1).mean()
            total = total - moved.mean() + 80.0 * covered + 0.1 * flat
            human.append(x)
            robot.append(here)
        for i in range(1, len(human)):
            for j in range(i):
                pinching = (human[i] - human[j]).norm(dim=1) < 0.015
                total = total + (pinching * (robot[i] - robot[j]).square().sum(1)).mean()
        optimiser.zero_grad()
        total.backward()
        optimiser.step()

    return step


if __name__ == "__main__":
    run_main(main)

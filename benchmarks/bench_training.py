"""Times a whole training of geort against the public recipe of the paper's authors, in processor time.

python benchmarks/bench_training.py --recording human_alex.npy --json training.json

Rows:
  geort           from the recording to the weights, robot samples and pretraining included
  public recipe   50 epochs of 25 batches of 2,048, each finger's points drawn independently, the Chamfer term
                  over all distances between two clouds; written from the paper in plain PyTorch. A few
                  batches are timed before and after the training and extrapolated; its robot samples and
                  pretraining are left out, in its favour

Both run on one thread. Processor time hardly depends on what else the machine does; the JSON has wall times.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from bench_call import HAND, Published
from rich.table import Table
from side_by_side import parse, parser, write_json

from geort_drake.console import console, run_main
from geort_drake.hands.hand import Hand
from geort_drake.people.readers import read_recording
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import METHODS

EPOCHS, BATCHES, POINTS = 50, 25, 2048
TIMED = 3  # number of batches timed before, and after, the training


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.add_argument("--recording", type=Path, help="recording of a right hand (default: synthetic play)")
    arguments = parse(options, argv)
    recording = (
        read_recording(arguments.recording, "right", training=True)
        if arguments.recording
        else synthesize_play(seed=0)
    )
    torch.set_num_threads(1)
    hand = Hand(HAND)
    p_HF = recording.fingertips(hand.description.human_keypoints)
    batch = public_batch(p_HF)
    batch()
    batches = [times(batch) for _ in range(TIMED)]
    ours = times(lambda: METHODS["geort"].fit(hand, p_HF))
    batches += [times(batch) for _ in range(TIMED)]
    public = EPOCHS * BATCHES * np.median(batches, axis=0)
    table = Table(title=f"training for {HAND}")
    for heading in ("", "processor time", "over geort"):
        table.add_column(heading, justify="right" if heading else "left")
    rows = {}
    for name, (processor, wall) in {"geort": ours, "public recipe": public}.items():
        rows[name] = {"processor_s": processor, "wall_s": wall, "ratio": processor / ours[0]}
        table.add_row(name, f"{processor:,.0f} s", f"{processor / ours[0]:.1f}")
    console.print(table)
    if arguments.json:
        write_json(arguments.json, results=rows)
    return 0


def times(function: Callable[[], object]) -> tuple[float, float]:
    """Returns processor and wall time of a call, s."""
    processor, wall = time.process_time(), time.perf_counter()
    function()
    return time.process_time() - processor, time.perf_counter() - wall


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
